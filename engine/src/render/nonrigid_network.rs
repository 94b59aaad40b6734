//! Kernel `nonrigid_network`: network G for every Gaussian in one dispatch.
//!
//! Reads the frame (time, keys), `mean float[3][N]`, `superpoint_of_gaussian`, `pose vec4[T][M][2]` and `parameter`
//! ([`pack_parameters`]); writes `nonrigid_offset float[10][N]`: dx (world units), dq (w,x,y,z), ds (world units), which
//! `deform_project` adds to the moved centre, to the moved rotation before it is normalised, and to the scale. The network's
//! input is the rigidly moved centre, which the kernel computes itself. Source: SP-GS, section 3.5.

use super::angle::sin_cos;
use super::deformation::offset_buffer;
use super::frame::Frame;
use super::scene_buffers::SceneBuffers;
use super::superpoint_motion::SuperpointMotion;
use super::twin::{f32_at, set_f32, struct_at};
use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Tolerance, Workload};
use crate::gpu::{Buffer, Gpu, Groups, Recorder, Slice};
use crate::scene::NonrigidNetwork;
use crate::scene::network::{NONRIGID_ENCODING, NONRIGID_LAYERS, NONRIGID_ROWS, NONRIGID_WIDTH, relu};
use crate::scene::parameter::MEAN;

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

crate::gpu_constants! {
    /// Specialisation constants of [`NONRIGID_NETWORK`].
    pub struct NonrigidNetworkConstants {
        /// 1: superpoints move the Gaussians.
        motion,
        /// How weights reach the lanes: 0 by shuffles, else through shared memory.
        stage,
        /// K of soft superpoints, or 0 ([`super::superpoint_motion`]).
        blend,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`NONRIGID_NETWORK`].
    pub struct NonrigidNetworkBuffers {
        frame: Read Struct(Frame),
        mean: Read F32,
        /// Of a moving scene.
        superpoint_of_gaussian: optional Read U32,
        /// Of a moving scene.
        pose: optional Read F32,
        parameter: Read F32,
        nonrigid_offset: Write F32,
        /// `[ceil(K/2)][N]`; of soft superpoints ([`superpoint_motion`](crate::render::superpoint_motion)).
        blend_index: optional Read U32,
        /// `[K-1][N]`; of soft superpoints.
        blend_weight: optional Read F32,
    }
}

crate::kernel! {
    /// Network G: offsets of every Gaussian at the frame's time.
    pub static NONRIGID_NETWORK: NonrigidNetworkKernel = {
        name: "nonrigid_network",
        doc: "network G: moved centre and time to offsets of centre, rotation and scale",
        local_size: 128,
        constants: NonrigidNetworkConstants,
        push: NonrigidPush,
        buffers: NonrigidNetworkBuffers,
        twin: nonrigid_network_twin,
        // The encoding has slopes of 2^9: a centre that differs by an ulp moves its sines by 1e-4, and sums of 84 add up.
        tolerance: Tolerance { absolute: 2e-4, relative: 2e-4, flips: 1e-3 },
        bytes: nonrigid_network_bytes,
    }
}

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
        let moves = scene.deformation.moves();
        let buffers = NonrigidNetworkBuffers {
            frame: frame.whole(),
            mean: scene.parameter[MEAN].whole(),
            superpoint_of_gaussian: scene.deformation.hard_superpoints(),
            pose: moves.then(|| pose.whole()),
            parameter: self.parameter.whole(),
            nonrigid_offset: self.offset.whole(),
            blend_index: scene.deformation.blend_index(),
            blend_weight: scene.deformation.blend_weight(),
        };
        let constants = constants(gpu, moves, scene.deformation.blend_slots());
        record(r, scene.gaussians, constants, scene.origin.as_vec3().to_array(), buffers)?;
        Ok(self.offset.whole())
    }
}

/// Constants of [`NONRIGID_NETWORK`] on this device: moving or not, K of soft superpoints or 0, and how weights are read.
pub fn constants(gpu: &Gpu, moving: bool, blend: u32) -> NonrigidNetworkConstants {
    // Shuffles serve lanes that share their outputs: 16 at most.
    let shuffle = gpu.info().is_cpu() && gpu.subgroup_size_of(&NONRIGID_NETWORK) <= 16;
    NonrigidNetworkConstants { motion: moving.into(), stage: (!shuffle).into(), blend }
}

