//! The rigid motion that takes points to others with the least weighted sum of squares.
//!
//! With the covariance H = Σ w (y − ȳ)(x − x̄)ᵀ the rotation is the one with the largest trace of RᵀH.

use glam::{DMat3, DVec3};

use crate::edit::{nearest_turn, outer};

/// A rigid motion x ↦ R·x + s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub(super) turn: DMat3,
    /// World units.
    pub(super) shift: DVec3,
}

impl Frame {
    pub(super) const IDENTITY: Self = Self { turn: DMat3::IDENTITY, shift: DVec3::ZERO };

    pub(super) fn apply(&self, x: DVec3) -> DVec3 {
        self.turn * x + self.shift
    }

    /// Where a point was before the motion.
    pub(super) fn back(&self, y: DVec3) -> DVec3 {
        self.turn.transpose() * (y - self.shift)
    }

    /// What undoes `other`, then this.
    pub(super) fn after_inverse_of(&self, other: &Self) -> Self {
        let turn = self.turn * other.turn.transpose();
        Self { turn, shift: self.shift - turn * other.shift }
    }
}

/// Sums over pairs of points x and y.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums {
    pub(super) weight: f64,
    pub(super) x: DVec3,
    pub(super) y: DVec3,
    /// Σ w y xᵀ.
    pub(super) yx: DMat3,
}

impl Sums {
    /// Over none.
    pub(super) const ZERO: Self = Self { weight: 0.0, x: DVec3::ZERO, y: DVec3::ZERO, yx: DMat3::ZERO };

    /// The motion that takes x to y best; without any weight, none.
    pub(super) fn fit(&self) -> Frame {
        if self.weight <= 0.0 || !self.weight.is_finite() {
            return Frame::IDENTITY;
        }
        let (x, y) = (self.x / self.weight, self.y / self.weight);
        let turn = DMat3::from_quat(nearest_turn(self.yx - outer(self.y, x)));
        Frame { turn, shift: y - turn * x }
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::scene::synthetic::Random;

    fn fitted(points: &[DVec3], to: &Frame) -> f64 {
        let mut sums = Sums::ZERO;
        for &x in points {
            let y = to.apply(x);
            sums.weight += 1.0;
            sums.x += x;
            sums.y += y;
            sums.yx += outer(y, x);
        }
        let found = sums.fit();
        assert!((found.turn.determinant() - 1.0).abs() < 1e-12, "no reflection");
        points.iter().map(|x| found.apply(*x).distance(to.apply(*x))).fold(0.0, f64::max)
    }

    #[test]
    fn a_rigid_motion_is_found_again_also_of_flat_thin_and_tiny_sets() {
        let mut random = Random::new(3);
        for case in 0..200 {
            let to = Frame { turn: DMat3::from_quat(random.rotation()), shift: 3.0 * random.normal3() };
            // In space, in a plane, on a line, at one point; of any size.
            let flat = [DVec3::ONE, DVec3::new(1.0, 1.0, 0.0), DVec3::X, DVec3::ZERO][case % 4];
            let size = 10f64.powi((case / 4) as i32 % 7 - 4);
            let points: Vec<DVec3> = (0..3 + case % 9).map(|_| size * flat * random.normal3()).collect();
            let worst = fitted(&points, &to);
            assert!(worst < 1e-12 * (1.0 + size), "case {case}: {worst}");
        }
    }

    #[test]
    fn mirrored_points_give_a_rotation_and_nothing_gives_none() {
        let points = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE];
        let mut sums = Sums::ZERO;
        for x in points {
            let y = DVec3::new(x.x, x.y, -x.z);
            (sums.weight, sums.x, sums.y) = (sums.weight + 1.0, sums.x + x, sums.y + y);
            sums.yx += outer(y, x);
        }
        assert!((sums.fit().turn.determinant() - 1.0).abs() < 1e-12);
        assert_eq!(Sums::ZERO.fit(), Frame::IDENTITY);
    }

    #[test]
    fn frames_compose_and_go_back() {
        let turn = |r: DVec3, shift| Frame { turn: DMat3::from_quat(DQuat::from_scaled_axis(r)), shift };
        let (a, b) = (turn(DVec3::new(0.3, 1.0, -2.0), DVec3::X), turn(DVec3::new(-1.0, 0.2, 0.4), DVec3::NEG_Y));
        let x = DVec3::new(0.4, 2.0, -1.0);
        assert!(a.back(a.apply(x)).distance(x) < 1e-12);
        assert!(a.after_inverse_of(&b).apply(b.apply(x)).distance(a.apply(x)) < 1e-12);
    }
}
