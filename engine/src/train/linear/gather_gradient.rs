//! CPU twins of the kernels of dense layers: plain loops, sums in f64.

use super::kernels::{GatherPush, InputPush, UpdatePush, WeightPush};
use crate::gpu::kernel::TwinCall;
use crate::render::limits::COUNT_FAILED;
use crate::render::linear_forward::concatenated;
use crate::render::twin::{f32_at, push, set_f32, spec, struct_at};
use crate::train::{adam, status, step::Step};

pub(super) fn backward_input(call: &mut TwinCall<'_>) {
    let p: InputPush = push(call);
    let [output_gradient, parameter, input, input_gradient] = call.buffers else { return };
    for row in 0..p.rows {
        for i in 0..p.inputs {
            let product = |o| {
                f64::from(f32_at(output_gradient, (row * p.outputs + o) as usize))
                    * f64::from(f32_at(parameter, (o * p.weight_stride + p.first_input + i) as usize))
            };
            let at = (row * p.inputs + i) as usize;
            let value = if f32_at(input, at) > 0.0 { (0..p.outputs).map(product).sum::<f64>() as f32 } else { 0.0 };
            set_f32(input_gradient, at, value);
        }
    }
}

pub(super) fn backward_weight(call: &mut TwinCall<'_>) {
    let p: WeightPush = push(call);
    let inputs = p.inputs_0 + p.inputs_1;
    let [output_gradient, input, gradient] = call.buffers else { return };
    for slice in 0..p.rows.div_ceil(p.rows_per_slice) {
        let first = slice * p.rows_per_slice;
        let rows = || first..(first + p.rows_per_slice).min(p.rows);
        let start = (p.first_slice + slice) * p.slice_stride;
        for o in 0..p.outputs {
            let upstream = |row: u32| f64::from(f32_at(output_gradient, (row * p.outputs + o) as usize));
            for i in 0..inputs {
                let product = |row| upstream(row) * concatenated(input, [p.inputs_0, p.inputs_1], p.input_1_at, row, i);
                let sum = rows().map(product).sum::<f64>();
                set_f32(gradient, (start + o * inputs + i) as usize, sum as f32);
            }
            let bias = rows().map(upstream).sum::<f64>();
            set_f32(gradient, (start + p.outputs * inputs + o) as usize, bias as f32);
        }
    }
}

pub(super) fn update(call: &mut TwinCall<'_>) {
    let p: UpdatePush = push(call);
    let (kind, network) = (spec(call, 1), spec(call, 2));
    if call.buffers[1][COUNT_FAILED as usize] != 0 {
        return;
    }
    for at in 0..p.weights {
        let sum = (0..p.slices)
            .fold(0.0, |sum, slice| sum + f32_at(&call.buffers[2], (slice * p.slice_stride + at) as usize));
        if kind == 0 {
            set_f32(&mut call.buffers[6], at as usize, sum);
        } else {
            let Some(rest) = split_update(call.buffers) else { return };
            update_weight(rest, network, at, p.first_index + at, sum);
        }
    }
}

/// Step, (parameter, moment_1, moment_2), and status.
type UpdateBuffers<'a> = (Step, &'a mut [Vec<u32>], &'a mut [u32]);

fn split_update(buffers: &mut [Vec<u32>]) -> Option<UpdateBuffers<'_>> {
    let step = struct_at(buffers.first()?, 0);
    let (head, tail) = buffers.split_at_mut(7);
    Some((step, &mut head[3..6], tail.first_mut()?))
}

/// Twin of `glsl/lib/network_update.glsl`.
fn update_weight(buffers: UpdateBuffers<'_>, network: u32, at: u32, index: u32, gradient: f32) {
    let (step, values, words) = buffers;
    let at = at as usize;
    let [_, _, f0, f1] = step.bias_0;
    let [_, _, g0, g1] = step.bias_1;
    let (rate, bias, group) = if network == 0 { (step.rate_1[2], [f0, f1], 5) } else { (step.rate_2[0], [g0, g1], 7) };
    let mut moments = [f32_at(&values[1], at), f32_at(&values[2], at)];
    let value = adam::update(&step, f32_at(&values[0], at), gradient, &mut moments, rate, bias);
    if [gradient, value, moments[0], moments[1]].iter().all(|v| v.is_finite()) {
        set_f32(&mut values[0], at, value);
        set_f32(&mut values[1], at, moments[0]);
        set_f32(&mut values[2], at, moments[1]);
    } else {
        status::report(words, group, index);
    }
}

pub(super) fn gather(call: &mut TwinCall<'_>) {
    let p: GatherPush = push(call);
    let network = spec(call, 1);
    let columns = if network == 0 { 8 } else { 12 };
    let [planes, rows, words] = call.buffers else { return };
    for item in 0..p.rows * columns {
        let (row, column) = (p.first_row + item / columns, item % columns);
        let plane = match network {
            0 => (column % 4 != 3).then_some(column - column / 4),
            _ => (column < p.columns).then_some(column),
        };
        let value = plane.map_or(0.0, |plane| f32_at(planes, (plane * p.plane_stride + row) as usize));
        if !value.is_finite() {
            status::report(words, if network == 0 { 9 } else { 7 }, row);
        }
        set_f32(rows, item as usize, if value.is_finite() { value } else { 0.0 });
    }
}
