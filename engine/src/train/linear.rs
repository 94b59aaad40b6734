//! Dense layers on the GPU: tiled matrix products, forward and backward, and Adam.
//!
//! Kernels, each on row-major matrices of f32 (rows = superpoints or Gaussians):
//!
//! - `linear_forward` ([`crate::render::linear_forward`]): Y = act([X₀, X₁] Wᵀ + b);
//! - `linear_backward_input`: dX = (dZ W) ⊙ \[X > 0\], where dZ is the gradient before the layer's ReLU and X its input, so
//!   the result is the gradient before the ReLU of the layer below;
//! - `linear_backward_weight`: dW = dZᵀ [X₀, X₁] and db = Σ dZ, per slice of rows;
//! - `linear_update`: sums slices in order and gives them to Adam, which reports and skips what is not finite;
//! - `gather_gradient`: planes `[P][rows]` to rows; numbers that are not finite become 0 and are reported.
//!
//! Every sum has a fixed order, so equal input gives equal bits on one device. A pass runs all `linear_backward_input` from
//! the last layer down before `linear_update`, so gradients use the weights of the forward pass.

pub mod gather_gradient;
pub mod linear_backward_input;
pub mod linear_backward_weight;
pub mod linear_update;
mod parameters;
mod record;

use crate::gpu::kernel::Kernel;
use crate::gpu::product::PRODUCT_THREADS;

pub use crate::gpu::product::{Stage, product_groups};
pub use parameters::Parameters;
pub(super) use record::{Layer, Pass, Split};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[
    &linear_backward_input::LINEAR_BACKWARD_INPUT.kernel,
    &linear_backward_weight::LINEAR_BACKWARD_WEIGHT.kernel,
    &linear_update::LINEAR_UPDATE.kernel,
    &gather_gradient::GATHER_GRADIENT.kernel,
];

/// Threads per workgroup.
const THREADS: u32 = PRODUCT_THREADS;

crate::gpu_constants! {
    /// Specialisation constants of the backward products.
    pub struct LinearConstants {
        /// A [`Stage`].
        stage,
        /// 1: strides and offsets are multiples of 4, so that four neighbours are one load.
        vectors,
        /// Of a workgroup ([`Stage::threads`]).
        threads,
    }
}

impl LinearConstants {
    /// Of a product that [`Stage::for_strides`] judged, for a subgroup size.
    pub fn new((stage, vectors): (Stage, bool), lanes: u32) -> Self {
        Self { stage: stage as u32, vectors: vectors.into(), threads: stage.threads(lanes) }
    }
}

/// Whose learning rate, corrections and reports a kernel uses (specialisation constant `NETWORK`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Network {
    /// Superpoint deformation.
    F = 0,
    /// Non-rigid stage.
    G = 1,
}

/// What happens to the gradients of the weights (specialisation constant `OUTPUT`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// They are kept in the gradient buffer; weights and moments stay.
    Gradient = 0,
    /// Adam updates weights and moments.
    Adam = 1,
}

/// A dense layer's shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Columns taken from the first input.
    pub inputs_0: u32,
    /// Columns taken from the second input (0 without one).
    pub inputs_1: u32,
    /// Outputs.
    pub outputs: u32,
}

impl Shape {
    /// All inputs.
    pub fn inputs(&self) -> u32 {
        self.inputs_0 + self.inputs_1
    }

    /// Weights and biases.
    pub fn parameters(&self) -> u32 {
        self.outputs * (self.inputs() + 1)
    }
}
