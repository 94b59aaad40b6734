//! Gaussians under an affine map: nodes of a scene graph, files with other axes.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use multiversion::multiversion;
use rayon::prelude::*;

use super::codec::unit;
use super::spz::flip_axes;
use crate::reference::sh_basis;
use crate::scene::Gaussians;

/// How far a map's rows may be from orthogonal for one that keeps shapes: numbers in text have 7 digits.
const ORTHOGONAL: f64 = 1.0e-5;

/// The axes of `.spz` and glTF (right, up, back) in ours (right, down, front), or back: the same turn.
pub(crate) const TURN: DMat3 = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));

/// Moves, turns and scales Gaussians, their view-dependent colours with them. Says whether the map keeps shapes: one that
/// stretches makes other ellipsoids, exactly, but where colours are seen from is then only turned, not stretched.
/// The identity and [`TURN`] keep all bits.
pub(crate) fn transform(g: &mut Gaussians, map: &DAffine3) -> bool {
    if *map == DAffine3::IDENTITY {
        return true;
    }
    if map.matrix3 == TURN && map.translation == DVec3::ZERO {
        flip_axes(g);
        return true;
    }
    let linear = map.matrix3;
    let scale = linear.determinant().abs().cbrt();
    let orthogonal = polar(linear * (1.0 / scale));
    let keeps_shapes = (orthogonal * scale).abs_diff_eq(linear, ORTHOGONAL * scale);
    // A mirrored ellipsoid is one turned by the map with the sign that makes it a rotation.
    let turn = DQuat::from_mat3(&(orthogonal * orthogonal.determinant().signum()));
    (&mut g.mean, &mut g.log_scale, &mut g.rotation).into_par_iter().for_each(|(mean, log_scale, rotation)| {
        *mean = map.transform_point3(DVec3::from_array(mean.map(f64::from))).as_vec3().to_array();
        let [w, x, y, z] = unit(*rotation);
        let own = DQuat::from_xyzw(x, y, z, w);
        if keeps_shapes {
            *log_scale = log_scale.map(|s| (f64::from(s) + scale.ln()) as f32);
            *rotation = wxyz(turn * own);
        } else {
            let sizes = DMat3::from_diagonal(DVec3::from_array(log_scale.map(|s| f64::from(s).exp())));
            let (turned, lengths) = ellipsoid(linear * DMat3::from_quat(own) * sizes);
            *log_scale = lengths.map(|length| length.ln() as f32);
            *rotation = wxyz(turned);
        }
    });
    if orthogonal.is_finite() {
        turn_colors(g, orthogonal, |_| true);
    }
    keeps_shapes
}

fn wxyz(q: DQuat) -> [f32; 4] {
    [q.w as f32, q.x as f32, q.y as f32, q.z as f32]
}

/// The orthogonal matrix nearest to one with a determinant of ±1: Newton's iteration.
fn polar(mut m: DMat3) -> DMat3 {
    for _ in 0..32 {
        m = (m + m.inverse().transpose()) * 0.5;
    }
    m
}

/// Axes and their half lengths of the ellipsoid that a matrix makes of the unit sphere: its columns are turned in pairs
/// until they are orthogonal (one-sided Jacobi).
fn ellipsoid(m: DMat3) -> (DQuat, [f64; 3]) {
    let mut columns = [m.x_axis, m.y_axis, m.z_axis];
    for _ in 0..16 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (columns[p], columns[q]);
            let dot = a.dot(b);
            if dot.abs() <= 1.0e-16 * a.length() * b.length() {
                continue;
            }
            let zeta = (b.length_squared() - a.length_squared()) / (2.0 * dot);
            let tangent = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
            let cosine = tangent.hypot(1.0).recip();
            columns[p] = (a - b * tangent) * cosine;
            columns[q] = (a * tangent + b) * cosine;
        }
    }
    let lengths = columns.map(DVec3::length);
    // The shortest may have no direction of its own: it is orthogonal to the others.
    let shortest = (0..3).fold(0, |best, i| if lengths[i] < lengths[best] { i } else { best });
    let (next, last) = ((shortest + 1) % 3, (shortest + 2) % 3);
    let mut axes = columns.map(DVec3::normalize_or_zero);
    axes[shortest] = axes[next].cross(axes[last]);
    (DQuat::from_mat3(&DMat3::from_cols(axes[0], axes[1], axes[2])), lengths)
}

/// Nodes and weights of Gauss–Legendre quadrature, exact to degree 7.
const LEGENDRE: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.347_854_845_137_453_8),
    (-0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
    (0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_8),
];
/// Directions around the axis, exact to degree 7 as well.
const AROUND: usize = 8;

/// Turns view-dependent colours of the Gaussians for which `is_turned` holds by an orthogonal matrix. The coefficients of
/// f(M⁻¹d) are its integrals with the basis functions, which are orthonormal; the quadrature is exact for products of two of
/// degree 3.
pub(crate) fn turn_colors(g: &mut Gaussians, m: DMat3, is_turned: impl Fn(usize) -> bool + Sync) {
    let (degree, k3) = (g.sh_degree, g.sh_coefficients() * 3);
    if degree == 0 {
        return;
    }
    let mut matrix = [[0.0; 16]; 16];
    for (z, weight) in LEGENDRE {
        for i in 0..AROUND {
            let step = std::f64::consts::TAU / AROUND as f64;
            let (sin, cos) = (step * i as f64).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            let d = DVec3::new(radius * cos, radius * sin, z);
            let (new, old) = (sh_basis(d, degree), sh_basis(m.transpose() * d, degree));
            for (row, new) in matrix.iter_mut().zip(new) {
                row.iter_mut().zip(old).for_each(|(cell, old)| *cell += weight * step * new * old);
            }
        }
    }
    let rows = g.sh.par_chunks_exact_mut(k3).enumerate().filter(|(i, _)| is_turned(*i));
    rows.for_each(|(_, sh)| turn_row(sh, &matrix, degree as usize));
}

