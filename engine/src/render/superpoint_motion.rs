//! How a Gaussian's superpoints move it, as `glsl/lib/superpoint_motion.glsl` has it: its twin, and the words of `blend_index` and `blend_weight`.

use super::frame::Frame;
use super::quaternion;
use super::twin::{f32_at, vec4_at};
use crate::error::{Error, Result};
use crate::gpu::{Gpu, Slice};
use crate::reference::EQUAL_WEIGHTS;
use crate::scene::Blend;

/// Largest so(3) vector, radians, and translation, world units.
const MAX_ABS_POSE: f32 = 1e15;
/// Planes of `blend_index`, for K slots.
pub fn index_planes(slots: u32) -> u32 {
    slots.div_ceil(2)
}

/// Planes of `blend_weight`: the last weight is what the others leave of 1.
pub fn weight_planes(slots: u32) -> u32 {
    slots.saturating_sub(1)
}

/// Bytes of both for a Gaussian.
pub fn blend_bytes(slots: u32) -> u64 {
    4 * u64::from(index_planes(slots) + weight_planes(slots))
}

/// The first of the largest.
fn heaviest(weight: &[f32]) -> usize {
    (1..weight.len()).fold(0, |best, k| if weight[k] > weight[best] + EQUAL_WEIGHTS as f32 { k } else { best })
}

/// One Gaussian's words of `blend_index`, plane after plane.
pub(crate) fn index_words(index: &[u32]) -> impl Iterator<Item = u32> + '_ {
    index.chunks(2).map(|pair| pair[0] | pair.get(1).copied().unwrap_or(0) << 16)
}

/// Soft superpoints as kernels read them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PackedBlend {
    /// K.
    pub slots: u32,
    /// `blend_index uint[ceil(K/2)][N]`.
    pub index: Vec<u32>,
    /// `blend_weight float[K-1][N]`, normalised.
    pub weight: Vec<f32>,
}

impl PackedBlend {
    /// Of a scene with at most 65,536 superpoints.
    ///
    /// # Errors
    /// `Limit` beyond.
    pub fn new(blend: &Blend, superpoints: usize) -> Result<Self> {
        let most = 1 << 16;
        if superpoints > most {
            let what = "superpoints of a model with soft superpoints".into();
            return Err(Error::Limit { what, need: superpoints as u128, have: most as u128 });
        }
        let (n, slots) = (blend.len(), blend.neighbors as u32);
        let mut packed = Self {
            slots,
            index: vec![0; index_planes(slots) as usize * n],
            weight: vec![0.0; weight_planes(slots) as usize * n],
        };
        for g in 0..n {
            let words = index_words(blend.row(g).0).enumerate();
            words.for_each(|(plane, word)| packed.index[plane * n + g] = word);
            let weights = blend.slots(g).take(weight_planes(slots) as usize).enumerate();
            weights.for_each(|(plane, (_, weight))| packed.weight[plane * n + g] = weight as f32);
        }
        Ok(packed)
    }
}

/// Soft superpoints on the device.
#[derive(Debug, Clone)]
pub struct BlendSlices {
    /// K.
    pub slots: u32,
    /// `blend_index`.
    pub index: Slice,
    /// `blend_weight`; planes behind its own are not read.
    pub weight: Slice,
}

impl BlendSlices {
    /// Uploads them.
    ///
    /// # Errors
    /// As [`PackedBlend::new`]; `OutOfMemory`.
    pub(crate) fn upload(gpu: &Gpu, blend: &Blend, superpoints: usize) -> Result<Self> {
        let packed = PackedBlend::new(blend, superpoints)?;
        Ok(Self {
            slots: packed.slots,
            index: gpu.buffer_with("blend_index", bytemuck::cast_slice(&packed.index))?.whole(),
            weight: gpu.buffer_with("blend_weight", bytemuck::cast_slice(&packed.weight))?.whole(),
        })
    }

    /// Bytes on the device.
    pub(crate) fn bytes(&self) -> u64 {
        self.index.bytes + self.weight.bytes
    }
}

/// Superpoints of Gaussians and the table of poses, for twins.
#[derive(Debug, Clone, Copy, Default)]
pub struct SuperpointMotion<'a> {
    /// `[N]`; not read with soft superpoints.
    pub superpoint_of_gaussian: &'a [u32],
    /// `vec4[T][M][2]`
    pub pose: &'a [u32],
    /// K of soft superpoints, or 0.
    pub slots: u32,
    /// `[ceil(K/2)][N]` of soft superpoints.
    pub blend_index: &'a [u32],
    /// `[K-1][N]` of soft superpoints.
    pub blend_weight: &'a [u32],
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
        if self.slots == 0 {
            return vec![Slot { superpoint: self.superpoint_of_gaussian[g], weight: 1.0 }];
        }
        let mut rest = 1.0_f32;
        let slot = |s: u32| {
            let weight = if s + 1 < self.slots { f32_at(self.blend_weight, s as usize * n + g) } else { rest.max(0.0) };
            rest -= weight;
            let superpoint = self.blend_index[(s / 2) as usize * n + g] >> (16 * (s & 1)) & 0xffff;
            Slot { superpoint, weight }
        };
        (0..self.slots).map(slot).collect()
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
        if self.slots == 0 {
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

    fn slots(blend: &Blend, g: usize) -> Vec<Slot> {
        let packed = PackedBlend::new(blend, 65_536).unwrap();
        let weight: Vec<u32> = packed.weight.iter().map(|w| w.to_bits()).collect();
        let motion = SuperpointMotion {
            slots: packed.slots,
            blend_index: &packed.index,
            blend_weight: &weight,
            ..SuperpointMotion::default()
        };
        motion.slots(g, blend.len())
    }

    #[test]
    fn weights_come_back_normalised() {
        let weight = [0.3, 0.333, 0.1, 0.2];
        let blend = Blend { neighbors: 4, index: vec![7, 65_535, 0, 3], weight: weight.to_vec() };
        for (slot, (index, w)) in slots(&blend, 0).iter().zip(blend.index.iter().zip(weight)) {
            assert_eq!(slot.superpoint, *index);
            assert!((slot.weight - w / 0.933).abs() < 2e-7, "{} for {w}", slot.weight);
        }
        assert!(PackedBlend::new(&blend, 65_537).is_err());
    }

    #[test]
    fn odd_numbers_of_slots_leave_half_a_word() {
        let blend = Blend { neighbors: 3, index: vec![1, 2, 3, 4, 5, 6], weight: vec![1.0, 0.0, 0.0, 0.5, 0.25, 0.25] };
        let [first, second] = [slots(&blend, 0), slots(&blend, 1)];
        assert_eq!(second.iter().map(|s| s.superpoint).collect::<Vec<_>>(), [4, 5, 6]);
        assert_eq!(first[0].weight, 1.0);
        let one = Blend { neighbors: 1, index: vec![9], weight: vec![0.2] };
        assert_eq!(slots(&one, 0), [Slot { superpoint: 9, weight: 1.0 }]);
    }
}
