//! Kernel `lpips_pool`: max pool of stride 2.

use super::{THREADS, value};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::scene::network::larger;

crate::gpu_struct! {
    /// Push constants of [`LPIPS_POOL`].
    pub struct LpipsPoolPush {
        /// Channels.
        pub channels: u32,
        /// Pixels of the input.
        pub in_width: u32,
        /// Rows that the input holds, from row 2·`out_first_row` on.
        pub in_rows: u32,
        /// Pixels of the output.
        pub out_width: u32,
        /// Rows that the output holds.
        pub out_height: u32,
        /// First of the rows that are written.
        pub out_first_row: u32,
        /// Rows that are written.
        pub out_rows: u32,
    }
}

crate::gpu_constants! {
    /// Specialisation constants of [`LPIPS_POOL`].
    pub struct LpipsPoolConstants {
        /// Side of the window, pixels.
        kernel,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`LPIPS_POOL`].
    pub struct LpipsPoolBuffers {
        /// `[channels, in_rows, in_width]`
        feature_input: Read F32,
        /// `[channels, out_height, out_width]`
        feature_output: Write F32,
    }
}

crate::kernel! {
    /// Max pool.
    pub static LPIPS_POOL: LpipsPool = {
        name: "lpips_pool",
        doc: "LPIPS: max pool of stride 2",
        local_size: THREADS,
        constants: LpipsPoolConstants,
        push: LpipsPoolPush,
        buffers: LpipsPoolBuffers,
        twin: lpips_pool_twin,
        tolerance: Tolerance::EXACT,
        bytes: |work| 4 * (work.get("inputs") + work.get("outputs")),
    }
}

fn lpips_pool_twin(call: Call<'_, LpipsPool>) {
    let Call { constants: LpipsPoolConstants { kernel: side }, push: p, buffers: b, .. } = call;
    for channel in 0..p.channels {
        for row in 0..p.out_rows {
            for column in 0..p.out_width {
                let at = |j: u32| {
                    let y = channel * p.in_rows + 2 * row + j / side;
                    value(b.feature_input, y * p.in_width + 2 * column + j % side)
                };
                let largest = (0..side * side).map(at).fold(0.0, larger);
                let to = (channel * p.out_height + p.out_first_row + row) * p.out_width + column;
                b.feature_output[to as usize] = (largest as f32).to_bits();
            }
        }
    }
}
