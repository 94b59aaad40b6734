//! Property reconstruction losses: the position at the step's time, the so(3) vector and the translation of each Gaussian
//! v_i against their reconstruction v'_i from the neighbouring superpoints, mean of (v_i − v'_i)² over N·3 numbers.
//!
//! - [`PropertyLoss::Code`] (released code, the default): v'_i = Σ_k a_ik u_k with u the superpoint's own property: network
//!   F's outputs r_j, τ_j and Exp(r_j)p^c_j + τ_j. The moved mean is a constant; r and τ of a Gaussian are its own
//!   superpoint's outputs and take gradients. Weights 1e-3, 100, 100.
//! - [`PropertyLoss::Paper`]: v' = R_sp→g(R_g→sp(v)): u_j = Σ_i a_ij v_i / Σ_i a_ij over all Gaussians that have superpoint
//!   j as a neighbour. Nothing is a constant. Weights 1e-3, 1, 1.

pub mod backward;
pub mod residual;

use crate::gpu::kernel::Kernel;
use crate::render::{quaternion, twin};
pub use crate::scene::motion::PropertyLoss;
use crate::train::adam;
use crate::train::association::nearest::ASSOCIATION_GROUP;
use crate::train::status;
use crate::train::step::Step;

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[
    &residual::PROPERTY_RESIDUAL,
    &residual::PROPERTY_TOTAL,
    &backward::PROPERTY_VALUES,
    &backward::PROPERTY_BACKWARD,
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

/// Twin of `update_logit`: one step of Adam unless something is not finite.
pub(crate) fn update_logit(
    step: &Step,
    buffers: [&mut Vec<u32>; 3],
    at: usize,
    gradient: f32,
    words: &mut [u32],
    gaussian: usize,
) {
    let [logit, m1, m2] = buffers;
    let mut moments = [twin::f32_at(m1, at), twin::f32_at(m2, at)];
    let bias = step.bias_association;
    let value = adam::update(step, twin::f32_at(logit, at), gradient, &mut moments, step.rate_association, bias);
    if value.is_finite() && moments.iter().all(|m| m.is_finite()) {
        twin::set_f32(logit, at, value);
        twin::set_f32(m1, at, moments[0]);
        twin::set_f32(m2, at, moments[1]);
    } else {
        status::report(words, ASSOCIATION_GROUP, gaussian as u32);
    }
}
