//! Network G (non-rigid stage) in training: backward pass and Adam; the forward pass is the renderer's own kernel
//! [`crate::render::nonrigid_network`], on these very weights.
//!
//! The backward pass computes the activations again, [`CHUNK`] Gaussians at a time, so that memory does not grow with the
//! scene: per Gaussian of a chunk (84 + 3·64 + 3·64 + 12)·4 = 1.9 KB, 126 MB at most. `encode_gaussians`, three
//! `linear_forward`, `gather_gradient`, three `linear_backward_input`, then four `linear_backward_weight` that write sums over
//! slices of rows; after the last chunk four `linear_update` add the slices in order and apply Adam.

pub mod encode_gaussians;
#[cfg(test)]
mod tests;

use self::encode_gaussians::{ENCODE_GAUSSIANS, EncodeGaussiansPush};
use super::linear::gather_gradient::GatherGradientPush;
use super::linear::linear_update::LinearUpdatePush;
use super::linear::{Layer, Network, Output, Parameters, Pass, Shape, Split, Stage};
use crate::error::{Error, Result};
use crate::gpu::kernel::Kernel;
use crate::gpu::{Buffer, Gpu, Memory, Recorder, Slice};
use crate::render::nonrigid_network::{self, NonrigidNetworkBuffers};
use crate::render::superpoint_motion::BlendSlices;
use crate::scene::NonrigidNetwork;
use crate::scene::network::{NONRIGID_ENCODING, NONRIGID_LAYERS, NONRIGID_ROWS, NONRIGID_WIDTH};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&ENCODE_GAUSSIANS.kernel];

/// Gaussians whose activations are kept at a time.
pub const CHUNK: u32 = 65_536;
/// Sums over rows that are kept apart, about.
const SLICES: u32 = 256;
/// Outputs of G: translation, rotation and, unless switched off, scale.
const WITH_SCALE: u32 = 10;
const WITHOUT_SCALE: u32 = 7;
/// Fewest rows of such a sum.
const MIN_ROWS_PER_SLICE: u32 = 512;

/// What the network's input is made of.
#[derive(Debug, Clone)]
pub struct Inputs<'a> {
    /// The frame: its time, counts and keys.
    pub frame: &'a Slice,
    /// `float[3][N]`.
    pub mean: &'a Slice,
    /// `uint[N]`.
    pub superpoint_of_gaussian: &'a Slice,
    /// `vec4[T][M][2]`.
    pub pose: &'a Slice,
    /// Whether the superpoints move; else the centres are the input.
    pub moving: bool,
    /// Soft superpoints, in place of `superpoint_of_gaussian`.
    pub blend: Option<&'a BlendSlices>,
}

impl Inputs<'_> {
    /// `superpoint_of_gaussian` where kernels read it.
    fn hard_superpoints(&self) -> Option<Slice> {
        (self.moving && self.blend.is_none()).then(|| self.superpoint_of_gaussian.clone())
    }

    fn blend_slots(&self) -> u32 {
        self.blend.map_or(0, |b| b.slots)
    }
}

/// What a backward pass reads besides.
#[derive(Debug, Clone)]
pub struct Backward<'a> {
    /// The step's data.
    pub step: &'a Slice,
    /// The frame's counters: nothing changes when the frame failed.
    pub counters: &'a Slice,
    /// Reports of numbers that are not finite.
    pub status: &'a Slice,
    /// `float[10][N]`: gradient of `nonrigid_offset`.
    pub nonrigid_gradient: &'a Slice,
}

/// Network G with its moments and the work space of a chunk on the device.
#[derive(Debug)]
pub struct NetworkG {
    gpu: Gpu,
    capacity: u32,
    chunk: u32,
    rows_per_slice: u32,
    slices: u32,
    stage: Stage,
    /// Outputs that are trained.
    columns: u32,
    parameters: Parameters,
    /// Encoding, then the hidden layers' outputs, of a chunk.
    activation: Buffer,
    /// Gradients before the ReLU of each hidden layer, then of the heads, of a chunk.
    activation_gradient: Buffer,
    /// Of each layer `[slices][padded parameters]`.
    slice_gradient: Buffer,
    /// Their sums, as the parameters; written by [`Output::Gradient`] only.
    gradient: Buffer,
}

