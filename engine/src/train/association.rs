//! The sparse association matrix: nearest superpoints, softmax, assignment, superpoint centres.
//!
//! Of each Gaussian's row of A only the K nearest superpoints (in canonical space) are in use; K' ≥ K are remembered.
//! A row keeps the superpoints in use first, nearest first, then those that left, latest first: what left longest ago is
//! forgotten first. A remembered entry keeps its logit and moments, and Adam goes on moving it with a zero gradient, as it
//! would a dense N×M matrix; so the sparse matrix equals the dense one until a Gaussian has met more than K' superpoints.
//! An entry that comes back after it was forgotten starts from 0.1 again.
//!
//! Per training step, in this order (see [`SuperpointState`]):
//!
//! ```text
//! forward pass → record_before:      nearest_superpoints → sort of pairs → property losses, logits' Adam → superpoint sums
//!             → deform_project_backward (writes pose_gradient, updates means)
//!             → record_reduce_pose:  pose sums → superpoint_gradient
//!             → network F backward
//!             → record_commit:       assignment and centres of the next step
//! ```
//!
//! With soft superpoints ([`AssociationOptions::soft`]) the softmax weights also move the Gaussians: nearest_superpoints runs
//! before the frame, pose sums go over all pairs, and the logits' Adam waits for the image loss
//! ([`association_update`]).

pub mod association_init;
pub mod association_update;
pub mod nearest_superpoints;
mod record;
mod state;
pub mod superpoint_commit;
pub mod superpoint_gradient;
pub mod superpoint_sum;

use crate::gpu::kernel::Kernel;

pub use state::{AssociationOptions, Rows, StepBuffers, SuperpointState};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[
    &nearest_superpoints::NEAREST_SUPERPOINTS.kernel,
    &association_init::ASSOCIATION_INIT.kernel,
    &superpoint_sum::SUPERPOINT_SUM.kernel,
    &superpoint_gradient::SUPERPOINT_GRADIENT.kernel,
    &superpoint_commit::SUPERPOINT_COMMIT.kernel,
    &association_update::ASSOCIATION_UPDATE.kernel,
];

crate::gpu_constants! {
    /// Specialisation constants of the kernels that read the association's rows.
    pub struct AssociationConstants {
        /// K, superpoints in use per Gaussian.
        neighbors,
        /// K', superpoints remembered per Gaussian.
        slots,
    }
}

/// Most superpoints in use per Gaussian.
pub const MAX_NEIGHBORS: u32 = 7;
/// Most superpoints remembered per Gaussian.
pub const MAX_SLOTS: u32 = 16;
/// A slot that has never been used.
pub const NO_SUPERPOINT: u32 = u32::MAX;
/// Logit of a neighbour that was not remembered.
pub const NEW_LOGIT: f32 = 0.1;
/// A pair's value is `slot << PAIR_SHIFT | gaussian`; slot K is the Gaussian's own superpoint.
pub const PAIR_SHIFT: u32 = 28;

/// Logits of a superpoint initialisation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum AssociationInit {
    /// 1.0 for every Gaussian's nearest superpoint, 0.1 elsewhere: what the released code does.
    #[default]
    Code,
    /// 0.9 where a Gaussian seeded the superpoint, 0.1 elsewhere: what the paper says.
    Paper,
}
