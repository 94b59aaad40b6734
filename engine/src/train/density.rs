//! Adaptive density control on the device (Kerbl et al. 2023, section 5.2): prune, clone, split, and the opacity reset.
//!
//! Per Gaussian, with g = Σ ‖dL/d(screen position)‖ / views that saw it, or of Σ|dL/dx|, Σ|dL/dy| over pixels (0 when none did or it is not finite):
//!
//! - **prune**: opacity below the limit (parameters that are not finite count as such), in every case;
//! - **clone**: g ≥ threshold and largest scale ≤ `percent_dense`·extent; the copy has the same parameters;
//! - **split**: g ≥ threshold and larger; two children drawn from N(0, s) rotated by R around the centre, scales / 1.6, the
//!   parent goes;
//! - **prune by size**: largest scale of a resulting row above 0.1·extent (children are tested with their own scale); largest
//!   screen radius above the limit, for Gaussians that do not grow. In the released 3DGS code growing resets all radii
//!   before they are tested, so there the screen radius prunes nothing; those that grow are exempt here for that reason.
//!
//! **Budget**: growth never takes the count above `max_gaussians`. When there is more, those with the largest g grow, ties by
//! the smaller index. Nothing is pruned because of the budget.
//!
//! Rows keep their order; a clone or second child follows its parent's place. Kept rows (also the original of a clone) keep
//! their Adam moments, clones and children start with zeros. Statistics start from zero. Children are drawn by counter-based
//! random numbers of (seed, iteration, old row, child), so a pass is reproducible bit for bit.

pub mod density_decide;
pub mod density_emit;
pub mod density_histogram;
pub mod density_scan;
pub mod gather_rows;
pub mod reset_opacity;
mod run;
pub mod split_children;

pub use crate::scene::parameter::NewRows;
pub use reset_opacity::{OpacityRows, SmoothingRows, reset_opacity};
pub use run::{Density, DensityBuffers, DensityOptions, DensityOutcome, RowArray};

use crate::gpu::kernel::Kernel;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[
    &density_decide::DENSITY_DECIDE.kernel,
    &density_histogram::DENSITY_HISTOGRAM.kernel,
    &density_scan::DENSITY_SCAN.kernel,
    &density_emit::DENSITY_EMIT.kernel,
    &gather_rows::GATHER_ROWS.kernel,
    &split_children::SPLIT_CHILDREN.kernel,
    &reset_opacity::RESET_OPACITY.kernel,
];

/// ln 1.6: scales are divided by 1.6 in a split.
pub const SPLIT_LOG_SCALE: f32 = 0.470_003_63;
/// `action[]`: the Gaussian goes.
pub const ACTION_PRUNE: u32 = 0;
/// `action[]`: it stays as it is.
pub const ACTION_KEEP: u32 = 1;
/// `action[]`: it stays and is copied.
pub const ACTION_CLONE: u32 = 2;
/// `action[]`: two children take its place.
pub const ACTION_SPLIT: u32 = 3;
/// Bits of `source[]` that hold the old row; the kind is above them.
pub const SOURCE_ROW: u32 = 0x3fff_ffff;
/// Kind of a new row: an old one.
pub const KIND_KEPT: u32 = 0;
/// Kind of a new row: the copy of a cloned one.
pub const KIND_CLONE: u32 = 1;
/// Kind of a new row: first child of a split; the second is one more.
pub const KIND_CHILD_0: u32 = 2;
/// Gaussians per workgroup of the density kernels, and per block sum.
pub const DENSITY_BLOCK: u32 = 256;

/// What density control did after an iteration.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct DensityChange {
    /// N before.
    pub before: u32,
    /// N after.
    pub after: u32,
    /// Copied.
    pub cloned: u32,
    /// Replaced by two.
    pub split: u32,
    /// Removed.
    pub pruned: u32,
    /// Removed because the photos hardly show them.
    pub unseen: u32,
    /// Would have grown, but for the budget.
    pub refused: u32,
    /// Opacities were reset.
    pub opacity_reset: bool,
}

/// New rows of an action; twin of `rows_of_action`.
fn rows_of_action(action: u32) -> u32 {
    action.min(2)
}

/// Mean gradient norm, 0 when there is none; twin of `mean_gradient`.
fn mean_gradient(sum: f32, views: f32) -> f32 {
    let g = sum / views;
    if views > 0.0 && g.is_finite() && g > 0.0 { g } else { 0.0 }
}

fn logit(p: f64) -> f32 {
    (p / (1.0 - p)).ln() as f32
}
