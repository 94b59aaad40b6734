//! Kernels `gather_rows`, `split_children` and `reset_opacity`.

use super::{KIND_CHILD_0, KIND_KEPT, SOURCE_ROW, SPLIT_LOG_SCALE};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::twin::{self, f32_at, set_f32, vec4_at};
use crate::train::rng;

crate::gpu_struct! {
    /// Push constants of `gather_rows`.
    pub struct GatherPush {
        /// Rows of the old array.
        pub old_count: u32,
        /// Rows of the new one.
        pub new_count: u32,
        /// Planes of both.
        pub planes: u32,
        /// Words per row and plane.
        pub width: u32,
        /// 1: rows of clones and children become 0.
        pub zero_new: u32,
    }
}

crate::gpu_struct! {
    /// Push constants of `split_children`.
    pub struct SplitPush {
        /// New rows.
        pub rows: u32,
        /// Seed, low word.
        pub seed_low: u32,
        /// Seed, high word.
        pub seed_high: u32,
        /// Iteration: the stream of random numbers.
        pub iteration: u32,
    }
}

crate::gpu_struct! {
    /// Push constants of `reset_opacity`.
    pub struct ResetPush {
        /// N.
        pub gaussians: u32,
        /// Largest logit.
        pub limit: f32,
        /// Plane of the opacity's moments.
        pub plane: u32,
    }
}

/// Dispatch ceil(new rows · width / 256) workgroups.
pub static GATHER_ROWS: Kernel = Kernel {
    name: "gather_rows",
    doc: "copies rows of an array to their new places; rows of clones and children may become 0",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: GatherPush::FIELDS,
    bindings: &[
        Binding::new("source", Access::Read, Element::U32),
        Binding::new("old_rows", Access::Read, Element::U32),
        Binding::new("new_rows", Access::Write, Element::U32),
    ],
    twin: gather_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 12 * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/gather_rows.spv"),
};

fn gather_twin(call: &mut TwinCall<'_>) {
    let push: GatherPush = twin::push(call);
    let [source, old_rows, new_rows] = call.buffers else { return };
    let [old_count, new_count, planes, width] =
        [push.old_count, push.new_count, push.planes, push.width].map(|v| v as usize);
    for plane in 0..planes {
        for row in 0..new_count {
            let zero = push.zero_new == 1 && source[row] >> 30 != KIND_KEPT;
            let from = (source[row] & SOURCE_ROW) as usize;
            for c in 0..width {
                let value = if zero { 0 } else { old_rows[(plane * old_count + from) * width + c] };
                new_rows[(plane * new_count + row) * width + c] = value;
            }
        }
    }
}

/// Dispatch ceil(new rows / 256) workgroups after the parameters were gathered.
pub static SPLIT_CHILDREN: Kernel = Kernel {
    name: "split_children",
    doc: "centres of the children of split Gaussians drawn from the parent, scales divided by 1.6",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: SplitPush::FIELDS,
    bindings: &[
        Binding::new("source", Access::Read, Element::U32),
        Binding::new("rotation", Access::Read, Element::F32),
        Binding::new("mean", Access::Update, Element::F32),
        Binding::new("log_scale", Access::Update, Element::F32),
    ],
    twin: split_twin,
    tolerance: Tolerance { absolute: 1e-5, relative: 1e-5, flips: 0.0 },
    bytes: |w| 20 * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/split_children.spv"),
};

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// v rotated by the unit quaternion (w, u).
fn rotate(w: f32, u: [f32; 3], v: [f32; 3]) -> [f32; 3] {
    let t = cross(u, v).map(|c| 2.0 * c);
    let around = cross(u, t);
    std::array::from_fn(|i| v[i] + w * t[i] + around[i])
}

fn split_twin(call: &mut TwinCall<'_>) {
    let push: SplitPush = twin::push(call);
    let [source, rotation, mean, log_scale] = call.buffers else { return };
    let n = push.rows as usize;
    let seed = u64::from(push.seed_low) | u64::from(push.seed_high) << 32;
    for row in (0..n).filter(|&row| source[row] >> 30 >= KIND_CHILD_0) {
        let kind = source[row] >> 30;
        let [a, b, c, d] = rng::words(seed, push.iteration, [source[row] & SOURCE_ROW, kind - KIND_CHILD_0], 0);
        let ([x, y], [z, _]) = (rng::normals_f32(a, b), rng::normals_f32(c, d));
        let parent: [f32; 3] = std::array::from_fn(|axis| f32_at(log_scale, axis * n + row));
        let q = vec4_at(rotation, row);
        let length = q.iter().map(|c| c * c).sum::<f32>().max(1.0e-24).sqrt();
        let [w, i, j, k] = q.map(|c| c / length);
        let scaled = [parent[0].exp() * x, parent[1].exp() * y, parent[2].exp() * z];
        let offset = rotate(w, [i, j, k], scaled);
        for axis in 0..3 {
            let moved = f32_at(mean, axis * n + row) + offset[axis];
            if moved.is_finite() {
                set_f32(mean, axis * n + row, moved);
            }
            set_f32(log_scale, axis * n + row, parent[axis] - SPLIT_LOG_SCALE);
        }
    }
}

/// Dispatch ceil(N / 256) workgroups.
pub static RESET_OPACITY: Kernel = Kernel {
    name: "reset_opacity",
    doc: "lowers every opacity to a limit and clears its moments",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: ResetPush::FIELDS,
    bindings: &[
        Binding::new("opacity_logit", Access::Update, Element::F32),
        Binding::new("moment_1", Access::Write, Element::F32),
        Binding::new("moment_2", Access::Write, Element::F32),
    ],
    twin: reset_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 16 * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/reset_opacity.spv"),
};

fn reset_twin(call: &mut TwinCall<'_>) {
    let push: ResetPush = twin::push(call);
    let [opacity_logit, moment_1, moment_2] = call.buffers else { return };
    let n = push.gaussians as usize;
    for i in 0..n {
        let value = f32_at(opacity_logit, i);
        set_f32(opacity_logit, i, if value > push.limit { push.limit } else { value });
        moment_1[push.plane as usize * n + i] = 0;
        moment_2[push.plane as usize * n + i] = 0;
    }
}
