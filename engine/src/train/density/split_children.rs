//! Kernel `split_children`: where the children of split Gaussians lie.

use super::{KIND_CHILD_0, SOURCE_ROW, SPLIT_LOG_SCALE};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::twin::{f32_at, set_f32, vec4_at};
use crate::train::rng;

crate::gpu_struct! {
    /// Push constants of `split_children`.
    pub struct SplitChildrenPush {
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

crate::gpu_buffers! {
    /// Buffers of [`SPLIT_CHILDREN`]; the parameters are the gathered ones: children hold their parent's.
    pub struct SplitChildrenBuffers {
        /// As `density_emit` leaves it.
        source: Read U32,
        /// `vec4[rows]`, w, x, y, z.
        rotation: Read F32,
        /// `float[3][rows]`.
        mean: Update F32,
        /// `float[3][rows]`.
        log_scale: Update F32,
    }
}

crate::kernel! {
    /// Dispatch ceil(new rows / 256) workgroups after the parameters were gathered.
    pub static SPLIT_CHILDREN: SplitChildren = {
        name: "split_children",
        doc: "centres of the children of split Gaussians drawn from the parent, scales divided by 1.6",
        local_size: 256,
        constants: (),
        push: SplitChildrenPush,
        buffers: SplitChildrenBuffers,
        twin: split_children_twin,
        tolerance: Tolerance { absolute: 1e-5, relative: 1e-5, flips: 0.0 },
        bytes: |w| 20 * w.get("gaussians"),
    }
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// v rotated by the unit quaternion (w, u).
fn rotate(w: f32, u: [f32; 3], v: [f32; 3]) -> [f32; 3] {
    let t = cross(u, v).map(|c| 2.0 * c);
    let around = cross(u, t);
    std::array::from_fn(|i| v[i] + w * t[i] + around[i])
}

fn split_children_twin(call: Call<'_, SplitChildren>) {
    let Call { push, buffers: SplitChildrenBuffers { source, rotation, mean, log_scale }, .. } = call;
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
