//! What is known of a setting when it was measured.

use std::collections::BTreeMap;

use serde::Serialize;

use super::settings::Setting;
use crate::report::measure::Quantiles;

/// A value off by more than this is visible in an 8-bit picture.
pub(super) const VISIBLE: f64 = 1.0 / 255.0;
/// Share of values that may be off by more for a setting to count as without visible error.
pub(super) const VISIBLE_SHARE: f64 = 1e-4;

/// How far the images of a setting are from the f64 reference, over all views.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(super) struct ErrorOf {
    /// dB, of the mean square over all values.
    pub(super) psnr: f64,
    /// Root of the mean square.
    pub(super) rmse: f64,
    /// Largest difference.
    pub(super) max: f64,
    /// 99.9 % of the values are within this.
    pub(super) q999: f64,
    /// Share of values off by more than 1/255.
    pub(super) visible: f64,
    /// Whether so few values are off by more than 1/255 that nobody sees it.
    pub(super) invisible: bool,
    /// Mean FLIP over the views.
    pub(super) flip: f64,
}

/// A setting with what it costs and what it gives up.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Measured {
    #[serde(flatten)]
    pub(super) setting: Setting,
    /// Host time from submission to the finished frame.
    pub(super) frame_ms: Quantiles,
    /// Processor time of a frame, all threads; only for a device that is a CPU. Such a machine's speed drifts, so it is the
    /// median ratio to an exact frame that is drawn just before each frame, times what the first exact frames took.
    pub(super) processor_ms: Option<f64>,
    /// Median device time of each stage; empty without timestamps.
    pub(super) stage_ms: BTreeMap<&'static str, f64>,
    /// Bytes that the frame's kernels move at least.
    pub(super) bytes: u64,
    /// Bytes of the model on the device.
    pub(super) scene_bytes: u64,
    /// Dispatches of a frame.
    pub(super) dispatches: usize,
    /// (Gaussian, tile) pairs of the last frame.
    pub(super) instances: u64,
    /// Against the f64 reference.
    pub(super) error: ErrorOf,
    /// PSNR against the photos, dB, mean over the views.
    pub(super) photo_psnr: Option<f64>,
    /// No other setting is both faster and more accurate.
    pub(super) pareto: bool,
}

impl Measured {
    /// The time that settings are compared by, milliseconds: of the frame, or of the processor where it is the device.
    pub(super) fn ms(&self) -> f64 {
        self.processor_ms.unwrap_or(self.frame_ms.median)
    }
}

#[cfg(test)]
impl Measured {
    pub(super) fn for_tests(name: &str, ms: f64, rmse: f64) -> Self {
        let quality = engine::render::Quality::EXACT;
        let kind = super::settings::Kind::Exact;
        Self {
            setting: Setting { name: name.into(), kind, quality, network: false },
            frame_ms: Quantiles { median: ms, p5: ms, p95: ms },
            processor_ms: None,
            stage_ms: BTreeMap::new(),
            bytes: 0,
            scene_bytes: 0,
            dispatches: 0,
            instances: 0,
            error: ErrorOf { rmse, ..ErrorOf::default() },
            photo_psnr: None,
            pareto: false,
        }
    }
}
