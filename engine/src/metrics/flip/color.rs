//! Colour spaces of FLIP (supplement of the paper): sRGB, linear RGB, XYZ, YCxCz, L*a*b*.

use crate::metrics::planes::Planes;
use rayon::prelude::*;

/// Linear RGB to XYZ, D65.
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];
/// XYZ to linear RGB.
const RGB_FROM_XYZ: [[f64; 3]; 3] = [
    [3.241_003_275, -1.537_398_934, -0.498_615_865],
    [-0.969_224_334, 1.875_930_071, 0.041_554_224],
    [0.055_639_423, -0.204_011_202, 1.057_148_933],
];
/// XYZ of white.
const WHITE: [f64; 3] = [0.950_428_545, 1.0, 1.088_900_371];

/// The same matrices and white for the work on every pixel.
const XYZ_FROM_RGB_F32: [[f32; 3]; 3] = narrow(XYZ_FROM_RGB);
const RGB_FROM_XYZ_F32: [[f32; 3]; 3] = narrow(RGB_FROM_XYZ);
const WHITE_F32: [f32; 3] = [WHITE[0] as f32, WHITE[1] as f32, WHITE[2] as f32];

const fn narrow(m: [[f64; 3]; 3]) -> [[f32; 3]; 3] {
    let mut out = [[0.0; 3]; 3];
    let mut i = 0;
    while i < 9 {
        out[i / 3][i % 3] = m[i / 3][i % 3] as f32;
        i += 1;
    }
    out
}

fn linear(srgb: f64) -> f64 {
    if srgb <= 0.04045 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}

/// Pixels that a thread converts at once.
const PIXELS_AT_ONCE: usize = 4096;

/// YCxCz planes of a picture that is read as sRGB: achromatic, red-green, blue-yellow.
pub(super) fn opponent(planes: &Planes) -> [Vec<f32>; 3] {
    // Values of 8-bit pictures come from a table.
    let table: Vec<[f64; 2]> = (0..256).map(|k| f64::from(k) / 255.0).map(|v| [v, linear(v)]).collect();
    let decode = |v: f64| match table.get((v * 255.0 + 0.5) as usize) {
        Some([value, decoded]) if *value == v => *decoded,
        _ => linear(v),
    };
    let [r, g, b] = &planes.rgb;
    let mut out: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; planes.pixels()]);
    let [y, cx, cz] = out.each_mut().map(|plane| plane.par_chunks_mut(PIXELS_AT_ONCE));
    y.zip(cx).zip(cz).enumerate().for_each(|(chunk, ((y, cx), cz))| {
        for k in 0..y.len() {
            let i = chunk * PIXELS_AT_ONCE + k;
            [y[k], cx[k], cz[k]] = ycxcz([decode(r[i]), decode(g[i]), decode(b[i])]).map(|v| v as f32);
        }
    });
    out
}

fn ycxcz([r, g, b]: [f64; 3]) -> [f64; 3] {
    let row = |i: usize| (XYZ_FROM_RGB[i][0] * r + XYZ_FROM_RGB[i][1] * g + XYZ_FROM_RGB[i][2] * b) / WHITE[i];
    let (x, y, z) = (row(0), row(1), row(2));
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Filtered YCxCz → linear RGB clamped to [0, 1] → L*a*b* with Hunt's effect.
#[inline(always)]
pub(super) fn adapted([y, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (y + 16.0) / 116.0;
    let (x, z) = ((y + cx / 500.0) * WHITE_F32[0], (y - cz / 200.0) * WHITE_F32[2]);
    let row = |i: usize| {
        let m = &RGB_FROM_XYZ_F32[i];
        (m[0] * x + m[1] * y + m[2] * z).clamp(0.0, 1.0)
    };
    hunt(lab([row(0), row(1), row(2)]))
}

#[inline(always)]
fn lab([r, g, b]: [f32; 3]) -> [f32; 3] {
    let f = |v: f32| {
        const DELTA: f32 = 6.0 / 29.0;
        if v > DELTA * DELTA * DELTA { cube_root(v) } else { v / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
    };
    let row = |i: usize| {
        let m = &XYZ_FROM_RGB_F32[i];
        f((m[0] * r + m[1] * g + m[2] * b) / WHITE_F32[i])
    };
    let (x, y, z) = (row(0), row(1), row(2));
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Cube root of a number from 0.001 to 2, to f32's precision: a guess by the exponent, then two steps of Halley's method
/// (several times as fast as the library's, which FLIP would spend half its time in).
#[inline(always)]
fn cube_root(v: f32) -> f32 {
    let guess = f32::from_bits(v.to_bits() / 3 + 0x2A51_19F2);
    let step = |r: f32| {
        let cube = r * r * r;
        r * (cube + v + v) / (cube + cube + v)
    };
    step(step(guess))
}

/// Colours of bright pixels look stronger.
#[inline(always)]
fn hunt([l, a, b]: [f32; 3]) -> [f32; 3] {
    [l, 0.01 * l * a, 0.01 * l * b]
}

/// City-block in lightness, Euclidean in colour.
pub(super) fn hyab(p: [f32; 3], q: [f32; 3]) -> f32 {
    let (a, b) = (p[1] - q[1], p[2] - q[2]);
    (p[0] - q[0]).abs() + (a * a + b * b).sqrt()
}

/// The largest distance there is, between pure green and pure blue.
pub(super) fn largest_distance() -> f32 {
    hyab(hunt(lab([0.0, 1.0, 0.0])), hunt(lab([0.0, 0.0, 1.0])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_and_black_are_where_they_belong() {
        let close = |a: [f32; 3], b: [f32; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 1e-3);
        assert!(close(lab([1.0; 3]), [100.0, 0.0, 0.0]) && close(lab([0.0; 3]), [0.0; 3]));
        let there = ycxcz([0.2, 0.5, 0.9]).map(|v| v as f32);
        assert!(close(adapted(there), hunt(lab([0.2, 0.5, 0.9]))), "the way there and back");
        assert!((linear(0.5) - 0.214_041_14).abs() < 1e-7);
        assert!((1..2000).map(|i| i as f32 / 1000.0).all(|v| (cube_root(v) - v.cbrt()).abs() < 3e-7));
    }
}
