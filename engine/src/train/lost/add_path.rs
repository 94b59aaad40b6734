//! Kernel `add_path`: where an object has gone that a run found lost, added to what network F says of its superpoints.

use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::step::Step;

crate::gpu_struct! {
    /// Push constants of [`ADD_PATH`].
    pub struct AddPathPush {
        /// M.
        pub superpoints: u32,
        /// T, at least 1.
        pub times: u32,
    }
}

const THREADS: u32 = 256;

crate::gpu_buffers! {
    /// Buffers of [`ADD_PATH`].
    pub struct AddPathBuffers {
        /// Its exact time.
        step: Read Struct(Step),
        /// `[T]`, ascending.
        path_time: Read F32,
        /// `[T][3]`, world units.
        path_offset: Read F32,
        /// `[M]`; 0: the superpoint does not follow the path.
        follows: Read U32,
        /// `vec4[M][2]`: (r, 0), (τ, 0).
        pose: Update F32,
    }
}

crate::kernel! {
    /// τ of the superpoints that follow a path grows by the path's offset at the step's time, linear between its times, the
    /// first and the last one beyond them. Dispatch ceil(M / 256) workgroups.
    pub static ADD_PATH: AddPath = {
        name: "add_path",
        doc: "superpoints that follow a known path: its offset at the step's time is added to their translation",
        local_size: THREADS,
        constants: (),
        push: AddPathPush,
        buffers: AddPathBuffers,
        twin: add_path_twin,
        tolerance: Tolerance { absolute: 1e-6, relative: 1e-6, flips: 0.0 },
        bytes: |work| work.get("superpoints") * 36,
    }
}

/// Records it.
pub(in crate::train) fn record(r: &mut Recorder, push: AddPathPush, buffers: AddPathBuffers<Slice>) -> Result<()> {
    let groups = Groups::Direct(push.superpoints.div_ceil(THREADS).into());
    r.dispatch(&ADD_PATH, (), push, buffers, groups)
}

fn add_path_twin(call: Call<'_, AddPath>) {
    let Call { push: AddPathPush { superpoints, times }, buffers: b, .. } = call;
    let step: Step = struct_at(b.step, 0);
    let (t, time) = (step.exact_time, |k: usize| f32_at(b.path_time, k));
    let key = (1..times as usize).filter(|&k| time(k) <= t).max().unwrap_or(0);
    let other = (key + 1).min(times as usize - 1);
    let apart = time(other) - time(key);
    let share = if apart > 0.0 { ((t - time(key)) / apart).clamp(0.0, 1.0) } else { 0.0 };
    for m in (0..superpoints as usize).filter(|&m| b.follows[m] != 0) {
        for axis in 0..3 {
            let [from, to] = [key, other].map(|k| f32_at(b.path_offset, 3 * k + axis));
            let at = 8 * m + 4 + axis;
            set_f32(b.pose, at, f32_at(b.pose, at) + (from + share * (to - from)));
        }
    }
}
