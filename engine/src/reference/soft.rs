//! Soft superpoints: Gaussians that several poses move at once (linear blend skinning).
//!
//! μ(t) = Σ_k w_k (Exp(r_k)μ + τ_k). With the unit quaternions q_k of Exp(r_k) and the heaviest slot h (the first of equals),
//! b = Σ_k s_k w_k q_k, s_k = −1 where q_k·q_h < 0 and else +1; the rotation is b/|b|, then the Gaussian's own. |b| ≥ w_h > 0.

use glam::{DQuat, DVec3};

use super::motion::{Pose, exp, exp_quaternion};
use crate::error::{Error, Result};
use crate::scene::{Blend, Scene};

/// [`Blend`] in f64, with weights that are taken as they are.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Blend64 {
    /// K.
    pub neighbors: usize,
    /// `[N,K]` superpoint indices.
    pub index: Vec<u32>,
    /// `[N,K]` weights; those of a Gaussian sum to 1.
    pub weight: Vec<f64>,
}

impl From<&Blend> for Blend64 {
    /// Normalises the weights.
    fn from(blend: &Blend) -> Self {
        let weight = (0..blend.len()).flat_map(|i| blend.slots(i).map(|(_, w)| w)).collect();
        Self { neighbors: blend.neighbors, index: blend.index.clone(), weight }
    }
}

impl Blend64 {
    /// Of `scene`; `None` when each of its Gaussians moves with one superpoint.
    pub fn of(scene: &Scene) -> Option<Self> {
        scene.deformation.blend().map(Self::from)
    }

    /// `[K]` superpoints and weights of Gaussian `i`.
    pub(super) fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let slots = i * self.neighbors..(i + 1) * self.neighbors;
        self.index[slots.clone()].iter().zip(&self.weight[slots]).map(|(&j, &w)| (j as usize, w))
    }

    /// K slots for each of `gaussians`, with superpoints that are there.
    pub(super) fn check(&self, gaussians: usize, superpoints: usize) -> Result<()> {
        for (name, found) in [("index", self.index.len()), ("weight", self.weight.len())] {
            if found != gaussians * self.neighbors || self.neighbors == 0 {
                let expected = format!("N·K = {gaussians}·{}, K at least 1", self.neighbors);
                return Err(Error::usage(format!("superpoints.blend_{name}"), format!("{found} elements"), expected));
            }
        }
        match self.index.iter().position(|&m| m as usize >= superpoints) {
            Some(i) => {
                let found = format!("{} at element {i}", self.index[i]);
                Err(Error::usage("superpoints.blend_index", found, format!("less than {superpoints}")))
            }
            None => Ok(()),
        }
    }
}

/// A pose and its share of a Gaussian's motion.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct WeightedPose {
    /// Taken as it is: those of a Gaussian sum to 1.
    pub weight: f64,
    /// Of the superpoint.
    pub pose: Pose,
}

impl From<Pose> for WeightedPose {
    /// A pose that moves a Gaussian alone.
    fn from(pose: Pose) -> Self {
        Self { weight: 1.0, pose }
    }
}

/// The only pose that has a weight, where that is 1: such a motion needs no blending, and stays exact.
pub(super) fn only(poses: &[WeightedPose]) -> Option<Pose> {
    let mut with_weight = poses.iter().filter(|p| p.weight != 0.0);
    let first = with_weight.next().filter(|p| p.weight == 1.0)?;
    with_weight.next().is_none().then_some(first.pose)
}

/// Σ_k w_k Exp(r_k)x; x itself without poses. Poses without weight are not looked at.
pub(super) fn turned(poses: &[WeightedPose], x: DVec3) -> DVec3 {
    if poses.is_empty() { x } else { sum(poses, |pose| exp(pose.rotation) * x) }
}

/// Σ_k w_k Exp(r_k)ᵀx; x itself without poses.
pub(super) fn turned_back(poses: &[WeightedPose], x: DVec3) -> DVec3 {
    if poses.is_empty() { x } else { sum(poses, |pose| exp(pose.rotation).transpose() * x) }
}

/// Σ_k w_k τ_k.
pub(super) fn shift(poses: &[WeightedPose]) -> DVec3 {
    sum(poses, |pose| pose.translation)
}

fn sum(poses: &[WeightedPose], of: impl Fn(&Pose) -> DVec3) -> DVec3 {
    poses.iter().filter(|p| p.weight != 0.0).map(|p| p.weight * of(&p.pose)).sum()
}

/// The rotation that poses share, and what it is made of.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SharedTurn {
    /// b/|b|.
    pub(super) unit: DQuat,
    /// |b|.
    pub(super) length: f64,
    /// `[K]` s_k q_k.
    pub(super) aligned: Vec<DQuat>,
}

/// Weights that differ by less count as equal where the heaviest is asked for: rounding to f32 must not decide.
pub(crate) const EQUAL_WEIGHTS: f64 = 1e-6;

/// The quaternion of the heaviest slot, the first of equals; `slots` of weights and unit quaternions, at least one.
fn heaviest(slots: &[(f64, DQuat)]) -> DQuat {
    let first = slots[0];
    slots[1..].iter().fold(first, |best, slot| if slot.0 > best.0 + EQUAL_WEIGHTS { *slot } else { best }).1
}

fn on_side_of(side: DQuat, q: DQuat) -> DQuat {
    if q.dot(side) < 0.0 { -q } else { q }
}

/// b = Σ_k s_k w_k q_k of `slots`, at least one. Those without weight are not looked at.
pub(crate) fn aligned_sum(slots: &[(f64, DQuat)]) -> DQuat {
    let side = heaviest(slots);
    let with_weight = slots.iter().filter(|(w, _)| *w != 0.0);
    with_weight.fold(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), |sum, &(w, q)| sum + on_side_of(side, q) * w)
}

/// The rotation of `poses`, at least one.
pub(super) fn shared_turn(poses: &[WeightedPose]) -> SharedTurn {
    let slots: Vec<(f64, DQuat)> = poses.iter().map(|p| (p.weight, exp_quaternion(p.pose.rotation))).collect();
    let (side, sum) = (heaviest(&slots), aligned_sum(&slots));
    let length = sum.length();
    let aligned = slots.iter().map(|&(_, q)| on_side_of(side, q)).collect();
    SharedTurn { unit: sum * (1.0 / length), length, aligned }
}

/// The unit quaternion by which `poses` turn a Gaussian; `None` without poses.
pub(super) fn turn(poses: &[WeightedPose]) -> Option<DQuat> {
    match only(poses) {
        Some(pose) => Some(exp_quaternion(pose.rotation)),
        None if poses.is_empty() => None,
        None => Some(shared_turn(poses).unit),
    }
}