/// Records network G for `gaussians` Gaussians; `origin` is what was subtracted from every centre.
pub fn record(
    r: &mut Recorder,
    gaussians: u32,
    constants: NonrigidNetworkConstants,
    origin: [f32; 3],
    buffers: NonrigidNetworkBuffers<Slice>,
) -> Result<()> {
    let [origin_x, origin_y, origin_z] = origin;
    let push = NonrigidPush { origin_x, origin_y, origin_z };
    let groups = Groups::Direct(gaussians.div_ceil(NONRIGID_GAUSSIANS).into());
    r.dispatch(&NONRIGID_NETWORK, constants, push, buffers, groups)
}

fn within(v: [f32; 3]) -> bool {
    v.iter().all(|x| x.is_finite() && x.abs() <= MAX_ABS_CENTRE)
}

/// Twin of `glsl/lib/moved_centre.glsl`; `motion` is `None` for a scene that stands still.
pub(crate) fn moved_centre(frame: &Frame, mean: &[u32], motion: Option<SuperpointMotion<'_>>, g: usize) -> [f32; 3] {
    let n = frame.gaussians as usize;
    let mean: [f32; 3] = std::array::from_fn(|axis| f32_at(mean, axis * n + g));
    let Some(motion) = motion.filter(|_| within(mean)) else {
        return if within(mean) { mean } else { [0.0; 3] };
    };
    let moved = motion.displacement(frame, g, mean);
    moved.map_or([0.0; 3], |(shift, _)| std::array::from_fn(|i| mean[i] + shift[i]))
}

/// What moves Gaussians, for the twins of kernels that read `moved_centre`.
pub(crate) fn superpoint_motion<'a>(
    moving: bool,
    slots: u32,
    [superpoint_of_gaussian, pose, blend_index, blend_weight]: [Option<&'a [u32]>; 4],
) -> Option<SuperpointMotion<'a>> {
    pose.filter(|_| moving).map(|pose| SuperpointMotion {
        superpoint_of_gaussian: superpoint_of_gaussian.unwrap_or_default(),
        pose,
        slots,
        blend_index: blend_index.unwrap_or_default(),
        blend_weight: blend_weight.unwrap_or_default(),
    })
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

fn nonrigid_network_twin(call: Call<'_, NonrigidNetworkKernel>) {
    let groups = call.group_count();
    let Call { constants, push: p, buffers: b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let words =
        [b.superpoint_of_gaussian.as_deref(), b.pose.as_deref(), b.blend_index.as_deref(), b.blend_weight.as_deref()];
    let motion = superpoint_motion(constants.motion != 0, constants.blend, words);
    let n = frame.gaussians as usize;
    for g in 0..n.min((groups * NONRIGID_GAUSSIANS) as usize) {
        let centre = moved_centre(&frame, b.mean, motion, g);
        let centre = [centre[0] + p.origin_x, centre[1] + p.origin_y, centre[2] + p.origin_z];
        let time = frame.time;
        let mut values: Vec<f32> = (0..NONRIGID_ENCODING).map(|e| encoded(centre, time, e)).collect();
        let mut base = 0;
        for layer in 0..=NONRIGID_LAYERS {
            let (inputs, outputs) = (inputs(layer), outputs(layer));
            let at = |i: usize| f64::from(f32_at(b.parameter, base + i));
            let output = |o: usize| {
                let sum: f64 = values.iter().enumerate().map(|(k, v)| at(o * inputs + k) * f64::from(*v)).sum();
                let y = sum + at(outputs * inputs + o);
                if layer < NONRIGID_LAYERS { relu(y) as f32 } else { y as f32 }
            };
            values = (0..outputs).map(output).collect();
            base += (outputs * (inputs + 1)).next_multiple_of(ALIGNMENT);
        }
        (0..NONRIGID_PLANES).for_each(|o| set_f32(b.nonrigid_offset, o * n + g, values[o]));
    }
}
