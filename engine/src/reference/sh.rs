//! Real spherical harmonics in the order and with the signs of 3D Gaussian Splatting models.

use glam::DVec3;

/// √(1/4π).
const C0: f64 = 0.282_094_791_773_878_14;
/// √(3/4π).
pub(super) const C1: f64 = 0.488_602_511_902_919_9;
/// √(15/4π), −√(15/4π), √(5/16π), −√(15/4π), √(15/16π).
pub(super) const C2: [f64; 5] = [
    1.092_548_430_592_079_2,
    -1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    -1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];
/// −√(35/32π), √(105/4π), −√(21/32π), √(7/16π), −√(21/32π), √(105/16π), −√(35/32π).
pub(super) const C3: [f64; 7] = [
    -0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    -0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    -0.457_045_799_464_465_8,
    1.445_305_721_320_277,
    -0.590_043_589_926_643_5,
];

/// The (degree + 1)² basis values at unit direction `d`; the rest of the array is 0.
pub(crate) fn basis(d: DVec3, degree: u32) -> [f64; 16] {
    let DVec3 { x, y, z } = d;
    let mut b = [0.0; 16];
    b[0] = C0;
    if degree >= 1 {
        b[1] = -C1 * y;
        b[2] = C1 * z;
        b[3] = -C1 * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        b[4] = C2[0] * x * y;
        b[5] = C2[1] * y * z;
        b[6] = C2[2] * (2.0 * zz - xx - yy);
        b[7] = C2[3] * x * z;
        b[8] = C2[4] * (xx - yy);
    }
    if degree >= 3 {
        b[9] = C3[0] * y * (3.0 * xx - yy);
        b[10] = C3[1] * x * y * z;
        b[11] = C3[2] * y * (4.0 * zz - xx - yy);
        b[12] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        b[13] = C3[4] * x * (4.0 * zz - xx - yy);
        b[14] = C3[5] * z * (xx - yy);
        b[15] = C3[6] * x * (xx - 3.0 * yy);
    }
    b
}

/// max(0, 0.5 + Σ coefficient·basis) per channel. `sh` is `[K,3]`; `offset` = mean − camera position, any length
/// (where it is zero the direction is (0, 0, 0): only even bands' constant terms are left).
pub fn color_of<T: Copy + Into<f64>>(sh: &[T], degree: u32, offset: DVec3) -> [f64; 3] {
    let basis = basis(offset.normalize_or_zero(), degree);
    let mut color = [0.5; 3];
    for (coefficient, b) in sh.chunks_exact(3).zip(basis) {
        for channel in 0..3 {
            color[channel] += b * coefficient[channel].into();
        }
    }
    color.map(|c| c.max(0.0))
}
