//! Kernel `field_offset`: a head's outputs to `nonrigid_offset float[10][N]`.

use glam::Vec3;

use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::angle::sin_cos;
use crate::render::frame::Frame;
use crate::render::twin::{f32_at, set_f32, struct_at, vec4_at};
use crate::scene::field::FieldRule;

crate::gpu_struct! {
    /// Push constants of [`FIELD_OFFSET`].
    pub struct FieldOffsetPush {
        /// Gaussian of the first row.
        pub first_row: u32,
        /// Rows of `head_output`.
        pub rows: u32,
        /// Its columns.
        pub outputs: u32,
    }
}

const THREADS: u32 = 256;
const SCREW_EPSILON: f32 = 1e-5;

crate::gpu_constants! {
    /// Specialisation constants of [`FIELD_OFFSET`].
    pub struct FieldOffsetConstants {
        /// A [`FieldRule`].
        rule,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`FIELD_OFFSET`].
    pub struct FieldOffsetBuffers {
        frame: Read Struct(Frame),
        /// `[rows, outputs]`
        head_output: Read F32,
        /// `[3][N]`, world units.
        mean: Read F32,
        /// `[3][N]`
        log_scale: Read F32,
        /// `[N][4]` w, x, y, z, of any length > 0.
        rotation: Read F32,
        /// `[10][N]`
        nonrigid_offset: Write F32,
    }
}

crate::kernel! {
    /// Offsets of centre, rotation and scale from a head's outputs, by [`FieldRule`].
    pub static FIELD_OFFSET: FieldOffset = {
        name: "field_offset",
        doc: "deformation field: the head's outputs as offsets of the Gaussians",
        local_size: THREADS,
        constants: FieldOffsetConstants,
        push: FieldOffsetPush,
        buffers: FieldOffsetBuffers,
        twin: field_offset_twin,
        // Divisions and exponentials of 3 + 2|x| ulps.
        tolerance: Tolerance { absolute: 1e-5, relative: 2e-5, flips: 0.0 },
        bytes: |work| work.get("rows") * 4 * (work.get("outputs") + 10 + 10),
    }
}

/// Records it.
pub(super) fn record(
    r: &mut Recorder,
    rule: FieldRule,
    push: FieldOffsetPush,
    buffers: FieldOffsetBuffers<Slice>,
) -> Result<()> {
    let groups = Groups::Direct(push.rows.div_ceil(THREADS).into());
    r.dispatch(&FIELD_OFFSET, FieldOffsetConstants { rule: rule as u32 }, push, buffers, groups)
}

fn screw(w: Vec3, v: Vec3, x: Vec3) -> Vec3 {
    let theta = w.length();
    if theta.is_nan() || theta <= 1e-12 {
        return v;
    }
    let (axis, moment) = (w / theta + SCREW_EPSILON, v / theta + SCREW_EPSILON);
    let sine = sin_cos(theta)[0];
    let half_sine = sin_cos(0.5 * theta)[0];
    let versine = 2.0 * half_sine * half_sine;
    let (x_1, m_1) = (axis.cross(x), axis.cross(moment));
    sine * x_1 + versine * axis.cross(x_1) + theta * moment + versine * m_1 + (theta - sine) * axis.cross(m_1)
}

fn field_offset_twin(call: Call<'_, FieldOffset>) {
    let Call { constants: FieldOffsetConstants { rule }, push: p, buffers: b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let n = frame.gaussians as usize;
    for row in 0..p.rows as usize {
        let g = p.first_row as usize + row;
        let output = |i: usize| f32_at(b.head_output, row * p.outputs as usize + i);
        let vector = |i: usize| Vec3::new(output(i), output(i + 1), output(i + 2));
        let of_gaussian = |words: &[u32], axis: usize| f32_at(words, axis * n + g);
        let after = if rule == FieldRule::Screw as u32 { 6 } else { 3 };
        let mut offset: [f32; 10] = std::array::from_fn(|i| output(if i < 3 { i } else { after + i - 3 }));
        if rule == FieldRule::Screw as u32 {
            let x = Vec3::from_array([0, 1, 2].map(|axis| of_gaussian(b.mean, axis)));
            offset[..3].copy_from_slice(&screw(vector(0), vector(3), x).to_array());
        }
        if rule == FieldRule::Raw as u32 {
            let length = vec4_at(b.rotation, g).iter().map(|c| c * c).sum::<f32>().sqrt();
            offset[3..7].iter_mut().for_each(|c| *c /= length);
            (0..3).for_each(|axis| {
                offset[7 + axis] = of_gaussian(b.log_scale, axis).exp() * (offset[7 + axis].exp() - 1.0)
            });
        }
        offset.iter().enumerate().for_each(|(i, v)| set_f32(b.nonrigid_offset, i * n + g, *v));
    }
}
