//! Kernel `reset_opacity`: lowers every opacity to a limit, from where what is needed grows again.

use super::{DENSITY_BLOCK, logit};
use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Buffer, Gpu, Groups};
use crate::render::twin::{f32_at, set_f32};
use crate::scene::parameter::{OPACITY_LOGIT, Present, first_plane};

crate::gpu_struct! {
    /// Push constants of `reset_opacity`.
    pub struct ResetOpacityPush {
        /// N.
        pub gaussians: u32,
        /// Largest logit.
        pub limit: f32,
        /// Plane of the opacity's moments.
        pub plane: u32,
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
    }
}

crate::kernel! {
    /// Dispatch ceil(N / 256) workgroups.
    pub static RESET_OPACITY: ResetOpacity = {
        name: "reset_opacity",
        doc: "lowers every opacity to a limit and clears its moments",
        local_size: 256,
        constants: (),
        push: ResetOpacityPush,
        buffers: ResetOpacityBuffers,
        twin: reset_opacity_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 16 * w.get("gaussians"),
    }
}

fn reset_opacity_twin(call: Call<'_, ResetOpacity>) {
    let Call { push, buffers: b, .. } = call;
    let n = push.gaussians as usize;
    for i in 0..n {
        let value = f32_at(b.opacity_logit, i);
        set_f32(b.opacity_logit, i, if value > push.limit { push.limit } else { value });
        b.moment_1[push.plane as usize * n + i] = 0;
        b.moment_2[push.plane as usize * n + i] = 0;
    }
}

/// The opacity reset: opacity ← min(opacity, `max_opacity`), its moments ← 0. 3DGS: 0.01 every 3,000 iterations.
pub fn reset_opacity(gpu: &Gpu, opacity_logit: &Buffer, moments: [&Buffer; 2], n: u32, max_opacity: f64) -> Result<()> {
    if n == 0 {
        return Ok(());
    }
    let push = ResetOpacityPush {
        gaussians: n,
        limit: logit(max_opacity),
        plane: first_plane(OPACITY_LOGIT, Present::default()),
    };
    let [moment_1, moment_2] = moments.map(Buffer::whole);
    let buffers = ResetOpacityBuffers { opacity_logit: opacity_logit.whole(), moment_1, moment_2 };
    let mut r = gpu.recorder("reset opacity");
    r.dispatch(&RESET_OPACITY, (), push, buffers, Groups::Direct(n.div_ceil(DENSITY_BLOCK).into()))?;
    gpu.run(r).map(drop)
}
