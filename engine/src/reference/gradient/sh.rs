//! Backward of the colour: SH coefficients and viewing direction.

use glam::DVec3;

use crate::reference::sh::{C1, C2, C3, basis};

/// Gradient of each basis function, taken as the polynomial in x, y, z that `basis` evaluates. Polynomials that agree on the
/// sphere differ in the radial part only, which the caller projects out.
fn basis_gradient(d: DVec3, degree: u32) -> [DVec3; 16] {
    let DVec3 { x, y, z } = d;
    let v = DVec3::new;
    let mut b = [DVec3::ZERO; 16];
    if degree >= 1 {
        b[1] = v(0.0, -C1, 0.0);
        b[2] = v(0.0, 0.0, C1);
        b[3] = v(-C1, 0.0, 0.0);
    }
    if degree >= 2 {
        b[4] = C2[0] * v(y, x, 0.0);
        b[5] = C2[1] * v(0.0, z, y);
        b[6] = C2[2] * v(-2.0 * x, -2.0 * y, 4.0 * z);
        b[7] = C2[3] * v(z, 0.0, x);
        b[8] = C2[4] * v(2.0 * x, -2.0 * y, 0.0);
    }
    if degree >= 3 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        b[9] = C3[0] * v(6.0 * x * y, 3.0 * (xx - yy), 0.0);
        b[10] = C3[1] * v(y * z, x * z, x * y);
        b[11] = C3[2] * v(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
        b[12] = C3[3] * v(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy);
        b[13] = C3[4] * v(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
        b[14] = C3[5] * v(2.0 * x * z, -2.0 * y * z, xx - yy);
        b[15] = C3[6] * v(3.0 * (xx - yy), -6.0 * x * y, 0.0);
    }
    b
}

/// Gradients of the `[K,3]` coefficients and of `offset` = mean − camera position, given dL/d colour before the clamp at 0.
pub fn color_gradient(sh: &[f64], degree: u32, offset: DVec3, gradient: [f64; 3]) -> (Vec<f64>, DVec3) {
    let direction = offset.normalize_or_zero();
    let (values, slopes) = (basis(direction, degree), basis_gradient(direction, degree));
    let coefficients = (0..sh.len()).map(|i| values[i / 3] * gradient[i % 3]).collect();
    let along: DVec3 = (0..sh.len()).map(|i| slopes[i / 3] * (sh[i] * gradient[i % 3])).sum();
    let length = offset.length();
    let tangent = if length > 0.0 { (along - direction * direction.dot(along)) / length } else { DVec3::ZERO };
    (coefficients, tangent)
}
