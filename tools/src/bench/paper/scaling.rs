//! How the cost of a frame grows: with Gaussians, superpoints and pixels, and the exponent of a power law fitted to it.

use std::time::{Duration, Instant};

use engine::error::{Error, Result};
use engine::gpu::Gpu;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::moving_scene;
use serde::Serialize;

use crate::bench::scene::{DEFAULT_SIZE, SYNTHETIC_KEYS, SYNTHETIC_SEED};
use crate::cli::camera;
use crate::report::measure::Quantiles;

/// Values of each curve; the others stay at [`BASE`] or [`CPU_BASE`].
const GAUSSIANS: [u32; 7] = [10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000];
const SUPERPOINTS: [u32; 5] = [1, 10, 100, 1_000, 10_000];
const SIDES: [u32; 6] = [100, 200, 400, 800, 1_600, 3_200];
/// Gaussians, superpoints and image side that are not varied.
const BASE: [u32; 3] = [100_000, 300, DEFAULT_SIZE];
/// The same on a CPU, where a frame of the other takes half a second.
const CPU_BASE: [u32; 3] = [30_000, 300, 400];
/// Measured frames of a point and frames before.
const FRAMES: [u32; 2] = [7, 2];
/// A point may take this many times what the one before it took, times the growth that theory allows.
const CAUTION: f64 = 1.3;
/// A point takes at least the square root of the ratio of the values longer: scenes are made on the host.
const LEAST_GROWTH: f64 = 0.5;
/// Fewer points than this say nothing of an exponent.
const FEWEST: usize = 4;
/// An exponent is as the theory says when it is within its range widened by this.
const SLACK: f64 = 0.15;

/// One measured size.
#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) struct Point {
    /// Gaussians, superpoints or pixels.
    pub(super) x: f64,
    /// Host time of a frame, one at a time, median, milliseconds.
    pub(super) frame_ms: f64,
    /// Device time, median, milliseconds; equal to the host's where there are no timestamps.
    pub(super) device_ms: f64,
    /// Visible Gaussians.
    pub(super) visible: u32,
    /// Tile instances.
    pub(super) instances: u64,
}

/// A curve.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Curve {
    /// What is varied.
    pub(super) name: &'static str,
    /// What is not, in words.
    pub(super) fixed: String,
    /// What the theory says, in words.
    pub(super) theory: &'static str,
    /// Range of the exponent that it allows.
    pub(super) range: [f64; 2],
    /// From small to large.
    pub(super) points: Vec<Point>,
    /// Exponent over all points, of device time.
    pub(super) exponent: Option<f64>,
    /// Exponent over the larger half.
    pub(super) tail_exponent: Option<f64>,
    /// Whether the exponent of the larger half lies in the range.
    pub(super) as_theory: Option<bool>,
    /// Why it ends where it ends.
    pub(super) ended: String,
}

/// Slope of ln y against ln x, least squares; `None` for fewer than two different x.
pub(super) fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let (mx, my) = logs.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let (xx, xy) = logs.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + (x - mx).powi(2), b + (x - mx) * (y - my)));
    (logs.len() > 1 && xx > 0.0).then(|| xy / xx)
}

/// All curves, within about `budget`: a third for each, what one leaves over goes to the next.
pub(super) fn curves(gpu: &Gpu, budget: Duration) -> Result<Vec<Curve>> {
    let start = Instant::now();
    let base = if gpu.info().kind == "cpu" { CPU_BASE } else { BASE };
    let [n, m, side] = base;
    let until = |share: f64| start + budget.mul_f64(share);
    let linear = "a fixed cost of dispatches, then linear: every kernel but the blend touches each Gaussian a fixed number of times";
    let flat = "flat: a Gaussian reads two key poses of its superpoint, however many there are";
    let pixels = "flat while Gaussians dominate, then linear in pixels: blending and what each tile lists";
    let superpoints = SUPERPOINTS.map(|m| [n, m, side]);
    let sides = SIDES.map(|side| [n, m, side]);
    let gaussians = GAUSSIANS.map(|n| [n, m, side]);
    Ok(vec![
        curve(gpu, ("superpoints", base), &superpoints, (flat, [0.0, 0.0]), until(0.25))?,
        curve(gpu, ("pixels", base), &sides, (pixels, [0.0, 1.0]), until(0.5))?,
        curve(gpu, ("Gaussians", base), &gaussians, (linear, [0.0, 1.0]), until(1.0))?,
    ])
}

fn x_of(name: &str, [n, m, side]: [u32; 3]) -> f64 {
    match name {
        "superpoints" => f64::from(m),
        "pixels" => f64::from(side) * f64::from(side),
        _ => f64::from(n),
    }
}

