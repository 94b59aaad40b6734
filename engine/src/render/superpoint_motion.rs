//! How a Gaussian's superpoints move it, as `glsl/lib/superpoint_motion.glsl` has it: its twin, and the words of `blend`.

use super::frame::Frame;
use super::quaternion;
use super::twin::vec4_at;
use crate::error::{Error, Result};
use crate::scene::Blend;

/// Largest so(3) vector, radians, and translation, world units.
const MAX_ABS_POSE: f32 = 1e15;
/// The level that stands for weight 1.
const ONE: u32 = 65_535;

/// Planes of `blend` with superpoints, and as many with weights, for K slots.
pub fn blend_planes(slots: u32) -> u32 {
    slots.div_ceil(2)
}

/// Weights as levels of unorm16 that add up to 65535: what rounding leaves goes to the first of the heaviest.
pub(crate) fn weight_levels(weight: &[f32]) -> Vec<u32> {
    let sum: f32 = weight.iter().sum();
    let mut level: Vec<u32> = weight.iter().map(|w| (w / sum * ONE as f32 + 0.5) as u32).collect();
    let heaviest = heaviest(weight);
    level[heaviest] = level[heaviest].wrapping_add(ONE.wrapping_sub(level.iter().sum()));
    level
}

/// The first of the largest.
fn heaviest<T: PartialOrd + Copy>(weight: &[T]) -> usize {
    (1..weight.len()).fold(0, |best, k| if weight[k] > weight[best] { k } else { best })
}

/// One Gaussian's words of `blend`, plane after plane.
pub(crate) fn blend_words(index: &[u32], level: &[u32]) -> Vec<u32> {
    let pairs = |v: &[u32]| v.chunks(2).map(|p| p[0] | p.get(1).copied().unwrap_or(0) << 16).collect::<Vec<_>>();
    [pairs(index), pairs(level)].concat()
}

/// `blend uint[2·ceil(K/2)][N]` of a scene with at most 65,536 superpoints.
///
/// # Errors
/// `Limit` beyond.
pub fn pack_blend(blend: &Blend, superpoints: usize) -> Result<Vec<u32>> {
    let most = 1 << 16;
    if superpoints > most {
        let what = "superpoints of a model with soft superpoints".into();
        return Err(Error::Limit { what, need: superpoints as u128, have: most as u128 });
    }
    let k = blend.neighbors.max(1);
    let n = blend.index.len() / k;
    let mut words = vec![0; 2 * k.div_ceil(2) * n];
    for (g, (index, weight)) in blend.index.chunks_exact(k).zip(blend.weight.chunks_exact(k)).enumerate() {
        for (plane, word) in blend_words(index, &weight_levels(weight)).into_iter().enumerate() {
            words[plane * n + g] = word;
        }
    }
    Ok(words)
}

/// Superpoints of Gaussians and the table of poses, for twins.
#[derive(Debug, Clone, Copy)]
pub struct SuperpointMotion<'a> {
    /// `[N]`; not read with soft superpoints.
    pub superpoint_of_gaussian: &'a [u32],
    /// `vec4[T][M][2]`
    pub pose: &'a [u32],
    /// K and the planes of `blend`; K = 0 without soft superpoints.
    pub blend: (u32, &'a [u32]),
}

/// One superpoint's part of a Gaussian's motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slot {
    /// The superpoint.
    pub superpoint: u32,
    /// Its weight.
    pub weight: f32,
}

fn within(v: [f32; 3]) -> bool {
    v.iter().all(|x| x.is_finite() && x.abs() <= MAX_ABS_POSE)
}