fn shapes() -> Vec<Shape> {
    let width = NONRIGID_WIDTH as u32;
    let hidden = (0..NONRIGID_LAYERS).map(|i| Shape {
        inputs_0: NonrigidNetwork::layer_inputs(i) as u32,
        inputs_1: 0,
        outputs: width,
    });
    hidden.chain([Shape { inputs_0: width, inputs_1: 0, outputs: NONRIGID_ROWS as u32 }]).collect()
}

impl NetworkG {
    /// For up to `capacity` Gaussians; the moments start at 0.
    pub fn new(gpu: &Gpu, network: &NonrigidNetwork, capacity: u32) -> Result<Self> {
        let parameters = Parameters::new(gpu, "network_g", &shapes(), &network.device_layers()?)?;
        let capacity = capacity.max(1).next_multiple_of(64);
        let chunk = capacity.min(CHUNK);
        let rows_per_slice = capacity.div_ceil(SLICES).next_multiple_of(64).max(MIN_ROWS_PER_SLICE).min(chunk);
        let slices = capacity.div_ceil(chunk) * chunk.div_ceil(rows_per_slice);
        let hidden = NONRIGID_LAYERS * NONRIGID_WIDTH;
        let rows = |columns: usize| u64::from(chunk) * columns as u64 * 4;
        let buffer = |name: &str, bytes| gpu.buffer(&format!("network_g.{name}"), bytes, Memory::Device);
        Ok(Self {
            gpu: gpu.clone(),
            capacity,
            chunk,
            rows_per_slice,
            slices,
            stage: Stage::of(gpu),
            columns: WITH_SCALE,
            activation: buffer("activation", rows(NONRIGID_ENCODING + hidden))?,
            activation_gradient: buffer("activation_gradient", rows(hidden + NONRIGID_ROWS))?,
            slice_gradient: buffer("slice_gradient", u64::from(slices) * parameters.bytes() / 3)?,
            gradient: buffer("gradient", parameters.bytes() / 3)?,
            parameters,
        })
    }

    /// The same network with its products tiled in the given way and `chunk` Gaussians at a time; for comparisons.
    pub fn with_stage(gpu: &Gpu, network: &NonrigidNetwork, capacity: u32, stage: Stage, chunk: u32) -> Result<Self> {
        let made = Self::new(gpu, network, capacity)?;
        let chunk = chunk.min(made.chunk).next_multiple_of(64);
        let rows_per_slice = made.rows_per_slice.min(chunk);
        let slices = made.capacity.div_ceil(chunk) * chunk.div_ceil(rows_per_slice);
        let bytes = u64::from(slices) * made.parameters.bytes() / 3;
        let slice_gradient = gpu.buffer("network_g.slice_gradient", bytes, Memory::Device)?;
        Ok(Self { stage, chunk, rows_per_slice, slices, slice_gradient, ..made })
    }

    /// Whether G also adds to scales. Without it the rows of its scaling head get no gradient and must be zero.
    #[must_use]
    pub fn with_scale(mut self, scale: bool) -> Self {
        self.columns = if scale { WITH_SCALE } else { WITHOUT_SCALE };
        self
    }

    /// Gaussians that it has room for.
    pub fn capacity(&self) -> u32 {
        self.capacity
    }

    /// Makes room for `gaussians`; weights and moments stay. Commands recorded before are void.
    ///
    /// # Errors
    /// `OutOfMemory`, `DeviceLost`.
    pub fn grow(&mut self, gaussians: u32) -> Result<()> {
        if gaussians > self.capacity {
            let moments = self.download_moments()?;
            // Room for more, so that growth is rare.
            let grown = Self::new(&self.gpu, &self.download()?, gaussians.saturating_add(gaussians / 2))?;
            grown.upload_moments([&moments[0], &moments[1]])?;
            *self = Self { stage: self.stage, columns: self.columns, ..grown };
        }
        Ok(())
    }

