//! Posed images → scene, on the GPU.

pub mod adam;
pub mod association;
pub mod bake;
pub mod blend_backward;
pub mod config;
pub mod deform_project_backward;
pub mod density;
pub mod farthest_point;
pub mod image_loss;
pub mod linear;
pub mod network_f;
pub mod network_g;
mod parameters;
pub mod property_loss;
pub mod schedule;
pub mod status;
pub mod step;

use crate::gpu::kernel::Kernel;

/// Every kernel of training, by module.
static BY_MODULE: &[&[&Kernel]] = &[
    blend_backward::KERNELS,
    deform_project_backward::KERNELS,
    image_loss::KERNELS,
    adam::KERNELS,
    density::KERNELS,
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
