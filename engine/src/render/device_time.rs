//! How long recorded commands take at best.

use std::time::{Duration, Instant};

use crate::error::Result;
use crate::gpu::{Commands, Gpu};

/// Device time of the last operation, or the host's of all where there are no timestamps, microseconds: the best of so many runs, and
/// of as many more as fit into `at_least`.
///
/// # Errors
/// `DeviceLost`, `TimedOut`.
pub(super) fn best_us(gpu: &Gpu, mut commands: Commands, runs: usize, at_least: Duration) -> Result<f64> {
    let (mut best, mut done, begin) = (f64::INFINITY, 0, Instant::now());
    while done < runs || begin.elapsed() < at_least {
        let start = Instant::now();
        let submission = gpu.submit(&mut commands)?;
        gpu.wait(submission)?;
        let host_us = start.elapsed().as_secs_f64() * 1e6;
        let us = commands.timings()?.last().map_or(host_us, |t| t.us);
        best = best.min(if us > 0.0 { us } else { host_us });
        done += 1;
    }
    Ok(best)
}
