//! Property reconstruction losses: the position at the step's time, the so(3) vector and the translation of each Gaussian
//! v_i against their reconstruction v'_i from the neighbouring superpoints, mean of (v_i − v'_i)² over N·3 numbers.
//!
//! - [`PropertyLoss::Code`] (released code, the default): v'_i = Σ_k a_ik u_k with u the superpoint's own property: network
//!   F's outputs r_j, τ_j and Exp(r_j)p^c_j + τ_j. The moved mean is a constant; r and τ of a Gaussian are its own
//!   superpoint's outputs and take gradients. Weights 1e-3, 100, 100.
//! - [`PropertyLoss::Paper`]: v' = R_sp→g(R_g→sp(v)): u_j = Σ_i a_ij v_i / Σ_i a_ij over all Gaussians that have superpoint
//!   j as a neighbour. Nothing is a constant. Weights 1e-3, 1, 1.

pub mod property_backward;
pub mod property_residual;
pub mod property_total;
pub mod property_values;

use crate::gpu::kernel::Kernel;
use crate::render::{quaternion, twin};
pub use crate::scene::motion::PropertyLoss;
use crate::train::adam;
use crate::train::association::superpoint_sum::FIRST_PAIR_VALUE;
use crate::train::status;
use crate::train::step::Step;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[
    &property_residual::PROPERTY_RESIDUAL.kernel,
    &property_total::PROPERTY_TOTAL.kernel,
    &property_values::PROPERTY_VALUES.kernel,
    &property_backward::PROPERTY_BACKWARD.kernel,
];

/// A Gaussian's or superpoint's properties in f32.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Properties {
    /// Exp(r)x.
    pub turned: [f32; 3],
    /// Position, so(3) vector, translation.
    pub value: [[f32; 3]; 3],
}

/// Twin of `moved_properties`.
pub(crate) fn moved_properties(pose: &[u32], j: usize, x: [f32; 3]) -> Properties {
    let [rx, ry, rz, _] = twin::vec4_at(pose, 2 * j);
    let [tx, ty, tz, _] = twin::vec4_at(pose, 2 * j + 1);
    let (r, t) = ([rx, ry, rz], [tx, ty, tz]);
    let shift = quaternion::displacement(quaternion::exp(r), x);
    let turned: [f32; 3] = std::array::from_fn(|c| x[c] + shift[c]);
    Properties { turned, value: [std::array::from_fn(|c| turned[c] + t[c]), r, t] }
}

/// Three planes from `plane` on of a plane-major array with stride `stride`.
pub(crate) fn planes(words: &[u32], plane: usize, stride: usize, i: usize) -> [f32; 3] {
    [0, 1, 2].map(|c| twin::f32_at(words, (plane + c) * stride + i))
}

/// A superpoint's mean properties from the planes of `superpoint_sum`.
fn mean_properties(sums: &[u32], m: usize, j: usize) -> [[f32; 3]; 3] {
    let inverse = inverse_weight(sums, j);
    [0, 3, 6].map(|p| planes(sums, FIRST_PAIR_VALUE + p, m, j).map(|v| inverse * v))
}

/// 1 / Σa, 0 for a superpoint that is nobody's neighbour.
fn inverse_weight(sums: &[u32], j: usize) -> f32 {
    let total = twin::f32_at(sums, j);
    if total > 0.0 { 1.0 / total } else { 0.0 }
}

/// Twin of `update_logit`: one step of Adam unless something is not finite.
pub(crate) fn update_logit(
    step: &Step,
    logit_and_moments: [&mut [u32]; 3],
    at: usize,
    gradient: f32,
    words: &mut [u32],
    gaussian: usize,
) {
    let [logit, m1, m2] = logit_and_moments;
    let mut moments = [twin::f32_at(m1, at), twin::f32_at(m2, at)];
    let bias = step.bias_association;
    let value = adam::update(step, twin::f32_at(logit, at), gradient, &mut moments, step.rate_association, bias);
    if value.is_finite() && moments.iter().all(|m| m.is_finite()) {
        twin::set_f32(logit, at, value);
        twin::set_f32(m1, at, moments[0]);
        twin::set_f32(m2, at, moments[1]);
    } else {
        status::report(words, status::ASSOCIATION, gaussian as u32);
    }
}
