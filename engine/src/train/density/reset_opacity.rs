//! Kernel `reset_opacity`: lowers every opacity to a limit, from where what is needed grows again.

use super::{DENSITY_BLOCK, logit};
use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Buffer, Gpu, Groups};
use crate::render::twin::{f32_at, set_f32};
use crate::scene::parameter::{OPACITY_LOGIT, Present, first_plane, smoothed};

/// Opacity that is always lowered.
const MOST: f64 = 0.5;

crate::gpu_struct! {
    /// Push constants of `reset_opacity`.
    pub struct ResetOpacityPush {
        /// N.
        pub gaussians: u32,
        /// Largest logit.
        pub limit: f32,
        /// Largest opacity: the same.
        pub opacity: f32,
        /// Plane of the opacity's moments.
        pub plane: u32,
        /// Plane of the smoothing among the optional parameters.
        pub smoothing: u32,
    }
}

crate::gpu_constants! {
    /// Specialisation constants of `reset_opacity`.
    pub struct ResetOpacityConstants {
        /// 1: Gaussians have a smoothing, and the limit is of the opacity that it leaves.
        smoothed,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`RESET_OPACITY`].
    pub struct ResetOpacityBuffers {
        /// `float[N]`.
        opacity_logit: Update F32,
        /// `float[planes][N]`; one plane is written.
        moment_1: Write F32,
        /// As `moment_1`.
        moment_2: Write F32,
        /// `float[3][N]`, with a smoothing.
        log_scale: optional Read F32,
        /// `float[planes][N]`, with a smoothing.
        optional: optional Read F32,
    }
}

crate::kernel! {
    /// Dispatch ceil(N / 256) workgroups.
    pub static RESET_OPACITY: ResetOpacity = {
        name: "reset_opacity",
        doc: "lowers every opacity to a limit and clears its moments",
        local_size: 256,
        constants: ResetOpacityConstants,
        push: ResetOpacityPush,
        buffers: ResetOpacityBuffers,
        twin: reset_opacity_twin,
        tolerance: Tolerance { absolute: 1e-5, relative: 1e-5, flips: 0.0 },
        bytes: |w| 16 * w.get("gaussians"),
    }
}

fn reset_opacity_twin(call: Call<'_, ResetOpacity>) {
    let Call { constants, push, buffers: b, .. } = call;
    let n = push.gaussians as usize;
    for i in 0..n {
        let value = f32_at(b.opacity_logit, i);
        let limit = match (b.log_scale.as_deref(), b.optional.as_deref()) {
            (Some(log_scale), Some(optional)) if constants.smoothed == 1 => {
                let scale = std::array::from_fn(|k| f64::from(f32_at(log_scale, k * n + i)).exp());
                let left = smoothed(scale, f32_at(optional, push.smoothing as usize * n + i).into()).1;
                let opacity = f64::from(push.opacity) / left;
                logit(if opacity < MOST { opacity } else { MOST })
            }
            _ => push.limit,
        };
        set_f32(b.opacity_logit, i, if value > limit { limit } else { value });
        b.moment_1[push.plane as usize * n + i] = 0;
        b.moment_2[push.plane as usize * n + i] = 0;
    }
}

/// What is reset.
#[derive(Debug, Clone, Copy)]
pub struct OpacityRows<'a> {
    /// N.
    pub gaussians: u32,
    /// `float[N]`.
    pub opacity_logit: &'a Buffer,
    /// `float[planes][N]` each.
    pub moments: [&'a Buffer; 2],
    /// Where Gaussians are smoothed.
    pub smoothing: Option<SmoothingRows<'a>>,
}

/// The smoothing of Gaussians, and what it widens.
#[derive(Debug, Clone, Copy)]
pub struct SmoothingRows<'a> {
    /// `float[3][N]`.
    pub log_scale: &'a Buffer,
    /// `float[planes][N]`: the optional parameters.
    pub optional: &'a Buffer,
    /// Which of its planes is the smoothing.
    pub plane: u32,
}

/// The opacity reset: opacity ← min(opacity, `max_opacity`), its moments ← 0. 3DGS: 0.01 every 3,000 iterations. Of smoothed Gaussians
/// it is the opacity that the smoothing leaves: those that lost much to it would not be seen again.
pub fn reset_opacity(gpu: &Gpu, rows: OpacityRows<'_>, max_opacity: f64) -> Result<()> {
    let OpacityRows { gaussians, opacity_logit, moments, smoothing } = rows;
    if gaussians == 0 {
        return Ok(());
    }
    let push = ResetOpacityPush {
        gaussians,
        limit: logit(max_opacity),
        opacity: max_opacity as f32,
        plane: first_plane(OPACITY_LOGIT, Present::default()),
        smoothing: smoothing.map_or(0, |s| s.plane),
    };
    let [moment_1, moment_2] = moments.map(Buffer::whole);
    let buffers = ResetOpacityBuffers {
        opacity_logit: opacity_logit.whole(),
        moment_1,
        moment_2,
        log_scale: smoothing.map(|s| s.log_scale.whole()),
        optional: smoothing.map(|s| s.optional.whole()),
    };
    let constants = ResetOpacityConstants { smoothed: smoothing.is_some().into() };
    let mut r = gpu.recorder("reset opacity");
    r.dispatch(&RESET_OPACITY, constants, push, buffers, Groups::Direct(gaussians.div_ceil(DENSITY_BLOCK).into()))?;
    gpu.run(r).map(drop)
}
