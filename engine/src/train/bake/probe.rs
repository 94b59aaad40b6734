//! The points of a Gaussian that are measured, and where poses take them.

use glam::{DMat3, DQuat, DVec3};

use super::promote;
use crate::reference::{aligned_sum, exp, exp_quaternion, rotation_of_quaternion};
use crate::scene::{Blend, Gaussians};

/// Points per Gaussian: its centre, and two standard deviations along its longest axis.
const POINTS: usize = 2;

/// A superpoint's pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placing {
    turn: DMat3,
    quaternion: DQuat,
    shift: DVec3,
}

impl Placing {
    pub(super) fn new(rotation: DVec3, shift: DVec3) -> Self {
        Self { turn: exp(rotation), quaternion: exp_quaternion(rotation), shift }
    }
}

/// A Gaussian's measured points.
#[derive(Debug, Clone)]
pub(super) struct Probe {
    /// Its index.
    pub(super) gaussian: usize,
    /// Superpoints with weights that sum to 1; `used` of them.
    slots: [(usize, f64); Blend::MOST_NEIGHBORS],
    used: usize,
    /// World space, canonical.
    points: [DVec3; POINTS],
    /// Whether it stays where it is.
    pub(super) rests: bool,
}

impl Probe {
    pub(super) fn new(g: &Gaussians, i: usize, slots: impl Iterator<Item = (usize, f64)>) -> Self {
        let mean = promote(g.mean[i]);
        let log_scale = g.log_scale[i];
        let longest = (0..3).max_by(|&a, &b| log_scale[a].total_cmp(&log_scale[b])).unwrap_or(0);
        let axis = rotation_of_quaternion(g.rotation[i].map(f64::from)).col(longest);
        let end = mean + axis * (2.0 * f64::from(log_scale[longest]).exp());
        let empty = Self { gaussian: i, slots: Default::default(), used: 0, points: [mean, end], rests: false };
        empty.with(slots)
    }

    /// The same with other slots.
    pub(super) fn with(&self, slots: impl Iterator<Item = (usize, f64)>) -> Self {
        let mut probe = Self { used: 0, ..self.clone() };
        for (to, slot) in probe.slots.iter_mut().zip(slots) {
            *to = slot;
            probe.used += 1;
        }
        probe
    }

    pub(super) fn is_finite(&self) -> bool {
        self.points.iter().all(|x| x.is_finite())
    }

    /// Its superpoints and their weights.
    pub(super) fn slots(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.slots[..self.used].iter().copied()
    }

    /// It rests when none of its superpoints is moving.
    pub(super) fn rest(&mut self, moving: &[bool]) {
        self.rests = self.slots[..self.used].iter().all(|(j, _)| !moving[*j]);
    }

    /// Whether it moves with more than one superpoint.
    pub(super) fn is_soft(&self) -> bool {
        self.used > 1
    }

    /// Where one pose takes the points.
    pub(super) fn placed_by(&self, pose: &Placing) -> [DVec3; POINTS] {
        self.points.map(|x| pose.turn * x + pose.shift)
    }

    /// Where `poses` take the points.
    pub(super) fn placed(&self, poses: &[Placing]) -> [DVec3; POINTS] {
        let [mean, end] = self.points;
        if let [(j, _)] = self.slots[..self.used] {
            return self.placed_by(&poses[j]);
        }
        let moved: DVec3 = self.slots().map(|(j, w)| w * (poses[j].turn * mean + poses[j].shift)).sum();
        let mut quaternions = [(0.0, DQuat::IDENTITY); Blend::MOST_NEIGHBORS];
        quaternions.iter_mut().zip(self.slots()).for_each(|(q, (j, w))| *q = (w, poses[j].quaternion));
        // Slots beyond the used ones have no weight.
        let turn = aligned_sum(&quaternions).normalize();
        [moved, moved + turn * (end - mean)]
    }
}
