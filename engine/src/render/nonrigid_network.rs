//! Kernel `nonrigid_network`: network G for every Gaussian in one dispatch.
//!
//! Reads the frame (time, keys), `mean float[3][N]`, `superpoint_of_gaussian`, `pose vec4[T][M][2]` and `parameter`
//! ([`pack_parameters`]); writes `nonrigid_offset float[10][N]`: dx (world units), dq (w,x,y,z), ds (world units), which
//! `deform_project` adds to the moved centre, to the moved rotation before it is normalised, and to the scale. The network's
//! input is the rigidly moved centre, which the kernel computes itself. Source: SP-GS, section 3.5.

use super::angle::sin_cos;
use super::deformation::offset_buffer;
use super::frame::Frame;
use super::quaternion;
use super::scene_buffers::SceneBuffers;
use super::twin::{f32_at, group_count, push, set_f32, spec, struct_at, vec4_at};
use crate::error::Result;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall, Workload};
use crate::gpu::{Buffer, Gpu, Groups, Recorder, Slice};
use crate::scene::NonrigidNetwork;
use crate::scene::network::{NONRIGID_ENCODING, NONRIGID_LAYERS, NONRIGID_ROWS, NONRIGID_WIDTH, relu};

crate::gpu_struct! {
    /// Push constants of [`NONRIGID_NETWORK`]: what was subtracted from every centre, world units.
    pub struct NonrigidPush {
        /// x.
        pub origin_x: f32,
        /// y.
        pub origin_y: f32,
        /// z.
        pub origin_z: f32,
    }
}

/// Gaussians per workgroup.
pub const NONRIGID_GAUSSIANS: u32 = 64;
/// Planes of `nonrigid_offset`.
pub const NONRIGID_PLANES: usize = 10;
/// Floats that each layer's parameters are padded to.
const ALIGNMENT: usize = 64;
const MAX_ABS_CENTRE: f32 = 1e15;

/// Network G: offsets of every Gaussian at the frame's time.
pub static NONRIGID_NETWORK: Kernel = Kernel {
    name: "nonrigid_network",
    doc: "network G: moved centre and time to offsets of centre, rotation and scale",
    local_size: 128,
    spec: &["SUBGROUP_SIZE", "MOTION", "STAGE"],
    push: NonrigidPush::FIELDS,
    bindings: &[
        Binding::of_struct("frame", Access::Read, Frame::FIELDS),
        Binding::new("mean", Access::Read, Element::F32),
        Binding::new("superpoint_of_gaussian", Access::Read, Element::U32),
        Binding::new("pose", Access::Read, Element::F32),
        Binding::new("parameter", Access::Read, Element::F32),
        Binding::new("nonrigid_offset", Access::Write, Element::F32),
    ],
    twin: nonrigid_network_twin,
    // The encoding has slopes of 2^9: a centre that differs by an ulp moves its sines by 1e-4, and sums of 84 add up.
    tolerance: Tolerance { absolute: 2e-4, relative: 2e-4, flips: 1e-3 },
    bytes: nonrigid_network_bytes,
    spirv: include_bytes!("../../../spirv_cache/nonrigid_network.spv"),
};

/// The weights once; of each Gaussian its centre, superpoint and offsets.
fn nonrigid_network_bytes(work: &Workload) -> u64 {
    4 * parameter_words() as u64 + work.get("gaussians") * (12 + 4 + 4 * NONRIGID_PLANES as u64)
}

/// Floats of `parameter`.
fn parameter_words() -> usize {
    (0..=NONRIGID_LAYERS).map(|i| (outputs(i) * (inputs(i) + 1)).next_multiple_of(ALIGNMENT)).sum()
}

fn inputs(layer: usize) -> usize {
    if layer == 0 { NONRIGID_ENCODING } else { NONRIGID_WIDTH }
}

fn outputs(layer: usize) -> usize {
    if layer < NONRIGID_LAYERS { NONRIGID_WIDTH } else { NONRIGID_ROWS }
}

/// The `parameter` buffer: of each layer the weights `[outputs, inputs]` and the bias, padded to 64 floats; the heads are one
/// layer of 12 outputs. The layout in which training keeps them ([`crate::train::linear::Parameters`]).
pub fn pack_parameters(network: &NonrigidNetwork) -> Result<Vec<f32>> {
    let mut words = Vec::with_capacity(parameter_words());
    for layer in network.device_layers()? {
        words.extend(layer);
        words.resize(words.len().next_multiple_of(ALIGNMENT), 0.0);
    }
    Ok(words)
}

/// Network G on the device.
#[derive(Debug)]
pub(crate) struct NonrigidBuffers {
    /// Packed weights.
    parameter: Buffer,
    /// `float[10][N]`.
    offset: Buffer,
}

impl NonrigidBuffers {
    pub(super) fn new(gpu: &Gpu, network: &NonrigidNetwork, gaussians: usize) -> Result<Self> {
        let parameter = pack_parameters(network)?;
        Ok(Self {
            parameter: gpu.buffer_with("nonrigid_parameter", bytemuck::cast_slice(&parameter))?,
            offset: offset_buffer(gpu, gaussians)?,
        })
    }

    /// Bytes of device memory.
    pub(super) fn bytes(&self) -> u64 {
        self.parameter.bytes() + self.offset.bytes()
    }

