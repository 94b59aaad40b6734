//! The rotation nearest to a matrix.
//!
//! The rotation R with the largest trace of RᵀC is the eigenvector with the largest eigenvalue of a symmetric 4x4 matrix (Horn
//! 1987, "Closed-form solution of absolute orientation using unit quaternions"), here by Jacobi's rotations, which need no gap
//! between eigenvalues. It is R = V diag(1, 1, det VUᵀ) Uᵀ of C's singular vectors, and never a reflection, however flat the points
//! lie that C is the covariance of.

use glam::{DMat3, DQuat, DVec3};

/// y xᵀ.
pub(crate) fn outer(y: DVec3, x: DVec3) -> DMat3 {
    DMat3::from_cols(y * x.x, y * x.y, y * x.z)
}

/// The rotation R with the largest trace of RᵀC; none for a matrix of zeros or not of numbers.
pub(crate) fn nearest_turn(c: DMat3) -> DQuat {
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
