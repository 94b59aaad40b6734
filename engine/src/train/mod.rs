//! Posed images → scene, on the GPU.
//!
//! [`trainer::Trainer::advance`] is one iteration of Superpoint Gaussian Splatting, one submission:
//!
//! ```text
//! network F → pose            superpoint poses at the photo's time (after warm-up); interpolate_keys where key poses learn
//! network G → nonrigid_offset (non-rigid stage only)
//! deform_project … blend      the renderer's own forward pass, with tile lists of slots where gradients are summed in order
//! nearest_superpoints … property_total   association, property losses, logits' Adam
//! ssim_forward, image_loss    L1 + D-SSIM and its gradient by the image; with exposures expose before it, and exposure_backward and
//!                             learn_exposure after it
//! blend_backward, sum_instance_gradients → splat_gradient; of small images after blend_states instead of blend
//! deform_project_backward     gradients of Gaussians and poses, Adam of the Gaussians, density statistics
//! superpoint_sum, superpoint_gradient → linear_backward_*, linear_update: network F (or G) and its Adam
//! superpoint_commit           assignment and centres of the next step; with key poses superpoint_sum and learn_keys alone
//! ```
//!
//! Several steps are in flight: the host reads a step's report while the device is at later ones. What is trained is the same
//! bits as with one step at a time ([`trainer::flight`]). Nothing is applied when the view needs more tile instances than there is room for, and
//! nothing of the steps behind it; they are repeated in order with larger buffers. Photos stay on the device where they fit
//! (`photos`). Nothing that is not finite is ever applied (`status`). What happens when is [`schedule`]; every number of it
//! is [`config`]; `adapt` is density control, `unseen` removes what no photo shows, [`transients`] leaves out what one photo alone shows, [`checkpoint`] is what a run goes on from,
//! [`export`] and [`bake`] what is played.

#[doc(hidden)]
pub mod adam;
#[doc(hidden)]
pub mod adapt;
#[doc(hidden)]
pub mod association;
pub mod bake;
#[doc(hidden)]
pub mod blend_backward;
#[doc(hidden)]
pub mod check_finite;
pub mod checkpoint;
pub mod config;
#[doc(hidden)]
pub mod contribution;
#[doc(hidden)]
pub mod deform_project_backward;
mod deformation;
#[doc(hidden)]
pub mod density;
pub mod evaluate;
#[doc(hidden)]
pub mod evidence;
pub mod export;
#[doc(hidden)]
pub mod exposure;
#[doc(hidden)]
pub mod farthest_point;
pub mod gradient;
#[doc(hidden)]
pub mod image_loss;
pub mod init;
mod kept_aside;
#[doc(hidden)]
pub mod keys;
#[doc(hidden)]
pub mod linear;
pub mod lost;
#[doc(hidden)]
pub mod network_f;
#[doc(hidden)]
pub mod network_g;
mod numbers;
#[doc(hidden)]
pub mod parameters;
pub mod photo_loss;
mod photos;
#[doc(hidden)]
pub mod property_loss;
mod pyramid;
#[doc(hidden)]
pub mod rng;
pub mod sampler;
pub mod saved;
pub mod schedule;
pub mod start;
#[doc(hidden)]
pub mod status;
#[doc(hidden)]
pub mod step;
mod target;
mod time_window;
pub mod trainer;
pub mod transients;
mod unseen;
pub mod usage;
mod widen;
pub mod window_trial;

pub use association::{AssociationInit, AssociationOptions};
pub use density::DensityChange;
pub use keys::KeyOptions;
pub use parameters::ParameterState;

use crate::gpu::kernel::Kernel;

/// Every kernel of training, by module.
static BY_MODULE: &[&[&Kernel]] = &[
    blend_backward::KERNELS,
    deform_project_backward::KERNELS,
    image_loss::KERNELS,
    density::KERNELS,
    check_finite::KERNELS,
    linear::KERNELS,
    network_f::KERNELS,
    lost::KERNELS,
    keys::KERNELS,
    exposure::KERNELS,
    network_g::KERNELS,
    association::KERNELS,
    property_loss::KERNELS,
    farthest_point::KERNELS,
];

/// Every kernel of training.
#[doc(hidden)]
pub fn kernels() -> impl Iterator<Item = &'static Kernel> {
    BY_MODULE.iter().flat_map(|list| list.iter().copied())
}
