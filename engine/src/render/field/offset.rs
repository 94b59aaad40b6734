//! Kernel `field_offset`: a head's outputs to `nonrigid_offset float[10][N]`.

use glam::Vec3;

use crate::error::Result;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::gpu::{Groups, Recorder, Slice};
use crate::render::angle::sin_cos;
use crate::render::frame::Frame;
use crate::render::twin::{f32_at, push, set_f32, spec, struct_at, vec4_at};
use crate::scene::field::FieldRule;

crate::gpu_struct! {
    /// Push constants of [`FIELD_OFFSET`].
    pub struct OffsetPush {
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

/// Offsets of centre, rotation and scale from a head's outputs, by [`FieldRule`].
pub static FIELD_OFFSET: Kernel = Kernel {
    name: "field_offset",
    doc: "deformation field: the head's outputs as offsets of the Gaussians",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE", "RULE"],
    push: OffsetPush::FIELDS,
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("head_output", Access::Read, Element::F32),
        Binding::new("mean", Access::Read, Element::F32),
        Binding::new("log_scale", Access::Read, Element::F32),
        Binding::new("rotation", Access::Read, Element::F32),
        Binding::new("nonrigid_offset", Access::Write, Element::F32),
    ],
    twin: offset_twin,
    // Divisions and exponentials of 3 + 2|x| ulps.
    tolerance: Tolerance { absolute: 1e-5, relative: 2e-5, flips: 0.0 },
    bytes: |work| work.get("rows") * 4 * (work.get("outputs") + 10 + 10),
    spirv: include_bytes!("../../../../spirv_cache/field_offset.spv"),
};

/// Records it.
pub(super) fn record(r: &mut Recorder, rule: FieldRule, push: OffsetPush, buffers: &[Slice; 6]) -> Result<()> {
    let groups = Groups::Direct(push.rows.div_ceil(THREADS).into());
    r.dispatch_untyped(&FIELD_OFFSET, &[rule as u32], bytemuck::bytes_of(&push), buffers, groups)
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

fn offset_twin(call: &mut TwinCall<'_>) {
    let p: OffsetPush = push(call);
    let frame: Frame = struct_at(&call.buffers[0], 0);
    let rule = spec(call, 1);
    let n = frame.gaussians as usize;
    for row in 0..p.rows as usize {
        let g = p.first_row as usize + row;
        let output = |i: usize| f32_at(&call.buffers[1], row * p.outputs as usize + i);
        let vector = |i: usize| Vec3::new(output(i), output(i + 1), output(i + 2));
        let of_gaussian = |buffer: usize, axis: usize| f32_at(&call.buffers[buffer], axis * n + g);
        let after = if rule == FieldRule::Screw as u32 { 6 } else { 3 };
        let mut offset: [f32; 10] = std::array::from_fn(|i| output(if i < 3 { i } else { after + i - 3 }));
        if rule == FieldRule::Screw as u32 {
            let x = Vec3::from_array([0, 1, 2].map(|axis| of_gaussian(2, axis)));
            offset[..3].copy_from_slice(&screw(vector(0), vector(3), x).to_array());
        }
        if rule == FieldRule::Raw as u32 {
            let length = vec4_at(&call.buffers[4], g).iter().map(|c| c * c).sum::<f32>().sqrt();
            offset[3..7].iter_mut().for_each(|c| *c /= length);
            (0..3).for_each(|axis| offset[7 + axis] = of_gaussian(3, axis).exp() * (offset[7 + axis].exp() - 1.0));
        }
        offset.iter().enumerate().for_each(|(i, v)| set_f32(&mut call.buffers[5], i * n + g, *v));
    }
}
