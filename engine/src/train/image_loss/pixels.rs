//! What the kernels of the loss share: window, target, which values can be used. Mirrors `glsl/lib/ssim.glsl` and
//! `glsl/lib/image_target.glsl`.

use super::{LossStage, TargetFormat};
use crate::data::pixels::LEFT_OUT;
use crate::render::frame::Frame;
use crate::render::twin::f32_at;

/// Rendered values beyond ± this count as not finite: their fourth power must stay a number.
pub const MAX_COLOR: f32 = 1.0e6;
/// 0.01².
pub const SSIM_C1: f32 = 1.0e-4;
/// 0.03².
pub const SSIM_C2: f32 = 9.0e-4;
/// Pixels of the window on each side of its centre.
pub(super) const WINDOW_RADIUS: usize = 5;
/// exp(−i²/(2·1.5²)) for i = −5…5, normalised to sum 1.
pub const WINDOW: [f32; 11] = [
    0.0010283801,
    0.007598758,
    0.036000773,
    0.10936069,
    0.21300554,
    0.26601172,
    0.21300554,
    0.10936069,
    0.036000773,
    0.007598758,
    0.0010283801,
];

/// Whether a value takes part in the loss.
pub(super) fn usable(x: f32) -> bool {
    x.abs() <= MAX_COLOR
}

/// Target value of a channel; `kind` as the spec constant `TARGET`.
pub(super) fn target_value(frame: &Frame, target: &[u32], kind: u32, pixel: usize, channel: usize) -> f32 {
    if kind == 1 {
        return f32_at(target, 4 * pixel + channel);
    }
    let word = target[pixel];
    let premultiplied = ((word >> (8 * channel)) & 255) as f32;
    let rest = (255 - (word >> 24)) as f32;
    (premultiplied + rest * frame.background[channel]) / 255.0
}

/// Whether a mask leaves the pixel out.
pub(super) fn is_left_out(target: &[u32], kind: u32, pixel: usize) -> bool {
    kind == TargetFormat::MaskedRgba8 as u32 && target[pixel] == LEFT_OUT
}

/// (rendered, target) of a channel; where either cannot be used, or a mask leaves the pixel out, both are the same.
pub(super) fn image_and_target(
    frame: &Frame,
    [color, target]: [&[u32]; 2],
    kind: u32,
    pixel: usize,
    channel: usize,
) -> [f32; 2] {
    let x = f32_at(color, 4 * pixel + channel);
    let y = target_value(frame, target, kind, pixel, channel);
    let good = usable(y);
    let y = if good { y } else { 0.0 };
    if is_left_out(target, kind, pixel) {
        return [if usable(x) { x } else { 0.0 }; 2];
    }
    [if good && usable(x) { x } else { y }, y]
}

/// Convolves planes of a `width` × `height` image with the window, along rows and then along columns, zeros outside.
pub(super) fn convolve<const P: usize>(values: &[[f32; P]], width: usize, height: usize) -> Vec<[f32; P]> {
    let along = |from: &[[f32; P]], step: usize, at: usize, position: usize, length: usize| {
        let mut sum = [0.0; P];
        for (k, weight) in WINDOW.iter().enumerate() {
            let place = position + k;
            if (WINDOW_RADIUS..length + WINDOW_RADIUS).contains(&place) {
                let source = from[at + place * step - WINDOW_RADIUS * step - position * step];
                for p in 0..P {
                    sum[p] += weight * source[p];
                }
            }
        }
        sum
    };
    let rows: Vec<_> = (0..width * height).map(|i| along(values, 1, i, i % width, width)).collect();
    (0..width * height).map(|i| along(&rows, width, i, i / width, height)).collect()
}

/// Sums over the pixels of each workgroup of a channel, with the workgroup's number.
pub(super) fn sums_of_groups(
    frame: &Frame,
    stage: LossStage,
    channel: u32,
    mut value: impl FnMut(usize) -> f32,
) -> Vec<(usize, f32)> {
    let [width, height] = frame.size;
    let mut sums = vec![0.0; stage.groups(width, height) as usize];
    for i in 0..width * height {
        sums[stage.group_of(channel, [i % width, i / width], width) as usize] += value(i as usize);
    }
    sums.into_iter().enumerate().skip(channel as usize).step_by(3).collect()
}

/// Word of pixel i of a map.
pub(super) fn map_at(frame: &Frame, map: usize, i: usize) -> usize {
    let [width, height] = frame.size.map(|s| s as usize);
    let stride = width.next_multiple_of(4);
    (map * height + i / width) * stride + i % width
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
    use super::*;

    #[test]
    fn window_is_the_gaussian_and_glsl_has_the_same() {
        let value = |i: f64| (-(i - 5.0) * (i - 5.0) / 4.5).exp();
        let sum: f64 = (0..11).map(|i| value(f64::from(i))).sum();
        for (i, w) in WINDOW.iter().enumerate() {
            assert_eq!(*w, (value(i as f64) / sum) as f32, "{i}");
        }
        let glsl = include_str!("../../../../glsl/lib/ssim.glsl");
        let list = glsl.split_once("float[11](").expect("a window").1.split_once(')').expect("its end").0;
        let words: Vec<f32> = list.split(',').map(|w| w.trim().parse().unwrap()).collect();
        assert_eq!(words, WINDOW);
    }
}