    /// Records the offsets of all Gaussians at the frame's time.
    pub(super) fn record(
        &self,
        gpu: &Gpu,
        r: &mut Recorder,
        scene: &SceneBuffers,
        frame: &Buffer,
        pose: &Buffer,
    ) -> Result<Slice> {
        let of_gaussian = &scene.deformation.superpoint_of_gaussian;
        let buffers = [frame, &scene.mean, of_gaussian, pose, &self.parameter, &self.offset].map(Slice::from);
        let specialisation = specialisation(gpu, scene.deformation.moves());
        record(r, scene.gaussians, specialisation, scene.origin.as_vec3().to_array(), &buffers)?;
        Ok(Slice::from(&self.offset))
    }
}

/// Specialisation of [`NONRIGID_NETWORK`] on this device (ids 1…): moving or not, and how weights are read.
pub fn specialisation(gpu: &Gpu, moving: bool) -> [u32; 2] {
    // Shuffles serve lanes that share their outputs: 16 at most.
    let shuffle = gpu.info().is_cpu() && gpu.subgroup_size_of(&NONRIGID_NETWORK) <= 16;
    [u32::from(moving), u32::from(!shuffle)]
}

/// Records network G for `gaussians` Gaussians; `buffers` in binding order, `origin` what was subtracted from every centre.
pub fn record(
    r: &mut Recorder,
    gaussians: u32,
    specialisation: [u32; 2],
    origin: [f32; 3],
    buffers: &[Slice; 6],
) -> Result<()> {
    let [origin_x, origin_y, origin_z] = origin;
    let push = NonrigidPush { origin_x, origin_y, origin_z };
    let groups = Groups::Direct(gaussians.div_ceil(NONRIGID_GAUSSIANS).into());
    r.dispatch(&NONRIGID_NETWORK, &specialisation, bytemuck::bytes_of(&push), buffers, groups)
}

fn within(v: [f32; 3]) -> bool {
    v.iter().all(|x| x.is_finite() && x.abs() <= MAX_ABS_CENTRE)
}

/// Twin of `glsl/lib/moved_centre.glsl`; `buffers`: frame, mean, superpoint_of_gaussian, pose.
pub(crate) fn moved_centre(buffers: &[Vec<u32>], motion: u32, g: usize) -> [f32; 3] {
    let frame: Frame = struct_at(&buffers[0], 0);
    let n = frame.counts[0] as usize;
    let mean: [f32; 3] = std::array::from_fn(|axis| f32_at(&buffers[1], axis * n + g));
    if motion == 0 || !within(mean) {
        return if within(mean) { mean } else { [0.0; 3] };
    }
    let superpoint = buffers[2][g];
    if superpoint >= frame.counts[1] {
        return [0.0; 3];
    }
    let key = |k: u32| (2 * (k * frame.counts[1] + superpoint)) as usize;
    let weight = frame.camera_position_low[3];
    let lerp = |offset: usize| -> [f32; 3] {
        let pair = [frame.counts[2], frame.counts[3]].map(|k| vec4_at(&buffers[3], key(k) + offset));
        std::array::from_fn(|i| pair[0][i] * (1.0 - weight) + pair[1][i] * weight)
    };
    let (r, translation) = (lerp(0), lerp(1));
    if !within(r) || !within(translation) {
        return [0.0; 3];
    }
    let turn = quaternion::displacement(quaternion::exp(r), mean);
    std::array::from_fn(|i| mean[i] + (turn[i] + translation[i]))
}

/// Element `e` of `[p, sin 2ᵏp, cos 2ᵏp, …, t, sin 2ᵏt, cos 2ᵏt, …]`, p in 10 octaves; twin of `glsl/lib/encoding.glsl`.
pub(crate) fn encoded(position: [f32; 3], time: f32, e: usize) -> f32 {
    const POSITION: usize = 63;
    let (x, octave, part) = match e {
        0..3 => (position[e], 0, 0),
        3..POSITION => (position[(e - 3) % 3], (e - 3) / 6, 1 + (e - 3) % 6 / 3),
        POSITION => (time, 0, 0),
        _ => (time, (e - POSITION - 1) / 2, 1 + (e - POSITION - 1) % 2),
    };
    if part == 0 { x } else { sin_cos(x * (1_u32 << octave) as f32)[part - 1] }
}

fn nonrigid_network_twin(call: &mut TwinCall<'_>) {
    let frame: Frame = struct_at(&call.buffers[0], 0);
    let p: NonrigidPush = push(call);
    let motion = spec(call, 1);
    let n = frame.counts[0] as usize;
    for g in 0..n.min((group_count(call) * NONRIGID_GAUSSIANS) as usize) {
        let centre = moved_centre(call.buffers, motion, g);
        let centre = [centre[0] + p.origin_x, centre[1] + p.origin_y, centre[2] + p.origin_z];
        let time = frame.background[3];
        let mut values: Vec<f32> = (0..NONRIGID_ENCODING).map(|e| encoded(centre, time, e)).collect();
        let mut base = 0;
        for layer in 0..=NONRIGID_LAYERS {
            let (inputs, outputs) = (inputs(layer), outputs(layer));
            let at = |i: usize| f64::from(f32_at(&call.buffers[4], base + i));
            let output = |o: usize| {
                let sum: f64 = values.iter().enumerate().map(|(k, v)| at(o * inputs + k) * f64::from(*v)).sum();
                let y = sum + at(outputs * inputs + o);
                if layer < NONRIGID_LAYERS { relu(y) as f32 } else { y as f32 }
            };
            values = (0..outputs).map(output).collect();
            base += (outputs * (inputs + 1)).next_multiple_of(ALIGNMENT);
        }
        (0..NONRIGID_PLANES).for_each(|o| set_f32(&mut call.buffers[5], o * n + g, values[o]));
    }
}
