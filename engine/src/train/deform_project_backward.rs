//! Kernel `deform_project_backward`: from the splats' gradients to those of the Gaussians' parameters, of their superpoints'
//! poses and of their non-rigid offsets, or (`OUTPUT` = 1) straight to their Adam step.
//!
//! One Gaussian per thread. Recomputes the projection of [`crate::render::deform_project`] from the parameters and goes
//! back through it in whitened coordinates; formulas: [`crate::reference::gradient::project`] (EWA splatting as in 3D
//! Gaussian Splatting, with gsplat's clamp of the Jacobian; motion and non-rigid offsets of SP-GS). The moments, and
//! `gradient`, are planes `float[P][N]` in the order mean 0–2, log_scale 3–5, rotation 6–9 (w,x,y,z), opacity_logit 10,
//! sh_0 11–13, sh_1 14–22, sh_2 23–37, sh_3 38–58; planes of bands above `SH_DEGREE` are neither read nor written.
//!
//! A Gaussian with `tile_count` 0 has gradient 0; its moments decay and it moves on, as in PyTorch's Adam. Nothing changes
//! when the forward failed (`counters`). What is not finite is reported in `status` and not applied; in `gradient`,
//! `pose_gradient` and `nonrigid_gradient` it is 0.
//!
//! With `MEAN_GRADIENT` = 1, `mean_gradient float[3][N]` (of the property losses in the paper's form) is added to the gradient
//! of the centres, culled or not.
//!
//! When the step keeps statistics, a visible Gaussian adds ‖dL/d mean2d·(W/2, H/2)‖ to plane 0 and 1 to plane 1 of
//! `density float[2][N]`, and raises `max_radius float[N]` to ⌈3√λ⌉ px, λ the larger eigenvalue of Σ₂ (3DGS's criteria).

mod twin;

use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, Workload};
use crate::render::frame::Frame;

use super::step::Step;

/// Threads per workgroup, one Gaussian each.
pub const DEFORM_PROJECT_BACKWARD_THREADS: u32 = 128;
/// `OUTPUT`: write the planes of `gradient`.
pub const OUTPUT_GRADIENT: u32 = 0;
/// `OUTPUT`: take an Adam step on the parameters.
pub const OUTPUT_ADAM: u32 = 1;

/// Planes of `gradient`, `moment_1` and `moment_2` for SH of a degree: 11 + 3(degree + 1)².
pub const fn parameter_planes(sh_degree: u32) -> u32 {
    11 + 3 * (sh_degree + 1) * (sh_degree + 1)
}

/// First plane of each band of SH coefficients.
pub const PLANE_SH: [usize; 4] = [11, 14, 23, 38];

/// Backward of motion, projection and colour, fused with Adam.
pub static DEFORM_PROJECT_BACKWARD: Kernel = Kernel {
    name: "deform_project_backward",
    doc: "gradients of Gaussians, poses and non-rigid offsets from those of the splats; Adam step of the Gaussians",
    local_size: DEFORM_PROJECT_BACKWARD_THREADS,
    spec: &["SUBGROUP_SIZE", "SH_DEGREE", "MOTION", "NONRIGID", "OUTPUT", "MEAN_GRADIENT"],
    push: &[],
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("status", Access::Atomic, Element::U32),
        Binding::new("splats", Access::Read, Element::F32),
        Binding::new("tile_count", Access::Read, Element::U32),
        Binding::new("splat_gradient", Access::Read, Element::F32),
        Binding::new("mean", Access::Update, Element::F32),
        Binding::new("log_scale", Access::Update, Element::F32),
        Binding::new("rotation", Access::Update, Element::F32),
        Binding::new("opacity_logit", Access::Update, Element::F32),
        Binding::new("superpoint_of_gaussian", Access::Read, Element::U32),
        Binding::new("pose", Access::Read, Element::F32),
        Binding::new("sh_0", Access::Update, Element::F32),
        Binding::new("sh_1", Access::Update, Element::F32),
        Binding::new("sh_2", Access::Update, Element::F32),
        Binding::new("sh_3", Access::Update, Element::F32),
        Binding::new("moment_1", Access::Update, Element::F32),
        Binding::new("moment_2", Access::Update, Element::F32),
        Binding::new("gradient", Access::Write, Element::F32),
        Binding::new("pose_gradient", Access::Write, Element::F32),
        Binding::new("nonrigid_offset", Access::Read, Element::F32),
        Binding::new("nonrigid_gradient", Access::Write, Element::F32),
        Binding::new("density", Access::Update, Element::F32),
        Binding::new("max_radius", Access::Update, Element::F32),
        Binding::new("mean_gradient", Access::Read, Element::F32),
    ],
    twin: twin::deform_project_backward_twin,
    // The twin is exact to f64: this is the rounding of the f32 chain, on a GPU with its own exp, sqrt and division.
    tolerance: Tolerance { absolute: 1e-4, relative: 1e-3, flips: 1e-3 },
    bytes: deform_project_backward_bytes,
    spirv: include_bytes!("../../../spirv_cache/deform_project_backward.spv"),
};

/// Parameters and both moments read and written (with `gradient_planes`: parameters read, gradients written), tile counts;
/// rows and colours of the visible; poses, superpoints and their gradients when moving, offsets and theirs when non-rigid.
fn deform_project_backward_bytes(work: &Workload) -> u64 {
    let planes = 11 + 3 * work.get("sh_coefficients").max(1);
    let words_per_plane = if work.get("gradient_planes") > 0 { 2 } else { 6 };
    let moving = if work.get("superpoints") > 0 { 4 + 24 } else { 0 };
    let nonrigid = if work.get("nonrigid") > 0 { 80 } else { 0 };
    work.get("gaussians") * (4 * planes * words_per_plane + 4 + moving + nonrigid)
        + work.get("visible") * (9 * 4 + 12)
        + work.get("superpoints") * 32
}

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&DEFORM_PROJECT_BACKWARD];
