//! The rigid motion that takes points to others with the least weighted sum of squares.
//!
//! With the covariance H = Σ w (y − ȳ)(x − x̄)ᵀ the rotation is the one with the largest trace of RᵀH: the eigenvector with the
//! largest eigenvalue of a symmetric 4x4 matrix (Horn 1987, "Closed-form solution of absolute orientation using unit
//! quaternions"), here by Jacobi's rotations, which need no gap between eigenvalues. It is the rotation R = V diag(1, 1, det VUᵀ) Uᵀ
//! of H's singular vectors, and never a reflection, however flat the points lie.

use glam::{DMat3, DQuat, DVec3};

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

/// y xᵀ.
pub(super) fn outer(y: DVec3, x: DVec3) -> DMat3 {
    DMat3::from_cols(y * x.x, y * x.y, y * x.z)
}

/// The rotation R with the largest trace of RᵀC.
fn nearest_turn(c: DMat3) -> DQuat {
    let [xx, xy, xz] = c.row(0).to_array();
    let [yx, yy, yz] = c.row(1).to_array();
    let [zx, zy, zz] = c.row(2).to_array();
    let matrix = [
        [xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, xx - yy - zz, xy + yx, zx + xz],
        [xz - zx, xy + yx, yy - xx - zz, yz + zy],
        [yx - xy, zx + xz, yz + zy, zz - xx - yy],
    ];
    let [w, x, y, z] = largest_eigenvector(matrix);
    let q = DQuat::from_xyzw(x, y, z, w);
    if q.is_finite() && q.length_squared() > 0.0 { q.normalize() } else { DQuat::IDENTITY }
}

/// Of a symmetric matrix; of equal eigenvalues the first. Cyclic Jacobi (Golub and Van Loan, section 8.5).
fn largest_eigenvector(mut a: [[f64; 4]; 4]) -> [f64; 4] {
    const SWEEPS: usize = 12;
    let mut v = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let size: f64 = a.iter().flatten().map(|x| x.abs()).fold(0.0, f64::max);
    for _ in 0..SWEEPS {
        let mut off: f64 = 0.0;
        for p in 0..3 {
            for q in p + 1..4 {
                off = off.max(a[p][q].abs());
                if a[p][q].abs() <= 1.0e-18 * size {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let cosine = t.hypot(1.0).recip();
                turn(&mut a, &mut v, [p, q], cosine, t * cosine);
            }
        }
        if off <= 1.0e-16 * size {
            break;
        }
    }
    let best = (1..4).fold(0, |best, k| if a[k][k] > a[best][best] { k } else { best });
    v.map(|row| row[best])
}

/// A ← JᵀAJ, V ← VJ with the rotation J in the plane of p and q.
fn turn(a: &mut [[f64; 4]; 4], v: &mut [[f64; 4]; 4], [p, q]: [usize; 2], c: f64, s: f64) {
    for row in a.iter_mut().chain(v) {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
    for k in 0..4 {
        (a[p][k], a[q][k]) = (c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]);
    }
}

#[cfg(test)]
mod tests {
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
