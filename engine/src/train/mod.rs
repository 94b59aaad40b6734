//! Posed images → scene, on the GPU.

pub mod adam;
pub mod adapt;
pub mod association;
pub mod bake;
pub mod blend_backward;
pub mod checkpoint;
pub mod config;
pub mod deform_project_backward;
pub mod density;
pub mod evaluate;
pub mod export;
pub mod farthest_point;
pub mod finite;
pub mod gradient;
pub mod image_loss;
pub mod init;
pub mod linear;
pub mod network_f;
pub mod network_g;
mod numbers;
mod parameters;
pub mod property_loss;
pub mod rng;
mod sampler;
pub mod schedule;
pub mod start;
pub mod status;
pub mod step;
mod target;
pub mod trainer;

use crate::gpu::kernel::Kernel;

/// Every kernel of training, by module.
static BY_MODULE: &[&[&Kernel]] = &[
    blend_backward::KERNELS,
    deform_project_backward::KERNELS,
    image_loss::KERNELS,
    adam::KERNELS,
    density::KERNELS,
    finite::KERNELS,
    linear::KERNELS,
    network_f::KERNELS,
    network_g::KERNELS,
    association::KERNELS,
    property_loss::KERNELS,
    farthest_point::KERNELS,
];

/// Every kernel of training.
pub fn kernels() -> impl Iterator<Item = &'static Kernel> {
    BY_MODULE.iter().flat_map(|list| list.iter().copied())
}
