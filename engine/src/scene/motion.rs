//! Superpoint motion: μ(t) = Exp(r)μ + τ about the world origin, R(t) = Exp(r)R.

/// Where the poses of the superpoints come from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum MotionSource {
    /// The key-time table when the scene has one, else network F; a scene with neither does not move.
    #[default]
    Auto,
    /// The key-time table; asking for it is an error when the scene has none.
    Table,
    /// Network F, evaluated at each time; asking for it is an error when the scene has none.
    Network,
}

/// Assignment of Gaussians to superpoints.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Superpoints {
    /// `[N]` the superpoint each Gaussian moves with.
    pub of_gaussian: Vec<u32>,
    /// `[M,3]` canonical centres p^c, world units.
    pub position: Vec<[f32; 3]>,
}

impl Superpoints {
    /// The superpoints that Gaussian `i` moves with, and their weights, which are above 0 and sum to 1: its own, or with `blend`
    /// those of it. None for a Gaussian that is not there.
    pub fn slots<'a>(&'a self, blend: Option<&'a Blend>, i: usize) -> impl Iterator<Item = (usize, f64)> + 'a {
        let own = if blend.is_none() { self.of_gaussian.get(i) } else { None };
        let shared = blend.into_iter().flat_map(move |b| b.slots(i)).filter(|(_, w)| *w > 0.0);
        own.map(|&j| (j as usize, 1.0)).into_iter().chain(shared)
    }
}

/// Poses of M superpoints at T key times.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Motion {
    /// `[T]` strictly increasing key times.
    pub times: Vec<f32>,
    /// `[T,M,3]` so(3) vectors r, radians.
    pub rotation: Vec<[f32; 3]>,
    /// `[T,M,3]` translations τ, world units.
    pub translation: Vec<[f32; 3]>,
}

/// Soft superpoints: each Gaussian moves with K superpoints at once. Its centre is μ(t) = Σ_k w_k (Exp(r_k)μ + τ_k), its
/// rotation the normalised Σ_k ±w_k q_k of the unit quaternions q_k of Exp(r_k), with the signs that bring each to the side
/// of the heaviest one's, times its own (linear blend skinning, as in SC-GS). Play-back normalises the weights.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Blend {
    /// K, 1 to [`Blend::MOST_NEIGHBORS`].
    pub neighbors: usize,
    /// `[N,K]` superpoint indices.
    pub index: Vec<u32>,
    /// `[N,K]` weights ≥ 0 with a sum > 0.
    pub weight: Vec<f32>,
}

impl Blend {
    /// Most superpoints that a Gaussian moves with.
    pub const MOST_NEIGHBORS: usize = 4;

    /// Each Gaussian with its own superpoint alone.
    pub fn of_one(of_gaussian: &[u32]) -> Self {
        Self { neighbors: 1, index: of_gaussian.to_vec(), weight: vec![1.0; of_gaussian.len()] }
    }

    /// N, the number of Gaussians.
    pub fn len(&self) -> usize {
        self.index.len().checked_div(self.neighbors).unwrap_or(0)
    }

    /// Whether there is no Gaussian.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// `[K]` superpoints and weights of Gaussian `i`, as they are stored; empty for one that is not there.
    pub fn row(&self, i: usize) -> (&[u32], &[f32]) {
        let slots = i * self.neighbors..(i + 1) * self.neighbors;
        (self.index.get(slots.clone()).unwrap_or_default(), self.weight.get(slots).unwrap_or_default())
    }

    /// Superpoints of Gaussian `i` with their weights, which sum to 1, in the order of the slots.
    pub fn slots(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let (index, weight) = self.row(i);
        let sum: f64 = weight.iter().map(|&w| f64::from(w)).sum();
        index.iter().zip(weight).map(move |(&j, &w)| (j as usize, f64::from(w) / sum))
    }

    /// The superpoint of Gaussian `i` with the largest weight, the first of equals; `None` for one that is not there.
    pub fn heaviest(&self, i: usize) -> Option<u32> {
        let (index, weight) = self.row(i);
        index.get(heaviest_slot(weight)).copied()
    }

