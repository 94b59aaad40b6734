//! CPU twins of the kernels: plain loops, sums in f64.

use super::EPSILON;
use super::kernels::{ConvPush, DifferencePush, PoolPush};
use crate::gpu::kernel::TwinCall;
use crate::scene::network::{larger, relu};

fn push<T: bytemuck::AnyBitPattern>(call: &TwinCall<'_>) -> T {
    bytemuck::pod_read_unaligned(&call.push[..size_of::<T>()])
}

fn value(words: &[u32], i: u32) -> f64 {
    f32::from_bits(words[i as usize]).into()
}

pub(super) fn conv(call: &mut TwinCall<'_>) {
    let p: ConvPush = push(call);
    let [side, stride, pad] = [2, 3, 4].map(|i: usize| call.spec.get(i).copied().unwrap_or(0));
    let [input, parameter, output] = call.buffers else { return };
    let depth = p.inputs * side * side;
    for o in p.first_output..p.first_output + p.output_count {
        for pixel in 0..p.out_rows * p.out_width {
            let (row, column) = (p.out_first_row + pixel / p.out_width, pixel % p.out_width);
            let mut sum = value(parameter, p.outputs * depth + o);
            for k in 0..depth {
                let (channel, ky, kx) = (k / (side * side), k / side % side, k % side);
                let (y, x) = ((row * stride + ky).wrapping_sub(pad), (column * stride + kx).wrapping_sub(pad));
                if y < p.in_height && x < p.in_width {
                    let at = (channel * p.in_rows + y - p.in_first_row) * p.in_width + x;
                    sum += value(parameter, o * depth + k) * value(input, at);
                }
            }
            output[(o * p.out_rows * p.out_width + pixel) as usize] = (relu(sum) as f32).to_bits();
        }
    }
}

pub(super) fn pool(call: &mut TwinCall<'_>) {
    let p: PoolPush = push(call);
    let side = call.spec.get(1).copied().unwrap_or(0);
    let [input, output] = call.buffers else { return };
    for channel in 0..p.channels {
        for row in 0..p.out_rows {
            for column in 0..p.out_width {
                let at = |j: u32| {
                    let y = channel * p.in_rows + 2 * row + j / side;
                    value(input, y * p.in_width + 2 * column + j % side)
                };
                let largest = (0..side * side).map(at).fold(0.0, larger);
                let to = (channel * p.out_height + p.out_first_row + row) * p.out_width + column;
                output[to as usize] = (largest as f32).to_bits();
            }
        }
    }
}

pub(super) fn difference(call: &mut TwinCall<'_>) {
    let p: DifferencePush = push(call);
    let [first, second, head, distance] = call.buffers else { return };
    for pixel in 0..p.pixels {
        let at = |words: &[u32], c: u32| value(words, c * p.pixels + pixel);
        let length = |words: &[u32]| (0..p.channels).map(|c| at(words, c).powi(2)).sum::<f64>().sqrt() + EPSILON;
        let (a, b) = (length(first), length(second));
        let term = |c| value(head, c) * (at(first, c) / a - at(second, c) / b).powi(2);
        distance[pixel as usize] = ((0..p.channels).map(term).sum::<f64>() as f32).to_bits();
    }
}