    /// Bytes of device memory: weights and moments, then activations and gradients.
    pub fn bytes(&self) -> [u64; 2] {
        let work = [&self.activation, &self.activation_gradient, &self.slice_gradient, &self.gradient];
        [self.parameters.bytes(), work.iter().map(|b| b.bytes()).sum()]
    }

    /// The weights as [`nonrigid_network::NONRIGID_NETWORK`] reads them.
    pub fn parameter(&self) -> Slice {
        let [value, ..] = self.parameters.all();
        value
    }

    /// Weights, first and second moments as the device holds them, layer by layer with padding.
    pub fn state(&self) -> [Slice; 3] {
        self.parameters.all()
    }

    /// Records: offsets `nonrigid_offset float[10][N]` of `gaussians` Gaussians.
    pub fn record_forward(
        &self,
        r: &mut Recorder,
        gaussians: u32,
        from: &Inputs<'_>,
        nonrigid_offset: &Slice,
    ) -> Result<()> {
        if gaussians == 0 {
            return Ok(());
        }
        let Inputs { frame, mean, pose, moving, blend, .. } = from;
        let buffers = NonrigidNetworkBuffers {
            frame: Slice::clone(frame),
            mean: Slice::clone(mean),
            superpoint_of_gaussian: from.hard_superpoints(),
            pose: moving.then(|| Slice::clone(pose)),
            parameter: self.parameter(),
            nonrigid_offset: nonrigid_offset.clone(),
            blend_index: blend.map(|b| b.index.clone()),
            blend_weight: blend.map(|b| b.weight.clone()),
        };
        let constants = nonrigid_network::constants(&self.gpu, *moving, from.blend_slots());
        nonrigid_network::record(r, gaussians, constants, [0.0; 3], buffers)
    }

    /// Records: gradients of all weights from those of the offsets, given to Adam or kept for
    /// [`NetworkG::download_gradient`]. The inputs must be those of the forward pass.
    pub fn record_backward(
        &self,
        r: &mut Recorder,
        gaussians: u32,
        output: Output,
        inputs: &Inputs<'_>,
        from: &Backward<'_>,
    ) -> Result<()> {
        if gaussians > self.capacity {
            let what = "Gaussians of network G".to_owned();
            return Err(Error::Limit { what, need: gaussians.into(), have: self.capacity.into() });
        }
        let slice = |s: &Slice| s.clone();
        let (step, counters, status) = (slice(from.step), slice(from.counters), slice(from.status));
        let pass = Pass { network: Network::G, output, step, counters, status };
        let mut used = 0;
        for first in (0..gaussians).step_by(self.chunk as usize) {
            let rows = (gaussians - first).min(self.chunk);
            self.chunk_backward(r, &pass, inputs, from, [first, rows, gaussians, used])?;
            used += rows.div_ceil(self.rows_per_slice);
        }
        if gaussians == 0 {
            return Ok(());
        }
        (0..=NONRIGID_LAYERS).try_for_each(|i| {
            let (stride, first_index) = (self.parameters.padded(i), self.parameters.first_index(i));
            let kept = || self.gradient.slice(self.start(i), u64::from(stride) * 4);
            let gradient = (output == Output::Gradient).then(kept);
            let weights = self.parameters.shapes()[i].parameters();
            let push = LinearUpdatePush { weights, slices: used, slice_stride: stride, first_index, mean_rate: 0.0 };
            pass.update(r, push, self.split(i, 0).gradient, self.parameters.slices(i), None, gradient)
        })
    }