    /// `[N]` the superpoint of each Gaussian with the largest weight: [`Superpoints::of_gaussian`].
    pub fn of_gaussian(&self) -> Vec<u32> {
        (0..self.len()).filter_map(|i| self.heaviest(i)).collect()
    }

    /// How many Gaussians move with more than one superpoint.
    pub fn soft_count(&self) -> usize {
        (0..self.len()).filter(|&i| self.row(i).1.iter().filter(|w| **w > 0.0).count() > 1).count()
    }

    /// The mean over the Gaussians of exp(−Σ w ln w): 1 when each moves with one superpoint, K when all weights are equal.
    pub fn mean_superpoints(&self) -> f64 {
        let entropy = |i: usize| self.slots(i).map(|(_, w)| if w > 0.0 { -w * w.ln() } else { 0.0 }).sum::<f64>();
        (0..self.len()).map(|i| entropy(i).exp()).sum::<f64>() / self.len().max(1) as f64
    }

    /// The same weights in steps of 1/255 of each Gaussian's sum, as the model file keeps them in one byte. A sum stays above
    /// 0, and the heaviest superpoint stays the heaviest.
    #[must_use]
    pub fn quantized(&self) -> Self {
        let mut blend = self.clone();
        if self.neighbors == 0 {
            return blend;
        }
        for row in blend.weight.chunks_exact_mut(self.neighbors) {
            if row.iter().any(|&w| level(w).is_none()) {
                quantize(row);
            }
        }
        blend
    }

    /// `[N,K]` the weights in units of 1/255, when all of them are whole.
    pub fn levels(&self) -> Option<Vec<u8>> {
        self.weight.iter().map(|&w| level(w)).collect()
    }

    /// The weight of `level`.
    pub fn weight_of_level(level: u8) -> f32 {
        (f64::from(level) / 255.0) as f32
    }
}

fn level(weight: f32) -> Option<u8> {
    let level = (255.0 * weight).round() as u8;
    (Blend::weight_of_level(level) == weight).then_some(level)
}

/// The first slot with the largest weight.
pub fn heaviest_slot<T: PartialOrd>(weight: &[T]) -> usize {
    (1..weight.len()).fold(0, |best, k| if weight[k] > weight[best] { k } else { best })
}

/// Rounds the weights of one Gaussian to levels of 1/255. Rounding keeps the order of weights but for new ties, and a slot
/// before the heaviest that would tie with it goes one level down.
fn quantize(row: &mut [f32]) {
    let heaviest = heaviest_slot(row);
    let sum: f64 = row.iter().map(|&w| f64::from(w)).sum();
    // 255/K at least for the heaviest.
    let nearest = |w: f32| (255.0 * f64::from(w) / sum).round() as u8;
    let most = nearest(row[heaviest]);
    for (k, w) in row.iter_mut().enumerate() {
        let tie = k < heaviest && nearest(*w) >= most;
        *w = Blend::weight_of_level(if tie { most.saturating_sub(1) } else { nearest(*w) });
    }
}

/// Sparse association matrix A: K' neighbours of each Gaussian with their logits.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Association {
    /// K'.
    pub neighbors: usize,
    /// `[N,K']` superpoint indices.
    pub neighbor: Vec<u32>,
    /// `[N,K']` logits.
    pub logit: Vec<f32>,
}

impl Association {
    /// The first `neighbors` of each Gaussian, at most K'.
    pub fn first(&self, neighbors: usize) -> Self {
        let wanted = neighbors.min(self.neighbors);
        let rows = |length: usize| (0..length).filter(|i| i % self.neighbors.max(1) < wanted);
        Self {
            neighbors: wanted,
            neighbor: rows(self.neighbor.len()).map(|i| self.neighbor[i]).collect(),
            logit: rows(self.logit.len()).map(|i| self.logit[i]).collect(),
        }
    }
}

