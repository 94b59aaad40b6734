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
