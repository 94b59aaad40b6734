//! Kernel `lpips_conv`: convolution of a feature map, bias, ReLU, as a tiled product.

use super::{SUMS, THREADS, value};
use crate::gpu::interface::Call;
use crate::scene::network::relu;

crate::gpu_struct! {
    /// Push constants of [`LPIPS_CONV`].
    pub struct LpipsConvPush {
        /// Channels of the input.
        pub inputs: u32,
        /// Channels of the output.
        pub outputs: u32,
        /// Pixels of the input.
        pub in_width: u32,
        /// Rows of the picture that the input is a band of.
        pub in_height: u32,
        /// First of the rows that the input holds.
        pub in_first_row: u32,
        /// Rows that the input holds.
        pub in_rows: u32,
        /// Pixels of the output.
        pub out_width: u32,
        /// First of the rows that are written.
        pub out_first_row: u32,
        /// Rows that are written, all that the output holds.
        pub out_rows: u32,
        /// First of the channels that are written.
        pub first_output: u32,
        /// Channels that are written.
        pub output_count: u32,
    }
}

crate::gpu_constants! {
    /// Specialisation constants of [`LPIPS_CONV`].
    pub struct LpipsConvConstants {
        /// How tiles reach the lanes ([`Stage`](crate::gpu::product::Stage)).
        stage,
        /// Side of the window, pixels.
        kernel,
        /// Pixels from window to window.
        stride,
        /// Zeros around the picture, pixels.
        pad,
        /// Of a workgroup ([`Stage::threads`](crate::gpu::product::Stage::threads)).
        threads,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`LPIPS_CONV`].
    pub struct LpipsConvBuffers {
        /// `[inputs, in_rows, in_width]`
        feature_input: Read F32,
        /// `[outputs, inputs, kernel, kernel]`, then a bias per output.
        parameter: Read F32,
        /// `[outputs, out_rows, out_width]`
        feature_output: Write F32,
    }
}

crate::kernel! {
    /// Convolution, bias, ReLU.
    pub static LPIPS_CONV: LpipsConv = {
        name: "lpips_conv",
        doc: "LPIPS: convolution as a tiled product, bias, ReLU",
        local_size: THREADS,
        constants: LpipsConvConstants,
        push: LpipsConvPush,
        buffers: LpipsConvBuffers,
        twin: lpips_conv_twin,
        tolerance: SUMS,
        bytes: |work| 4 * (work.get("inputs") + work.get("parameters") + work.get("outputs")),
    }
}

fn lpips_conv_twin(call: Call<'_, LpipsConv>) {
    let Call { constants, push: p, buffers: b, .. } = call;
    let LpipsConvConstants { kernel: side, stride, pad, .. } = constants;
    let depth = p.inputs * side * side;
    for o in p.first_output..p.first_output + p.output_count {
        for pixel in 0..p.out_rows * p.out_width {
            let (row, column) = (p.out_first_row + pixel / p.out_width, pixel % p.out_width);
            let mut sum = value(b.parameter, p.outputs * depth + o);
            for k in 0..depth {
                let (channel, ky, kx) = (k / (side * side), k / side % side, k % side);
                let (y, x) = ((row * stride + ky).wrapping_sub(pad), (column * stride + kx).wrapping_sub(pad));
                if y < p.in_height && x < p.in_width {
                    let at = (channel * p.in_rows + y - p.in_first_row) * p.in_width + x;
                    sum += value(b.parameter, o * depth + k) * value(b.feature_input, at);
                }
            }
            b.feature_output[(o * p.out_rows * p.out_width + pixel) as usize] = (relu(sum) as f32).to_bits();
        }
    }
}
