#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use super::super::lens::Distortion;
use super::*;

/// Noise with all alphas.
fn picture(size: [u32; 2]) -> Vec<u8> {
    let mut state = 7u32;
    let mut byte = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    (0..4 * size[0] * size[1]).map(|_| byte()).collect()
}

/// Mean of the premultiplied values over an area, in exact fractions of a double.
fn mean(rgba: &[u8], size: [u32; 2], to: [u32; 2], x: u32, y: u32) -> [f64; 4] {
    let ratio = [0, 1].map(|i| f64::from(size[i]) / f64::from(to[i]));
    let area = |i: usize, at: u32| [f64::from(at) * ratio[i], f64::from(at + 1) * ratio[i]];
    let ([x0, x1], [y0, y1]) = (area(0, x), area(1, y));
    let overlap = |a: f64, b: f64, i: u32| (b.min(f64::from(i + 1)) - a.max(f64::from(i))).max(0.0);
    let mut sum = [0.0; 4];
    for j in 0..size[1] {
        for i in 0..size[0] {
            let weight = overlap(x0, x1, i) * overlap(y0, y1, j) / ((x1 - x0) * (y1 - y0));
            let p = &rgba[4 * (j * size[0] + i) as usize..][..4];
            let alpha = f64::from(p[3]);
            (0..3).for_each(|c| sum[c] += weight * f64::from(p[c]) * alpha / 255.0);
            sum[3] += weight * alpha;
        }
    }
    sum
}

#[test]
fn averages_are_the_rounded_means_of_premultiplied_values() {
    for (size, to) in [([8, 6], [8, 6]), ([8, 6], [4, 3]), ([12, 8], [3, 2]), ([7, 5], [3, 2]), ([9, 4], [9, 2])] {
        let rgba = picture(size);
        let exact = whole_factor(size, to).map(|factor| average_blocks(&rgba, size, factor));
        let general = Plane::premultiplied(&rgba, size).averaged(to).packed();
        assert_eq!(exact.is_some(), [[4, 3], [3, 2], [8, 6]].contains(&to) && size != [7, 5], "{size:?} {to:?}");
        for y in 0..to[1] {
            for x in 0..to[0] {
                let expected = mean(&rgba, size, to, x, y);
                let at = (y * to[0] + x) as usize;
                for packed in exact.iter().chain([&general]) {
                    let found = packed[at].to_le_bytes();
                    (0..4).for_each(|c| {
                        let error = (f64::from(found[c]) - expected[c]).abs();
                        assert!(error < 0.5 + 1.0e-4, "{size:?} {to:?} ({x}, {y})[{c}]: {found:?} {expected:?}");
                    });
                    assert!(found[..3].iter().all(|c| *c <= found[3]), "premultiplied: {found:?}");
                }
            }
        }
    }
}

#[test]
fn halves_round_up_and_transparent_colour_does_not_bleed() {
    let two = |a: [u8; 4], b: [u8; 4]| {
        let row = [a, b, a, b].concat();
        average_blocks(&row, [2, 2], 2)[0].to_le_bytes()
    };
    assert_eq!(two([10, 0, 255, 255], [11, 1, 255, 255]), [11, 1, 255, 255]);
    assert_eq!(two([200, 100, 0, 255], [255, 255, 255, 0]), [100, 50, 0, 128]);
    assert_eq!(two([9, 9, 9, 0], [9, 9, 9, 0]), [0; 4]);
}

#[test]
fn undistortion_of_a_pinhole_is_the_picture_itself() {
    let size = [9, 7];
    let plane = Plane::premultiplied(&picture(size), size);
    let lens = Lens { focal: [8.0, 9.0], principal: [4.25, 3.5], skew: 0.0, distortion: Distortion::None };
    let same = plane.undistorted(&lens);
    let worst = same.values.iter().flatten().zip(plane.values.iter().flatten()).map(|(a, b)| (a - b).abs());
    assert!(worst.fold(0.0, f32::max) < 1.0e-3);
    // Skew moves a row by skew · y / focal length.
    let skewed = Lens { skew: 9.0, ..lens };
    assert_eq!(skewed.project(0.0, 1.0 / 9.0), [5.25, 4.5]);
    assert!(!skewed.is_pinhole() && lens.is_pinhole());
}

#[test]
fn a_lens_that_folds_back_is_used_up_to_its_fold() {
    // r (1 − 0.5 r²) is largest at r² = 2/3.
    let distortion = Distortion::brown([-0.5, 0.0, 0.0, 0.0], [0.0; 3], [0.0; 2]);
    let valid = distortion.valid_radius(2.0);
    assert!((valid - (2.0f64 / 3.0).sqrt()).abs() < 0.01, "{valid}");
    assert_eq!(Distortion::None.valid_radius(3.0), 3.0);
    let lens = Lens { focal: [10.0, 10.0], principal: [20.0, 20.0], skew: 0.0, distortion };
    let beyond = source_pixel(&lens, valid, 40.0, 20.0);
    assert!((beyond[0] - lens.project(valid, 0.0)[0]).abs() < 1.0e-9, "{beyond:?}");
    // Numbers that overflow still give a picture.
    let wild = Lens { distortion: Distortion::brown([1.0e300; 4], [-1.0e300; 3], [1.0e300; 2]), ..lens };
    assert!(Plane::premultiplied(&picture([4, 4]), [4, 4]).undistorted(&wild).packed().len() == 16);
}
