//! Kernel `deform_project_backward`: from the splats' gradients to those of the Gaussians' parameters, of their superpoints'
//! poses and of their non-rigid offsets, or (`OUTPUT` = 1) straight to their Adam step.
//!
//! One Gaussian per thread. Recomputes the projection of [`crate::render::deform_project`] from the parameters and goes
//! back through it in whitened coordinates; formulas: [`crate::reference::gradient::project`] (EWA splatting as in 3D
//! Gaussian Splatting, with gsplat's clamp of the Jacobian; motion and non-rigid offsets of SP-GS). The moments, and
//! `gradient`, are planes `float[P][N]` in the order of [`PARAMETERS`](crate::scene::parameter::PARAMETERS); planes of bands
//! above `SH_DEGREE` are neither read nor written.
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

mod record;
mod twin;

pub(super) use record::{Output, ProjectBackward};

use crate::gpu::kernel::{Kernel, Tolerance, Workload};
use crate::render::frame::Frame;
use crate::render::superpoint_motion::blend_bytes;

use super::step::Step;

/// Threads per workgroup, one Gaussian each.
pub const DEFORM_PROJECT_BACKWARD_THREADS: u32 = 128;
/// Planes of `pose_gradient` of each slot of soft superpoints: rotation 3, translation 3, weight.
pub const SLOT_PLANES: u32 = 7;
/// `OUTPUT`: write the planes of `gradient`.
pub const OUTPUT_GRADIENT: u32 = 0;
/// `OUTPUT`: take an Adam step on the parameters.
pub const OUTPUT_ADAM: u32 = 1;

crate::gpu_constants! {
    /// Specialisation constants of [`DEFORM_PROJECT_BACKWARD`].
    pub struct DeformProjectBackwardConstants {
        /// The active one: higher bands are left alone.
        sh_degree,
        /// [`MOTION_STATIC`](crate::render::deform_project::MOTION_STATIC) or
        /// [`MOTION_TABLE`](crate::render::deform_project::MOTION_TABLE).
        motion,
        /// 1: `nonrigid_offset` is added.
        nonrigid,
        /// [`OUTPUT_GRADIENT`] or [`OUTPUT_ADAM`].
        output,
        /// 1: `mean_gradient` is added.
        mean_gradient,
        /// Which optional parameters the scene has ([`Present`](crate::scene::parameter::Present)).
        optional,
        /// K of soft superpoints, 2 to 4, or 0 ([`crate::render::superpoint_motion`]).
        blend,
        /// 1: [`Gaussians::antialiased`](crate::scene::Gaussians::antialiased).
        antialiased,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`DEFORM_PROJECT_BACKWARD`].
    pub struct DeformProjectBackwardBuffers {
        frame: Read Struct(Frame),
        step: Read Struct(Step),
        /// Counters of the frame; nothing happens when it failed.
        counters: Read U32,
        /// As [`status`](super::status) says.
        status: Atomic U32,
        /// `vec4[3·N]`.
        splats: Read F32,
        /// `uint[N]`.
        tile_count: Read U32,
        /// `float[12·N]`, as [`blend_backward`](super::blend_backward) says.
        splat_gradient: Read F32,
        /// `float[3][N]`.
        mean: Update F32,
        /// `float[3][N]`.
        log_scale: Update F32,
        /// `vec4[N]`, w, x, y, z.
        rotation: Update F32,
        /// `float[N]`.
        opacity_logit: Update F32,
        /// `uint[N]`; only with motion, without soft superpoints.
        superpoint_of_gaussian: optional Read U32,
        /// `vec4[T][M][2]`; only with motion.
        pose: optional Read F32,
        /// `float[3][N]`.
        sh_0: Update F32,
        /// `float[9][N]`, as the bands above only if active.
        sh_1: optional Update F32,
        /// `float[15][N]`.
        sh_2: optional Update F32,
        /// `float[21][N]`.
        sh_3: optional Update F32,
        /// `float[P][N]`, as `moment_2` only for [`OUTPUT_ADAM`].
        moment_1: optional Update F32,
        /// `float[P][N]`.
        moment_2: optional Update F32,
        /// `float[P][N]`; only for [`OUTPUT_GRADIENT`].
        gradient: optional Write F32,
        /// `float[6][N]`: rotation (left tangent) and translation of the superpoint; only with motion. With soft superpoints
        /// `float[K][7][N]`: these of each slot ([`SLOT_PLANES`]), then the gradient of its weight with the others held.
        pose_gradient: optional Write F32,
        /// `float[10][N]`: centre, quaternion, scale; only when non-rigid.
        nonrigid_offset: optional Read F32,
        /// `float[10][N]`; only when non-rigid.
        nonrigid_gradient: optional Write F32,
        /// `float[2][N]`, as `max_radius` only when the step keeps statistics.
        density: optional Update F32,
        /// `float[N]`.
        max_radius: optional Update F32,
        /// `float[3][N]`.
        mean_gradient: optional Read F32,
        /// `[planes][N]` of the optional parameters.
        optional: optional Update F32,
        /// `[ceil(K/2)][N]`; of soft superpoints ([`superpoint_motion`](crate::render::superpoint_motion)).
        blend_index: optional Read U32,
        /// `[K-1][N]`; of soft superpoints.
        blend_weight: optional Read F32,
    }
}

crate::kernel! {
    /// Backward of motion, projection and colour, fused with Adam.
    pub static DEFORM_PROJECT_BACKWARD: DeformProjectBackward = {
        name: "deform_project_backward",
        doc: "gradients of Gaussians, poses and non-rigid offsets from those of the splats; Adam step of the Gaussians",
        local_size: DEFORM_PROJECT_BACKWARD_THREADS,
        constants: DeformProjectBackwardConstants,
        push: (),
        buffers: DeformProjectBackwardBuffers,
        twin: twin::deform_project_backward_twin,
        // The twin is exact to f64: this is the rounding of the f32 chain, on a GPU with its own exp, sqrt and division.
        tolerance: Tolerance { absolute: 1e-4, relative: 1e-3, flips: 1e-3 },
        bytes: deform_project_backward_bytes,
    }
}

/// Parameters and both moments read and written (with `gradient_planes`: parameters read, gradients written), tile counts;
/// rows and colours of the visible; poses, superpoints and their gradients when moving, offsets and theirs when non-rigid.
fn deform_project_backward_bytes(work: &Workload) -> u64 {
    let planes = 11 + 3 * work.get("sh_coefficients").max(1) + work.get("optional_bytes") / 4;
    let words_per_plane = if work.get("gradient_planes") > 0 { 2 } else { 6 };
    let slots = work.get("blend_slots");
    let soft = blend_bytes(slots as u32) + 4 * u64::from(SLOT_PLANES) * slots;
    let moving = if work.get("superpoints") > 0 { soft.max(4 + 24) } else { 0 };
    let nonrigid = if work.get("nonrigid") > 0 { 80 } else { 0 };
    work.get("gaussians") * (4 * planes * words_per_plane + 4 + moving + nonrigid)
        + work.get("visible") * (9 * 4 + 12)
        + work.get("superpoints") * 32
}

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&DEFORM_PROJECT_BACKWARD.kernel];
