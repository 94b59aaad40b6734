//! Settings that change nothing of what is learnt: limits, measurements, the exported model.

use serde::{Deserialize, Serialize};

/// Hard limits; growth stops there and training goes on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BudgetConfig {
    /// Most Gaussians.
    pub max_gaussians: u32,
    /// Most bytes of device memory; 0: what the device offers.
    pub max_bytes: u64,
    /// Most bytes of decoded images kept in host memory.
    pub image_bytes: u64,
    /// Most bytes of photos kept on the device, four per pixel; at most an eighth of what it offers, and what one binding holds.
    /// The others are uploaded for each of their steps: 4 bytes per pixel over the bus, 0.16 ms for 800×800 pixels at 16 GB/s;
    /// nothing to be measured where device and host share memory (lavapipe: 10.5–11.5 s of processor time for 150 steps with every
    /// photo uploaded, 10.7–11.9 s with all resident). 0: all are uploaded.
    pub photo_bytes: u64,
}

/// What is measured and written during the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// Held-out views are evaluated every so many iterations; 0: only at the end.
    pub evaluate_interval: u64,
    /// How many of them.
    pub evaluate_views: u32,
    /// A line in `run.jsonl` every so many iterations.
    pub interval: u64,
    /// A checkpoint every so many iterations; 0: only at the end and when interrupted.
    pub checkpoint_interval: u64,
    /// Parameters, moments, association and networks are searched for numbers that are not finite every so many iterations,
    /// and before every checkpoint; gradients are watched at every step. 0: at checkpoints only.
    pub finite_interval: u64,
}

/// What the exported model keeps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExportConfig {
    /// Largest error of the key-time table on the training cameras, pixels.
    pub motion_error_px: f64,
    /// Keep network F and the association in the model (then every superpoint stays too).
    pub keep_network: bool,
    /// Largest change of a pixel that leaving out an SH degree may cause on the training cameras, in units of 1/255.
    pub sh_error: f64,
}

impl LogConfig {
    /// Whether `iteration` gets a line in `run.jsonl`: the first one does.
    pub fn logs(&self, iteration: u64) -> bool {
        iteration == 1 || Self::due(self.interval, iteration)
    }

    /// Whether something that is done every `interval` iterations, 0 for never, is done after `iteration`.
    pub fn due(interval: u64, iteration: u64) -> bool {
        interval > 0 && iteration.is_multiple_of(interval)
    }
}
