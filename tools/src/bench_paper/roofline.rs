//! The bound of a frame on this device: each operation takes at least the time of its bytes at the measured copy rate and of
//! its arithmetic at the measured f32 rate, whichever is longer.

use std::collections::BTreeMap;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::render::rate::arithmetic_rate;
use engine::scene::DeformNetwork;
use engine::scene::network::{HIDDEN_LAYERS, HIDDEN_WIDTH};
use serde::Serialize;

use crate::measure::Measurement;

/// Operations on one Gaussian from its parameters to its splat with SH of degree 3: counted in the formulas.
const PROJECT_FLOPS: f64 = 650.0;
/// Operations on one pixel of one tile instance: quadratic form, exponential, four multiply-adds, threshold.
const BLEND_FLOPS: f64 = 20.0;
/// Pixels of a tile; those where α is too small are counted too, for they must be looked at.
const TILE_PIXELS: f64 = 256.0;

/// One operation against its bound.
#[derive(Debug, Clone, Serialize)]
pub(super) struct RooflineRow {
    /// Label of the operation.
    pub(super) label: String,
    /// Measured, microseconds.
    pub(super) us: f64,
    /// Bytes that an ideal implementation moves.
    pub(super) bytes: u64,
    /// Floating-point operations.
    pub(super) flops: f64,
    /// Bound by bytes, microseconds.
    pub(super) bytes_us: f64,
    /// Bound by arithmetic, microseconds.
    pub(super) flops_us: f64,
}

impl RooflineRow {
    /// The larger bound, microseconds.
    pub(super) fn bound_us(&self) -> f64 {
        self.bytes_us.max(self.flops_us)
    }
}

/// The frame against its bound.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Roofline {
    /// Measured rate of copies, bytes read plus bytes written, GB/s.
    pub(super) copy_gb_per_s: f64,
    /// Measured rate of f32 multiply-adds, GFLOP/s.
    pub(super) gflop_per_s: f64,
    /// Operations in order.
    pub(super) rows: Vec<RooflineRow>,
    /// Sum of the bounds, milliseconds.
    pub(super) bound_ms: f64,
    /// Frames per second at the bound.
    pub(super) bound_fps: f64,
    /// The bound as a share of the measured device time.
    pub(super) share: f64,
}

/// Operations of one dispatch of a kernel.
fn flops(kernel: &str, work: &BTreeMap<&'static str, u64>) -> f64 {
    let of = |name: &str| work.get(name).copied().unwrap_or(0) as f64;
    match kernel {
        "deform_project" => PROJECT_FLOPS * of("gaussians"),
        "blend" => BLEND_FLOPS * TILE_PIXELS * of("instances"),
        "deform_network" => {
            let hidden: usize = (0..HIDDEN_LAYERS).map(|i| DeformNetwork::layer_inputs(i) * HIDDEN_WIDTH).sum();
            2.0 * (hidden + 6 * HIDDEN_WIDTH) as f64 * of("superpoints")
        }
        _ => 0.0,
    }
}

/// Measures the device's rates and bounds a measured frame.
pub(super) fn roofline(gpu: &Gpu, measured: &Measurement) -> Result<Roofline> {
    let gflop_per_s = arithmetic_rate(gpu)?;
    Ok(bound(measured, gflop_per_s))
}

fn bound(measured: &Measurement, gflop_per_s: f64) -> Roofline {
    let row = |o: &crate::measure::OperationRow| {
        let (bytes, flops) = (o.bytes.unwrap_or(0), o.kernel.map_or(0.0, |k| flops(k, &measured.workload)));
        let (bytes_us, flops_us) = (bytes as f64 / measured.copy_gb_per_s / 1e3, flops / gflop_per_s / 1e3);
        RooflineRow { label: o.label.clone(), us: o.us, bytes, flops, bytes_us, flops_us }
    };
    let rows: Vec<RooflineRow> = measured.operations.iter().map(row).collect();
    let (bound_us, us): (f64, f64) = rows.iter().fold((0.0, 0.0), |(b, u), r| (b + r.bound_us(), u + r.us));
    Roofline {
        copy_gb_per_s: measured.copy_gb_per_s,
        gflop_per_s,
        rows,
        bound_ms: bound_us / 1e3,
        bound_fps: if bound_us > 0.0 { 1e6 / bound_us } else { 0.0 },
        share: if us > 0.0 { bound_us / us } else { 0.0 },
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn kernels_that_calculate_are_kernels_of_the_engine() {
        let work: BTreeMap<&'static str, u64> = [("gaussians", 10), ("instances", 3), ("superpoints", 2)].into();
        let counted = ["deform_project", "blend", "deform_network"];
        for name in counted {
            assert!(engine::kernels().any(|k| k.name == name) && flops(name, &work) > 0.0, "{name}");
        }
        assert_eq!(flops("blend", &work), 3.0 * 256.0 * 20.0);
        assert_eq!(flops("compact", &work), 0.0);
    }
}
