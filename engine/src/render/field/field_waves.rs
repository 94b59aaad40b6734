//! Kernel `field_waves`: encoded points and time, 3 + 6 octaves + 21 values or, with a network of time, 30 instead of 21,
//! then zeros up to a multiple of 4.

use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::frame::Frame;
use crate::render::nonrigid_network::encoded;
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::scene::field::{FIELD_TIME_NETWORK, FIELD_TIME_OCTAVES};
use crate::scene::network::{POSITION_FREQUENCIES, relu};

crate::gpu_struct! {
    /// Push constants of [`FIELD_WAVES`].
    pub struct FieldWavesPush {
        /// Point of the first row.
        pub first_row: u32,
        /// Rows to write.
        pub rows: u32,
        /// Points in all: floats from one plane of `point` to the next.
        pub points: u32,
    }
}

/// Points per workgroup.
const GROUP_POINTS: u32 = 64;
/// Element of [`encoded`] with which time begins.
const TIME_ELEMENT: usize = 3 + 6 * POSITION_FREQUENCIES;
/// Inputs of the network of time.
const TIME_INPUTS: usize = 1 + 2 * FIELD_TIME_OCTAVES[1];

crate::gpu_constants! {
    /// Specialisation constants of [`FIELD_WAVES`].
    pub struct FieldWavesConstants {
        /// 1: time goes through a network.
        time_network,
        /// Octaves of the points' encoding.
        octaves,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`FIELD_WAVES`].
    pub struct FieldWavesBuffers {
        frame: Read Struct(Frame),
        /// `[3][points]`, world units.
        point: Read F32,
        /// Of the network of time: weights and bias of each layer.
        parameter: optional Read F32,
        /// `[rows, columns]`
        encoding: Write F32,
    }
}

crate::kernel! {
    /// Positional encoding of points and time, with the network of time where there is one.
    pub static FIELD_WAVES: FieldWaves = {
        name: "field_waves",
        doc: "deformation field: encoded points and time",
        local_size: 256,
        constants: FieldWavesConstants,
        push: FieldWavesPush,
        buffers: FieldWavesBuffers,
        twin: field_waves_twin,
        // Sines are the twin's line by line; sums of 256 outputs of the network of time are not.
        tolerance: Tolerance { absolute: 1e-4, relative: 2e-5, flips: 0.0 },
        bytes: |work| work.get("rows") * 4 * (3 + 93),
    }
}

/// Records it.
pub(super) fn record(
    r: &mut Recorder,
    octaves: u32,
    push: FieldWavesPush,
    buffers: FieldWavesBuffers<Slice>,
) -> Result<()> {
    let groups = Groups::Direct(push.rows.div_ceil(GROUP_POINTS).into());
    let constants = FieldWavesConstants { time_network: buffers.parameter.is_some().into(), octaves };
    r.dispatch(&FIELD_WAVES, constants, push, buffers, groups)
}

fn field_waves_twin(call: Call<'_, FieldWaves>) {
    let Call { constants, push: p, buffers: b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let time = frame.time;
    let direct = |count: usize| (0..count).map(|e| encoded([0.0; 3], time, TIME_ELEMENT + e)).collect::<Vec<_>>();
    let code = match &b.parameter {
        Some(parameter) if constants.time_network == 1 => time_network(parameter, &direct(TIME_INPUTS)),
        _ => direct(1 + 2 * FIELD_TIME_OCTAVES[0]),
    };
    let position = 3 + 6 * constants.octaves as usize;
    let columns = (position + code.len()).next_multiple_of(4);
    for row in 0..p.rows as usize {
        let at = |axis: usize| f32_at(b.point, axis * p.points as usize + p.first_row as usize + row);
        let point = [at(0), at(1), at(2)];
        for e in 0..columns {
            let of_time = |e: usize| code.get(e).copied().unwrap_or_default();
            let value = if e < position { encoded(point, time, e) } else { of_time(e - position) };
            set_f32(b.encoding, row * columns + e, value);
        }
    }
}

/// 13 → 256 → ReLU → 30.
fn time_network(words: &[u32], code: &[f32]) -> Vec<f32> {
    let [hidden, outputs] = FIELD_TIME_NETWORK;
    let dense = |base: usize, x: &[f32], outputs: usize| -> Vec<f32> {
        let sum = |o: usize| -> f64 {
            x.iter().enumerate().map(|(i, v)| f64::from(f32_at(words, base + o * x.len() + i)) * f64::from(*v)).sum()
        };
        (0..outputs).map(|o| (sum(o) + f64::from(f32_at(words, base + outputs * x.len() + o))) as f32).collect()
    };
    let first: Vec<f32> = dense(0, code, hidden).into_iter().map(|v| relu(v.into()) as f32).collect();
    dense(hidden * (code.len() + 1), &first, outputs)
}