fn curve(
    gpu: &Gpu,
    (name, [n, m, side]): (&'static str, [u32; 3]),
    sizes: &[[u32; 3]],
    (theory, range): (&'static str, [f64; 2]),
    until: Instant,
) -> Result<Curve> {
    let mut points: Vec<Point> = Vec::new();
    let mut ended = "at the end of the list".to_owned();
    let mut last: Option<(f64, f64)> = None;
    for &size in sizes {
        let x = x_of(name, size);
        let growth = |before: f64| (x / before).max(1.0).powf(range[1].max(LEAST_GROWTH));
        let expected = last.map_or(0.0, |(before, seconds)| seconds * growth(before) * CAUTION);
        let left = until.saturating_duration_since(Instant::now()).as_secs_f64();
        if expected > left && points.len() > 1 {
            ended = format!("before {x:.0}: it would take about {expected:.0} s, {left:.0} s of the budget are left");
            break;
        }
        let start = Instant::now();
        match point(gpu, x, size) {
            Ok(point) => points.push(point),
            Err(error @ (Error::Limit { .. } | Error::OutOfMemory { .. })) => {
                ended = format!("before {x:.0}: {error}");
                break;
            }
            Err(error) => return Err(error),
        }
        last = Some((x, start.elapsed().as_secs_f64()));
    }
    let pairs: Vec<(f64, f64)> = points.iter().map(|p| (p.x, p.device_ms)).collect();
    // The larger half, and three points at least.
    let tail = exponent(&pairs[(pairs.len() / 2).min(pairs.len().saturating_sub(3))..]);
    let fixed = match name {
        "superpoints" => format!("{n} Gaussians, {side}×{side} pixels"),
        "pixels" => format!("{n} Gaussians, {m} superpoints"),
        _ => format!("{m} superpoints, {side}×{side} pixels"),
    };
    Ok(Curve {
        name,
        fixed,
        theory,
        range,
        exponent: exponent(&pairs),
        tail_exponent: tail,
        as_theory: tail.filter(|_| points.len() >= FEWEST).map(|e| (range[0] - SLACK..=range[1] + SLACK).contains(&e)),
        points,
        ended,
    })
}

fn point(gpu: &Gpu, x: f64, [n, m, side]: [u32; 3]) -> Result<Point> {
    // The largest arrays are checked before the scene is made: 15 SH coefficients of degree 3, three channels.
    let (need, have) = (u128::from(n) * 7 * 3 * 4, u128::from(gpu.info().capabilities.max_storage_buffer_range));
    if need > have {
        return Err(Error::Limit { what: format!("bytes of the SH of {n} Gaussians"), need, have });
    }
    let scene = moving_scene(n as usize, m as usize, SYNTHETIC_KEYS, SYNTHETIC_SEED, false);
    let options = RenderOptions { profile: true, ..RenderOptions::default() };
    let mut renderer = Renderer::new(gpu, &scene, &options)?;
    let camera = camera::default_camera(&scene, [side, side]);
    let [frames, warmup] = FRAMES;
    let (mut host, mut device) = (Vec::new(), Vec::new());
    let mut statistics = renderer.draw(&camera, 0.0)?.1;
    for i in 0..frames + warmup {
        let time = f64::from(i) / f64::from(frames + warmup);
        let start = Instant::now();
        let (frame, counted) = renderer.draw(&camera, time)?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        statistics = counted;
        if i >= warmup {
            host.push(ms);
            let timings = renderer.timings(frame)?;
            device.push(timings.iter().filter(|t| !t.label.starts_with("host read")).map(|t| t.us / 1e3).sum::<f64>());
        }
    }
    let (frame_ms, device_ms) = (Quantiles::of(host).median, Quantiles::of(device).median);
    let device_ms = if device_ms > 0.0 { device_ms } else { frame_ms };
    Ok(Point { x, frame_ms, device_ms, visible: statistics.visible, instances: statistics.instances })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn power_laws_give_their_exponent() {
        for power in [0.0, 0.5, 1.0, 2.0] {
            let points: Vec<(f64, f64)> = (1..6).map(|i| (f64::from(i), 3.0 * f64::from(i).powf(power))).collect();
            assert!((exponent(&points).unwrap() - power).abs() < 1e-12);
        }
        assert_eq!(exponent(&[(1.0, 2.0)]), None);
        assert_eq!(exponent(&[(1.0, 2.0), (1.0, 3.0)]), None);
    }

    #[test]
    fn each_curve_varies_what_it_says() {
        assert_eq!(["superpoints", "pixels", "Gaussians"].map(|n| x_of(n, [7, 5, 3])), [5.0, 9.0, 7.0]);
    }
}
