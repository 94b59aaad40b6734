//! Twin of `glsl/lib/quaternion.glsl` and `left_jacobian.glsl`, line by line: unit quaternions w, x, y, z and the exponential of so(3), in f32.

use super::angle::sin_cos;

/// a · b: rotates by b, then by a.
pub fn product(a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// Exp(r) of an so(3) vector (radians).
pub fn exp(r: [f32; 3]) -> [f32; 4] {
    let angle2 = dot(r, r);
    let angle = angle2.sqrt();
    let half_angle = sin_cos(0.5 * angle);
    let h = if angle2 > 1e-12 { half_angle[0] / angle } else { 0.5 };
    [half_angle[1], h * r[0], h * r[1], h * r[2]]
}

/// (R(e) − I) p for a unit quaternion e.
pub fn displacement(e: [f32; 4], p: [f32; 3]) -> [f32; 3] {
    let v = [e[1], e[2], e[3]];
    let a = cross(v, p).map(|x| 2.0 * x);
    let b = cross(v, a);
    [e[0] * a[0] + b[0], e[0] * a[1] + b[1], e[0] * a[2] + b[2]]
}

/// J_l(r)ᵀω, twin of lib/left_jacobian.glsl: ω − B·r×ω + C·r×(r×ω).
pub fn left_jacobian_transposed(r: [f32; 3], w: [f32; 3]) -> [f32; 3] {
    let angle2 = dot(r, r);
    let angle = angle2.sqrt();
    let h = if angle2 > 1e-12 { sin_cos(0.5 * angle)[0] / angle } else { 0.5 };
    let b = 2.0 * h * h;
    let last = 1.0 / 362_880.0 - angle2 * (1.0 / 39_916_800.0);
    let series = 1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 * (1.0 / 5040.0 - angle2 * last));
    let c = if angle2 < 1.0 { series } else { (angle - sin_cos(angle)[0]) / (angle2 * angle.max(1.0)) };
    let turned = cross(r, w);
    let twice = cross(r, turned);
    std::array::from_fn(|i| w[i] - b * turned[i] + c * twice[i])
}

/// Columns of the rotation matrix of a unit quaternion.
pub fn columns(q: [f32; 4]) -> [[f32; 3]; 3] {
    let [w, x, y, z] = q;
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Scalar product.
pub fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
pub fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use std::f32::consts::{PI, TAU};

    fn angles() -> impl Iterator<Item = f32> {
        [0.0, 1e-20, 1e-7, 1e-6, 1e-4, 1e-2, 0.5, 3.0, PI, TAU - 1e-3, 7.0, 50.0, 1000.0].into_iter()
    }

    #[test]
    fn exp_and_displacement_agree_with_f64() {
        let axis = DVec3::new(0.36, -0.48, 0.8);
        let p = [0.3_f32, -1.2, 2.5];
        for angle in angles() {
            let r = [axis.x as f32 * angle, axis.y as f32 * angle, axis.z as f32 * angle];
            let rd = DVec3::new(f64::from(r[0]), f64::from(r[1]), f64::from(r[2]));
            let truth = DQuat::from_scaled_axis(rd);
            let pd = DVec3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]));
            let moved = truth * pd - pd;
            let ours = displacement(exp(r), p);
            // The angle itself is a f32: half an ulp of it turns the point.
            let bound = 1e-6 + 1.2e-7 * f64::from(angle) * 3.0;
            for i in 0..3 {
                assert!((f64::from(ours[i]) - moved[i]).abs() < bound, "{angle}: {ours:?} {moved}");
            }
            let columns = columns(exp(r));
            let x = truth * DVec3::X;
            assert!((f64::from(columns[0][1]) - x.y).abs() < bound);
        }
    }

    #[test]
    fn product_is_composition() {
        let (a, b) = (exp([0.1, 0.7, -0.4]), exp([-1.1, 0.2, 0.9]));
        let p = [1.0_f32, 2.0, -0.5];
        let apply = |q, p: [f32; 3]| {
            let d = displacement(q, p);
            [p[0] + d[0], p[1] + d[1], p[2] + d[2]]
        };
        let (one, two) = (apply(product(a, b), p), apply(a, apply(b, p)));
        for i in 0..3 {
            assert!((one[i] - two[i]).abs() < 2e-6);
        }
    }

    #[test]
    fn no_motion_is_exactly_nothing() {
        assert_eq!(displacement(exp([0.0; 3]), [1e6, -3.7, 12.0]), [0.0; 3]);
    }
}