impl SuperpointMotion<'_> {
    /// The superpoints of Gaussian `g` of `n`; one of weight 1 without soft superpoints.
    pub fn slots(&self, g: usize, n: usize) -> Vec<Slot> {
        let (k, words) = self.blend;
        if k == 0 {
            return vec![Slot { superpoint: self.superpoint_of_gaussian[g], weight: 1.0 }];
        }
        let half = |plane: u32, slot: u32| words[(plane + slot / 2) as usize * n + g] >> (16 * (slot & 1)) & 0xffff;
        let slot = |s: u32| Slot { superpoint: half(0, s), weight: half(blend_planes(k), s) as f32 / ONE as f32 };
        (0..k).map(slot).collect()
    }

    /// so(3) vector and translation of a superpoint at the frame's time.
    pub fn pose(&self, frame: &Frame, superpoint: u32) -> Option<[[f32; 3]; 2]> {
        if superpoint >= frame.superpoints {
            return None;
        }
        let key = |k: u32| (2 * (k * frame.superpoints + superpoint)) as usize;
        let weight = frame.key_weight;
        let lerp = |offset: usize| -> [f32; 3] {
            let pair = [frame.first_key, frame.second_key].map(|k| vec4_at(self.pose, key(k) + offset));
            std::array::from_fn(|i| pair[0][i] * (1.0 - weight) + pair[1][i] * weight)
        };
        let pose = [lerp(0), lerp(1)];
        pose.iter().all(|v| within(*v)).then_some(pose)
    }

    /// Displacement of `x` and rotation by the superpoints of Gaussian `g`; `None` when a pose is unusable.
    pub fn displacement(&self, frame: &Frame, g: usize, x: [f32; 3]) -> Option<([f32; 3], [f32; 4])> {
        let slots = self.slots(g, frame.gaussians as usize);
        let moved = |slot: &Slot| {
            let [r, translation] = self.pose(frame, slot.superpoint)?;
            let turn = quaternion::exp(r);
            let shift = quaternion::displacement(turn, x);
            Some((turn, std::array::from_fn::<f32, 3, _>(|i| shift[i] + translation[i])))
        };
        let moved: Vec<_> = slots.iter().map(moved).collect::<Option<_>>()?;
        if self.blend.0 == 0 {
            return Some((moved[0].1, moved[0].0));
        }
        let weight: Vec<f32> = slots.iter().map(|s| s.weight).collect();
        let side = moved[heaviest(&weight)].0;
        let (mut sum, mut displacement) = ([0.0; 4], [0.0; 3]);
        for (w, (turn, shift)) in weight.iter().zip(&moved) {
            let signed = if (0..4).map(|i| turn[i] * side[i]).sum::<f32>() < 0.0 { -w } else { *w };
            sum = std::array::from_fn(|i| sum[i] + signed * turn[i]);
            displacement = std::array::from_fn(|i| displacement[i] + w * shift[i]);
        }
        let norm = sum.iter().map(|v| v * v).sum::<f32>().sqrt();
        Some((displacement, sum.map(|v| v / norm)))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn levels_add_up_and_come_back() {
        let weight = [0.3, 0.333, 0.1, 0.2];
        let level = weight_levels(&weight);
        assert_eq!(level.iter().sum::<u32>(), ONE);
        let blend = Blend { neighbors: 4, index: vec![7, 65_535, 0, 3], weight: weight.to_vec() };
        let words = pack_blend(&blend, 65_536).unwrap();
        let motion = SuperpointMotion { superpoint_of_gaussian: &[], pose: &[], blend: (4, &words) };
        for (slot, (index, w)) in motion.slots(0, 1).iter().zip(blend.index.iter().zip(weight)) {
            assert_eq!(slot.superpoint, *index);
            assert!((slot.weight - w / 0.933).abs() < 3e-5, "{} for {w}", slot.weight);
        }
        assert!(pack_blend(&blend, 65_537).is_err());
    }

    #[test]
    fn odd_numbers_of_slots_leave_half_a_word() {
        let blend = Blend { neighbors: 3, index: vec![1, 2, 3, 4, 5, 6], weight: vec![1.0, 0.0, 0.0, 0.5, 0.25, 0.25] };
        let words = pack_blend(&blend, 7).unwrap();
        assert_eq!(words.len(), 8);
        let motion = SuperpointMotion { superpoint_of_gaussian: &[], pose: &[], blend: (3, &words) };
        assert_eq!(motion.slots(1, 2).iter().map(|s| s.superpoint).collect::<Vec<_>>(), [4, 5, 6]);
        assert_eq!(motion.slots(0, 2)[0].weight, 1.0);
    }
}
