//! Temporal flicker: how much a rendering changes from frame to frame where the truth does not.
//!
//! A pixel is static between two frames when no channel of the truth changes by more than a threshold. The flicker of a
//! pair of frames is the root mean square, over static pixels and channels, of the change of the rendering minus the
//! change of the truth. (Frames of one fixed camera; with a moving camera nothing is static.)

use super::planes::{Planes, same_size};
use crate::error::{Error, Result};

/// Largest change of a static value: half a step of an 8-bit picture on each side.
pub const STATIC_CHANGE: f64 = 1.0 / 255.0;

/// Flicker of a sequence.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Flicker {
    /// Root mean square change that the truth does not have, over all static values of all pairs of neighbouring frames;
    /// `None` when nothing is static.
    pub rms: Option<f64>,
    /// The largest such change; 0 when nothing is static.
    pub max: f64,
    /// Share of static pixels, mean over the pairs.
    pub static_share: f64,
    /// Pairs of neighbouring frames.
    pub pairs: usize,
}

/// Flicker of sequences that come frame by frame.
#[derive(Debug, Clone)]
pub struct FlickerMeter {
    static_change: f64,
    squares: f64,
    values: usize,
    max: f64,
    share: f64,
    pairs: usize,
}

impl FlickerMeter {
    /// An empty meter; `static_change` as [`STATIC_CHANGE`].
    pub fn new(static_change: f64) -> Self {
        Self { static_change, squares: 0.0, values: 0, max: 0.0, share: 0.0, pairs: 0 }
    }

    /// Adds two neighbouring frames of one camera, the earlier first.
    ///
    /// # Errors
    /// [`Error::Usage`] for pictures of different sizes.
    pub fn pair(&mut self, truth: [&Planes; 2], test: [&Planes; 2]) -> Result<()> {
        for other in [truth[1], test[0], test[1]] {
            same_size(truth[0], other)?;
        }
        let change = |pair: [&Planes; 2], c: usize, i: usize| pair[1].rgb[c][i] - pair[0].rgb[c][i];
        // Values of 8-bit pictures are multiples of the threshold, but for rounding.
        let bound = self.static_change * (1.0 + 1e-9);
        let mut pixels = 0;
        for i in (0..truth[0].pixels()).filter(|i| (0..3).all(|c| change(truth, c, *i).abs() <= bound)) {
            pixels += 1;
            for c in 0..3 {
                let extra = change(test, c, i) - change(truth, c, i);
                self.squares += extra * extra;
                self.max = self.max.max(extra.abs());
            }
        }
        self.values += 3 * pixels;
        self.share += pixels as f64 / truth[0].pixels() as f64;
        self.pairs += 1;
        Ok(())
    }

    /// What was measured; `None` without a pair.
    pub fn result(&self) -> Option<Flicker> {
        let rms = (self.values > 0).then(|| (self.squares / self.values as f64).sqrt());
        let static_share = self.share / self.pairs as f64;
        (self.pairs > 0).then_some(Flicker { rms, max: self.max, static_share, pairs: self.pairs })
    }
}

/// Flicker of `test` against `truth`, frame by frame in order of time.
///
/// # Errors
/// [`Error::Usage`] for fewer than two frames, lists of different lengths, or pictures of different sizes.
pub fn flicker(truth: &[Planes], test: &[Planes], static_change: f64) -> Result<Flicker> {
    let wrong = || {
        let found = format!("{} frames of truth, {} rendered", truth.len(), test.len());
        Error::usage("flicker", found, "two or more, equally many")
    };
    if truth.len() != test.len() {
        return Err(wrong());
    }
    let mut meter = FlickerMeter::new(static_change);
    for (truth, test) in truth.windows(2).zip(test.windows(2)) {
        meter.pair([&truth[0], &truth[1]], [&test[0], &test[1]])?;
    }
    meter.result().ok_or_else(wrong)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn frame(values: [f64; 2]) -> Planes {
        Planes { width: 2, height: 1, rgb: std::array::from_fn(|_| values.to_vec()) }
    }

    #[test]
    fn only_static_pixels_count() {
        let truth = [frame([0.5, 0.0]), frame([0.5, 1.0]), frame([0.5, 0.0])];
        let test = [frame([0.5, 0.3]), frame([0.6, 0.9]), frame([0.5, 0.1])];
        let f = flicker(&truth, &test, STATIC_CHANGE).unwrap();
        assert!((f.rms.unwrap() - 0.1).abs() < 1e-12 && (f.max - 0.1).abs() < 1e-12 && f.static_share == 0.5, "{f:?}");
        assert_eq!(flicker(&truth, &truth, STATIC_CHANGE).unwrap().rms, Some(0.0));
        let moving = [frame([0.0, 0.0]), frame([1.0, 1.0])];
        assert_eq!(flicker(&moving, &moving, STATIC_CHANGE).unwrap().rms, None);
        assert!(flicker(&truth, &test[..2], STATIC_CHANGE).is_err());
        assert!(flicker(&truth[..1], &test[..1], STATIC_CHANGE).is_err());
    }
}
