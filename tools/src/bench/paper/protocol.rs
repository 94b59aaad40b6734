//! Frame rates by two protocols.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use engine::error::Result;
use engine::gpu::Gpu;
use engine::render::{RenderOptions, Renderer};
use engine::scene::{Camera, Scene};
use serde::Serialize;

use crate::report::measure::PAPER_FRAMES;

/// A view of the path and its time.
pub(crate) type Stop = (Camera, f64);

/// Passes over the path at most.
const MAX_PASSES: u32 = 50;
/// Frames of the honest protocol, if there is time.
const FRAMES: usize = 1000;

/// Host times of frames, one at a time, milliseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(crate) struct Percentiles {
    pub(super) p1: f64,
    pub(super) p5: f64,
    pub(super) p50: f64,
    pub(super) p95: f64,
    pub(super) p99: f64,
    /// Mean.
    pub(super) mean: f64,
    /// Mean of the slowest 1 % (at least one frame).
    pub(super) slowest_1_percent: f64,
    /// Frames.
    pub(super) frames: usize,
}

impl Percentiles {
    /// Of `values`, by nearest rank; zeros when there are none.
    fn of(mut values: Vec<f64>) -> Self {
        if values.is_empty() {
            return Self::default();
        }
        values.sort_unstable_by(f64::total_cmp);
        let n = values.len();
        let rank = |q: f64| values[((q * n as f64).ceil() as usize).clamp(1, n) - 1];
        let slow = n.div_ceil(100);
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        Self {
            p1: rank(0.01),
            p5: rank(0.05),
            p50: rank(0.5),
            p95: rank(0.95),
            p99: rank(0.99),
            mean: mean(&values),
            slowest_1_percent: mean(&values[n - slow..]),
            frames: n,
        }
    }
}

/// Both protocols.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Rates {
    /// Paper: one view, t from 0 to 1, frames in flight, no frame is waited for alone.
    pub(crate) paper_fps: f64,
    /// Frames of it: 1000, or fewer where the time is short.
    pub(crate) paper_frames: u32,
    /// The view of it.
    pub(crate) paper_view: String,
    /// Honest: the whole path, each view at its own time, one frame at a time, submission to completion.
    pub(crate) path: Percentiles,
    /// Passes over the path, after one for warm-up.
    pub(crate) passes: u32,
    /// Frames per second over the path, from the mean.
    pub(crate) path_fps: f64,
    /// Frames per second of the slowest 1 %.
    pub(crate) low_1_percent_fps: f64,
    /// Frames per second over the path with frames in flight; absent where views differ in size.
    pub(crate) path_fps_in_flight: Option<f64>,
    /// Frames in flight.
    pub(crate) frames_in_flight: usize,
    /// Frames before anything was measured.
    pub(crate) warmup_frames: u32,
}

/// How many frames of `ms` fit into `time`; at least 3.
pub(super) fn affordable(ms: f64, time: Duration) -> u32 {
    (time.as_secs_f64() * 1e3 / ms.max(1e-3)).clamp(3.0, f64::from(u32::MAX)) as u32
}

/// Measures both protocols within about `budget`.
pub(super) fn measure(
    gpu: &Gpu,
    scene: &Scene,
    options: &RenderOptions,
    path: &[Stop],
    view: usize,
    budget: Duration,
) -> Result<Rates> {
    let mut renderer = Renderer::new(gpu, scene, options)?;
    // One whole pass: buffers grow to what the most demanding view needs, caches and clocks settle.
    let start = Instant::now();
    for (camera, time) in path {
        renderer.draw(camera, *time)?;
    }
    let pass_s = start.elapsed().as_secs_f64();
    let wanted = FRAMES.div_ceil(path.len()) as u32;
    let passes = ((0.4 * budget.as_secs_f64() / pass_s) as u32).clamp(1, wanted.min(MAX_PASSES));
    let mut ms = Vec::new();
    for _ in 0..passes {
        for (camera, time) in path {
            let start = Instant::now();
            renderer.draw(camera, *time)?;
            ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    let percentiles = Percentiles::of(ms);
    let alike = path.windows(2).all(|w| [w[0].0.width, w[0].0.height] == [w[1].0.width, w[1].0.height]);
    let path_fps_in_flight = if alike { Some(in_flight(&mut renderer, path, path.len() as u32)?) } else { None };
    let paper_frames = PAPER_FRAMES.min(affordable(percentiles.p50, budget.mul_f64(0.4)));
    let one: Vec<Stop> =
        (0..paper_frames).map(|i| (path[view].0.clone(), f64::from(i) / f64::from(paper_frames.max(2) - 1))).collect();
    for (camera, time) in one.iter().step_by(one.len().div_ceil(3)) {
        renderer.draw(camera, *time)?;
    }
    Ok(Rates {
        paper_fps: in_flight(&mut renderer, &one, paper_frames)?,
        paper_frames,
        paper_view: format!("{view} ({})", path[view].0.name),
        path: percentiles,
        passes,
        path_fps: 1e3 / percentiles.mean,
        low_1_percent_fps: 1e3 / percentiles.slowest_1_percent,
        path_fps_in_flight,
        frames_in_flight: renderer.frames_in_flight(),
        warmup_frames: path.len() as u32,
    })
}

/// Frames per second over the first `frames` stops with frames in flight. One that outgrew its buffers is drawn again.
fn in_flight(renderer: &mut Renderer, stops: &[Stop], frames: u32) -> Result<f64> {
    let mut pending = VecDeque::new();
    let start = Instant::now();
    for stop in stops.iter().take(frames as usize) {
        if pending.len() == renderer.frames_in_flight()
            && let Some((frame, (camera, time))) = pending.pop_front()
            && renderer.finish(frame)?.is_none()
        {
            renderer.draw(&camera, time)?;
        }
        pending.push_back((renderer.submit(&stop.0, stop.1)?, stop.clone()));
    }
    for (frame, (camera, time)) in pending {
        if renderer.finish(frame)?.is_none() {
            renderer.draw(&camera, time)?;
        }
    }
    Ok(f64::from(frames) / start.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn percentiles_and_the_slowest_percent() {
        let p = Percentiles::of((1..=200).rev().map(f64::from).collect());
        assert_eq!([p.p1, p.p5, p.p50, p.p95, p.p99], [2.0, 10.0, 100.0, 190.0, 198.0]);
        assert_eq!((p.mean, p.slowest_1_percent, p.frames), (100.5, 199.5, 200));
        assert_eq!(Percentiles::of(vec![3.0]).slowest_1_percent, 3.0);
        assert_eq!(Percentiles::of(Vec::new()), Percentiles::default());
    }

    #[test]
    fn what_is_affordable() {
        assert_eq!(affordable(10.0, Duration::from_secs(1)), 100);
        assert_eq!(affordable(1e9, Duration::from_secs(1)), 3);
    }
}