    /// Gaussians `first..first + rows` of `gaussians`; their sums go to the slices from `slice` on.
    fn chunk_backward(
        &self,
        r: &mut Recorder,
        pass: &Pass,
        inputs: &Inputs<'_>,
        from: &Backward<'_>,
        [first, rows, gaussians, slice]: [u32; 4],
    ) -> Result<()> {
        let push = EncodeGaussiansPush { first_row: first, rows };
        encode_gaussians::record(r, inputs, push, self.activation(None, rows))?;
        let layers: Vec<Layer> = (0..=NONRIGID_LAYERS).map(|i| self.layer(i, rows)).collect();
        layers[..NONRIGID_LAYERS].iter().try_for_each(|layer| layer.forward(r))?;
        let push = GatherGradientPush { rows, first_row: first, plane_stride: gaussians, columns: self.columns };
        pass.gather(r, push, from.nonrigid_gradient, &layers[NONRIGID_LAYERS].output_gradient)?;
        for pair in layers.windows(2).rev() {
            pair[1].backward_input(r, &pair[0])?;
        }
        layers.iter().enumerate().rev().try_for_each(|(i, layer)| layer.backward_weight(r, &self.split(i, slice)))
    }

    /// The weights.
    pub fn download(&self) -> Result<NonrigidNetwork> {
        NonrigidNetwork::from_device_layers(&self.parameters.download()?)
    }

    /// Replaces the weights.
    pub fn upload(&self, network: &NonrigidNetwork) -> Result<()> {
        self.parameters.upload(&network.device_layers()?)
    }

    /// The gradients that [`Output::Gradient`] left, in the network's shape.
    pub fn download_gradient(&self) -> Result<NonrigidNetwork> {
        let words: Vec<f32> = bytemuck::pod_collect_to_vec(&self.gpu.download(&self.gradient)?);
        NonrigidNetwork::from_device_layers(&self.parameters.split(&words))
    }

    /// First and second moments, each flat in the order of [`NonrigidNetwork::flatten`].
    pub fn download_moments(&self) -> Result<[Vec<f32>; 2]> {
        let [first, second] = self.parameters.download_moments()?;
        let flat = |layers: &[Vec<f32>]| NonrigidNetwork::from_device_layers(layers).map(|network| network.flatten());
        Ok([flat(&first)?, flat(&second)?])
    }

    /// Replaces the moments.
    pub fn upload_moments(&self, moments: [&[f32]; 2]) -> Result<()> {
        let unpack = |flat| NonrigidNetwork::from_flat(flat)?.device_layers();
        self.parameters.upload_moments([&unpack(moments[0])?, &unpack(moments[1])?])
    }

    /// Byte at which layer `i` starts in the parameters.
    fn start(&self, i: usize) -> u64 {
        u64::from(self.parameters.first_index(i)) * 4
    }

    fn split(&self, i: usize, first_slice: u32) -> Split {
        let stride = self.parameters.padded(i);
        let (start, bytes) = (self.start(i) * u64::from(self.slices), u64::from(stride) * 4 * u64::from(self.slices));
        let gradient = self.slice_gradient.slice(start, bytes);
        Split { rows_per_slice: self.rows_per_slice, first_slice, slice_stride: stride, gradient }
    }

    fn layer(&self, i: usize, rows: u32) -> Layer {
        let columns = |i: usize| if i < NONRIGID_LAYERS { NONRIGID_WIDTH } else { NONRIGID_ROWS };
        let bytes = |rows: u32, columns: usize| u64::from(rows) * columns as u64 * 4;
        let start = bytes(self.chunk, i * NONRIGID_WIDTH);
        Layer {
            stage: self.stage,
            shape: self.parameters.shapes()[i],
            relu: i < NONRIGID_LAYERS,
            rows,
            input: self.activation(i.checked_sub(1), rows),
            input_1_at: 0,
            // The heads' output is the forward pass's own; nothing reads it here.
            output: self.activation(Some(i.min(NONRIGID_LAYERS - 1)), rows),
            output_gradient: self.activation_gradient.slice(start, bytes(rows, columns(i))),
            parameters: self.parameters.slices(i),
        }
    }

    /// The encoding (`None`) or the output of a hidden layer.
    fn activation(&self, layer: Option<usize>, rows: u32) -> Slice {
        let (before, columns) =
            layer.map_or((0, NONRIGID_ENCODING), |i| (NONRIGID_ENCODING + i * NONRIGID_WIDTH, NONRIGID_WIDTH));
        let bytes = |rows: u32, columns: usize| u64::from(rows) * columns as u64 * 4;
        self.activation.slice(bytes(self.chunk, before), bytes(rows, columns))
    }
}
