//! A change of the world that keeps shapes: x ↦ k·R·x + s.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::reference::{Pose, exp_quaternion};

/// Turn, uniform scale and shift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// k > 0.
    pub scale: f64,
    /// R, a unit quaternion.
    pub turn: DQuat,
    /// s, world units.
    pub shift: DVec3,
}

impl From<Pose> for Similarity {
    fn from(pose: Pose) -> Self {
        Self { scale: 1.0, turn: exp_quaternion(pose.rotation), shift: pose.translation }
    }
}

impl Similarity {
    /// Changes nothing.
    pub const IDENTITY: Self = Self { scale: 1.0, turn: DQuat::IDENTITY, shift: DVec3::ZERO };

    /// Moves by a vector, world units.
    pub fn of_shift(shift: DVec3) -> Self {
        Self { shift, ..Self::IDENTITY }
    }

    /// Turns by `angle` radians around `axis` (any length above 0) through `pivot`.
    pub fn of_turn(axis: DVec3, angle: f64, pivot: DVec3) -> Self {
        let turn = DQuat::from_axis_angle(axis.normalize_or(DVec3::Z), angle);
        Self { scale: 1.0, turn, shift: pivot - turn * pivot }
    }

    /// Scales by `scale` > 0 about `pivot`.
    pub fn of_scale(scale: f64, pivot: DVec3) -> Self {
        Self { scale, turn: DQuat::IDENTITY, shift: pivot * (1.0 - scale) }
    }

    /// Whether it changes nothing, to the last bit.
    pub fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }

    /// Where a point goes.
    pub fn apply(&self, x: DVec3) -> DVec3 {
        self.scale * (self.turn * x) + self.shift
    }

    /// What undoes it.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let turn = self.turn.conjugate();
        Self { scale: self.scale.recip(), turn, shift: turn * self.shift * -self.scale.recip() }
    }

    /// `other` first, then this.
    #[must_use]
    pub fn after(&self, other: &Self) -> Self {
        let turn = (self.turn * other.turn).normalize();
        Self { scale: self.scale * other.scale, turn, shift: self.apply(other.shift) }
    }

    /// The turn as a matrix.
    pub fn matrix(&self) -> DMat3 {
        DMat3::from_quat(self.turn)
    }

    /// The same as an affine map.
    pub fn affine(&self) -> DAffine3 {
        DAffine3::from_mat3_translation(self.matrix() * self.scale, self.shift)
    }

    /// The turn about the world's origin and the scale, without the shift.
    #[must_use]
    pub fn linear(&self) -> Self {
        Self { shift: DVec3::ZERO, ..*self }
    }

    /// A `share` of the way from nothing to a rigid change: turned around `pivot`, which moves on a line.
    #[must_use]
    pub fn share(&self, share: f64, pivot: DVec3) -> Self {
        let turn = DQuat::from_scaled_axis(self.turn.to_scaled_axis() * share);
        let moved = pivot + (self.apply(pivot) - pivot) * share;
        Self { scale: 1.0, turn, shift: moved - turn * pivot }
    }
}

/// The rotation vector of a unit quaternion, in radians, that is nearest to `previous`: rotations are followed beyond π.
pub(crate) fn unwrapped(turn: DQuat, previous: DVec3) -> DVec3 {
    const TAU: f64 = std::f64::consts::TAU;
    let shortest = turn.to_scaled_axis();
    let angle = shortest.length();
    if angle < 1.0e-9 {
        // No turn, or whole ones: around the axis so far.
        let turns = (previous.length() / TAU).round();
        return previous.normalize_or_zero() * (turns * TAU) + shortest;
    }
    let axis = shortest / angle;
    axis * (angle + TAU * ((previous.dot(axis) - angle) / TAU).round())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::exp;

    #[test]
    fn changes_compose_and_are_undone() {
        let turn = Similarity::of_turn(DVec3::new(1.0, 2.0, -0.5), 1.2, DVec3::new(0.3, 0.0, 1.0));
        let all = Similarity::of_scale(1.7, DVec3::X).after(&turn).after(&Similarity::of_shift(DVec3::NEG_Y));
        let x = DVec3::new(0.4, -1.0, 2.0);
        assert!((all.inverse().apply(all.apply(x)) - x).length() < 1e-12);
        assert!((all.affine().transform_point3(x) - all.apply(x)).length() < 1e-12);
        assert!((turn.apply(DVec3::new(0.3, 0.0, 1.0)) - DVec3::new(0.3, 0.0, 1.0)).length() < 1e-12);
        assert!((turn.share(1.0, DVec3::ONE).apply(x) - turn.apply(x)).length() < 1e-12);
        assert!(turn.share(0.0, DVec3::ONE).apply(x) == x);
    }

    #[test]
    fn rotations_are_followed_beyond_half_and_whole_turns() {
        let axis = DVec3::new(2.0, -1.0, 2.0) / 3.0;
        let mut previous = DVec3::ZERO;
        for step in 0..=400 {
            let expected = axis * (f64::from(step) * 0.05);
            let found = unwrapped(exp_quaternion(expected), previous);
            assert!((found - expected).length() < 1e-9, "{step}: {found} {expected}");
            assert!((exp(found) - exp(expected)).abs_diff_eq(DMat3::ZERO, 1e-9));
            previous = found;
        }
    }
}