/// Turns the bands of one Gaussian. No multiplication is fused with an addition, so every processor makes the same bits.
#[multiversion(targets("x86_64+avx2"))]
fn turn_row(sh: &mut [f32], matrix: &[[f64; 16]; 16], degree: usize) {
    // Four numbers each, of which the last is 0: they fit registers.
    let mut old = [[0.0; 4]; 16];
    for (old, now) in old.iter_mut().zip(sh.as_chunks::<3>().0) {
        *old = [f64::from(now[0]), f64::from(now[1]), f64::from(now[2]), 0.0];
    }
    turn_band::<1, 3>(sh, &old, matrix);
    if degree > 1 {
        turn_band::<4, 5>(sh, &old, matrix);
    }
    if degree > 2 {
        turn_band::<9, 7>(sh, &old, matrix);
    }
}

/// The `COUNT` coefficients from `FIRST` on; loops of a known length are unrolled, and sums stay in registers.
#[inline(always)]
fn turn_band<const FIRST: usize, const COUNT: usize>(sh: &mut [f32], old: &[[f64; 4]; 16], matrix: &[[f64; 16]; 16]) {
    let mut sums = [[0.0; 4]; COUNT];
    for j in FIRST..FIRST + COUNT {
        for (k, sum) in sums.iter_mut().enumerate() {
            let factor = matrix[FIRST + k][j];
            (0..4).for_each(|c| sum[c] += factor * old[j][c]);
        }
    }
    let rows = sh.as_chunks_mut::<3>().0[FIRST..].iter_mut().zip(&sums);
    rows.for_each(|(row, sum)| *row = [sum[0] as f32, sum[1] as f32, sum[2] as f32]);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;
    use crate::reference::color_of;
    use crate::scene::synthetic::random_gaussians;

    fn covariance(g: &Gaussians, i: usize) -> DMat3 {
        let [w, x, y, z] = unit(g.rotation[i]);
        let sizes = DVec3::from_array(g.log_scale[i].map(|s| f64::from(s).exp()));
        let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w)) * DMat3::from_diagonal(sizes);
        axes * axes.transpose()
    }

    /// Centres and covariances under any map, and colours under those that keep shapes, are those of the definition.
    #[test]
    fn gaussians_follow_any_map() {
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -2.0) / 3.0, 1.1);
        let turned = DMat3::from_quat(turn);
        let mirrored = turned * DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        let sheared =
            DMat3::from_cols(DVec3::new(2.0, 0.1, 0.0), DVec3::new(0.5, 0.7, 0.0), DVec3::new(0.0, -0.3, 1.5));
        let flat = DMat3::from_diagonal(DVec3::new(3.0, 0.25, 1.0));
        let shift = DVec3::new(1.0, -2.0, 0.5);
        for (name, linear, keeps) in [
            ("turned", turned, true),
            ("turned and scaled", turned * 2.5, true),
            ("mirrored", mirrored * 0.5, true),
            ("sheared", sheared, false),
            ("stretched", turned * flat, false),
            ("mirrored and stretched", mirrored * flat, false),
            ("as TURN", TURN, true),
        ] {
            let before = random_gaussians(40, 4, 3);
            let mut after = before.clone();
            let map = DAffine3::from_mat3_translation(linear, shift);
            assert_eq!(transform(&mut after, &map), keeps, "{name}");
            for i in 0..40 {
                let mean = linear * DVec3::from_array(before.mean[i].map(f64::from)) + shift;
                let far = (mean - DVec3::from_array(after.mean[i].map(f64::from))).length();
                assert!(far < 1e-5, "{name}: {far}");
                let expected = linear * covariance(&before, i) * linear.transpose();
                let found = covariance(&after, i);
                let size = expected.x_axis.length().max(expected.y_axis.length()).max(expected.z_axis.length());
                assert!(expected.abs_diff_eq(found, 1e-5 * size), "{name}: {expected} {found}");
                for j in 0..5 {
                    let d = DVec3::new(0.3, -0.5 + f64::from(j) * 0.3, 0.7 - f64::from(i as u32) * 0.1).normalize();
                    let sh = |g: &Gaussians, d| color_of(&g.sh[48 * i..48 * (i + 1)], 3, d);
                    let (a, b) = (sh(&before, d), sh(&after, linear * d));
                    assert!(!keeps || a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5), "{name}: {a:?} {b:?}");
                }
            }
        }
    }

    #[test]
    fn what_changes_nothing_keeps_all_bits_and_what_makes_no_sense_does_no_harm() {
        let before = random_gaussians(9, 4, 2);
        let mut after = before.clone();
        assert!(transform(&mut after, &DAffine3::IDENTITY));
        assert_eq!(after, before);
        let turn = DAffine3::from_mat3(TURN);
        assert!(transform(&mut after, &turn) && after != before);
        assert!(transform(&mut after, &turn));
        assert_eq!(after, before);
        for diagonal in [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::splat(1e300), DVec3::splat(1e-300)] {
            let mut after = before.clone();
            transform(&mut after, &DAffine3::from_mat3(DMat3::from_diagonal(diagonal)));
            assert_eq!((after.len(), after.sh.len()), (before.len(), before.sh.len()));
        }
    }
}