/// Where a time lies in the key-time table: between keys `first` and `second`, `weight` of the way.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct KeyInterval {
    /// Index of the key at or before the time.
    pub first: u32,
    /// Index of the key after it (equal to `first` when held).
    pub second: u32,
    /// 0 at `first`, 1 at `second`.
    pub weight: f64,
}

impl Motion {
    /// M, the number of superpoints (0 for an empty table).
    pub fn superpoint_count(&self) -> usize {
        if self.times.is_empty() { 0 } else { self.rotation.len() / self.times.len() }
    }

    /// The key interval of time `t`; before the first and after the last key the pose is held.
    pub fn interval(&self, t: f64) -> KeyInterval {
        let last = self.times.len().saturating_sub(1);
        let after = self.times.partition_point(|&k| f64::from(k) <= t);
        if after == 0 {
            return KeyInterval::default();
        }
        if after > last {
            return KeyInterval { first: last as u32, second: last as u32, weight: 0.0 };
        }
        let (t0, t1) = (f64::from(self.times[after - 1]), f64::from(self.times[after]));
        KeyInterval { first: (after - 1) as u32, second: after as u32, weight: (t - t0) / (t1 - t0) }
    }
}

/// Form of the property losses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum PropertyLoss {
    /// None: logits stay, superpoints are moved by the rendering loss alone.
    Off,
    /// The released code's.
    #[default]
    Code,
    /// The paper's equation.
    Paper,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::scene::synthetic::random_blend;

    #[test]
    fn the_heaviest_superpoint_is_the_first_of_equals() {
        let blend = Blend { neighbors: 3, index: vec![7, 8, 9, 4, 5, 6], weight: vec![1.0, 3.0, 3.0, 2.0, 0.0, 0.0] };
        assert_eq!((blend.len(), blend.of_gaussian(), blend.heaviest(2)), (2, vec![8, 4], None));
        assert_eq!(blend.slots(0).collect::<Vec<_>>(), [(7, 1.0 / 7.0), (8, 3.0 / 7.0), (9, 3.0 / 7.0)]);
        assert_eq!(blend.soft_count(), 1);
        let superpoints = Superpoints { of_gaussian: vec![8, 4], position: Vec::new() };
        assert_eq!(superpoints.slots(Some(&blend), 1).collect::<Vec<_>>(), [(4, 1.0)], "without weight");
        assert_eq!(superpoints.slots(None, 0).collect::<Vec<_>>(), [(8, 1.0)]);
        assert_eq!(superpoints.slots(None, 2).count() + superpoints.slots(Some(&blend), 2).count(), 0);
    }

    #[test]
    fn superpoints_in_effect_are_one_to_all() {
        let equal = Blend { neighbors: 4, index: vec![0; 8], weight: vec![0.3; 8] };
        assert!((equal.mean_superpoints() - 4.0).abs() < 1e-12);
        assert_eq!(Blend::of_one(&[3, 1]).mean_superpoints(), 1.0);
    }

    #[test]
    fn bytes_keep_the_heaviest_superpoint_and_their_own_values() {
        for neighbors in 1..=Blend::MOST_NEIGHBORS {
            let blend = random_blend(2000, 9, neighbors, neighbors as u64);
            let rounded = blend.quantized();
            assert_eq!(rounded.of_gaussian(), blend.of_gaussian());
            assert!(blend.levels().is_none() || neighbors == 1, "weights that are no levels");
            assert!(rounded.levels().is_some());
            assert_eq!(rounded.quantized(), rounded);
            for i in 0..blend.len() {
                for ((_, before), (_, after)) in blend.slots(i).zip(rounded.slots(i)) {
                    assert!((before - after).abs() < 2.0 / 255.0, "{before} {after}");
                }
            }
        }
        // The second is heavier by less than a level.
        let close = Blend { neighbors: 2, index: vec![4, 5], weight: vec![0.4999, 0.5001] };
        assert_eq!(close.quantized().of_gaussian(), [5]);
        for level in 0..=255 {
            assert_eq!(
                Blend { weight: vec![Blend::weight_of_level(level)], ..Blend::of_one(&[0]) }.levels(),
                Some(vec![level])
            );
        }
    }
}
