//! Time: of the whole command and of a step.

use std::path::Path;
use std::time::{Duration, Instant};

use engine::error::Result;
use engine::gpu::Gpu;
use indicatif::ProgressBar;

use crate::cli::args::Global;
use crate::cli::gpu_session;

/// A step with less than this is not begun, seconds.
pub(super) const LEAST_S: f64 = 0.5;

/// Since when, and how long.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock {
    start: Instant,
    budget: Duration,
}

impl Clock {
    /// Of so many seconds from now on.
    pub(super) fn start(budget_s: f64) -> Self {
        Self { start: Instant::now(), budget: Duration::from_secs_f64(budget_s) }
    }

    /// Of a part that begins now.
    pub(super) fn part(&self, budget: Duration) -> Self {
        Self { start: Instant::now(), budget }
    }

    /// So far.
    pub(super) fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    /// What is left; zero past the end.
    pub(super) fn left(&self) -> Duration {
        self.budget.saturating_sub(self.elapsed())
    }

    /// When it ends.
    pub(super) fn end(&self) -> Instant {
        self.start + self.budget
    }

    /// A share of what is left.
    pub(super) fn share(&self, share: f64) -> Duration {
        self.left().mul_f64(share.clamp(0.0, 1.0))
    }
}

/// What a step gets.
pub(super) struct Context<'a> {
    pub(super) global: &'a Global,
    /// The folder of data sets.
    pub(super) data: Option<&'a Path>,
    /// Its time.
    pub(super) clock: Clock,
    /// Its progress, in milliseconds of its time.
    pub(super) bar: ProgressBar,
}

impl Context<'_> {
    /// The device, not tested before: that is a step of its own.
    pub(super) fn open(&self) -> Result<Gpu> {
        gpu_session::open_untested(self.global)
    }

    /// Shows how much of the time has gone.
    pub(super) fn tick(&self) {
        self.bar.set_position(self.clock.elapsed().as_millis().min(u64::MAX.into()) as u64);
    }

    /// A data set of `--data`, or why it is not there.
    pub(super) fn data_set(&self, name: &str) -> std::result::Result<std::path::PathBuf, String> {
        let Some(folder) = self.data else { return Err(format!("{name} is needed, and --data is not given")) };
        let path = folder.join(name);
        if path.exists() { Ok(path) } else { Err(format!("{} does not exist", path.display())) }
    }
}

/// The first of `sizes`, largest first, that a slow device has time for: the smallest is tried, and `cost` says how much more work
/// one is than another. A GPU gets the first.
pub(super) fn affordable<S: Copy>(
    gpu: &Gpu,
    left: Duration,
    sizes: &[S],
    cost: fn(S) -> f64,
    mut attempt: impl FnMut(S) -> Result<()>,
) -> Result<S> {
    let (largest, smallest) = (sizes[0], sizes[sizes.len() - 1]);
    if !gpu.info().is_cpu() {
        return Ok(largest);
    }
    // The first attempt compiles the kernels.
    attempt(smallest)?;
    let start = Instant::now();
    attempt(smallest)?;
    let once = start.elapsed().as_secs_f64();
    let fits = |s: &S| once * cost(*s) / cost(smallest) <= left.as_secs_f64();
    Ok(sizes.iter().copied().find(fits).unwrap_or(smallest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_what_is_left() {
        let clock = Clock { start: Instant::now() - Duration::from_secs(40), budget: Duration::from_secs(100) };
        let half = clock.share(0.5).as_secs_f64();
        assert!((29.0..=30.0).contains(&half), "{half}");
        let over = Clock { start: Instant::now() - Duration::from_secs(101), ..clock };
        assert_eq!(over.share(1.0), Duration::ZERO);
    }
}
