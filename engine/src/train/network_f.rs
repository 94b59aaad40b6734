//! Network F in training: forward with kept activations, backward, Adam.
//!
//! With the paper's 8 layers of 256: `encode_superpoints` writes the encodings `[M, 76]`, nine `linear_forward` the
//! activations `[M, 256]` ×8 and the pose.
//! Both heads are one layer of 8 outputs (r, 0, τ, 0): its output *is* `pose`, `vec4[M][2]`; the two rows of zeros get
//! no gradient and stay zero. Backward: `gather_gradient`, eight `linear_backward_input` down the layers, nine independent
//! `linear_backward_weight`, one `linear_update` for all weights. Device memory: 16 bytes per weight and
//! (76 + 2·8·256 + 8)·4 ≈ 16.7 KB per superpoint.

pub mod encode_superpoints;
#[cfg(test)]
mod tests;

use self::encode_superpoints::{ENCODE_SUPERPOINTS, EncodeSuperpointsBuffers};
use super::linear::gather_gradient::GatherGradientPush;
use super::linear::linear_update::LinearUpdatePush;
use super::linear::{Layer, Network, Output, Parameters, Pass, Shape, Split, Stage};
use crate::error::{Error, Result};
use crate::gpu::kernel::Kernel;
use crate::gpu::{Buffer, Gpu, Memory, Recorder, Slice};
use crate::scene::DeformNetwork;
use crate::scene::network::{DeformSize, ENCODING_WIDTH, Linear};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&ENCODE_SUPERPOINTS.kernel];

/// Outputs of the layer of both heads: r, 0, τ, 0.
const HEADS: u32 = 8;

/// What a backward pass reads besides the activations.
#[derive(Debug, Clone)]
pub struct Backward<'a> {
    /// The step's data.
    pub step: &'a Slice,
    /// The frame's counters: nothing changes when the frame failed.
    pub counters: &'a Slice,
    /// Reports of numbers that are not finite.
    pub status: &'a Slice,
    /// `[6][plane_stride]`: dL/dr (of the so(3) vector), then dL/dτ, in the first `superpoints` of each plane.
    pub superpoint_gradient: &'a Slice,
    /// Floats from plane to plane.
    pub plane_stride: u32,
}

/// Network F with its activations, gradients and moments on the device.
#[derive(Debug)]
pub struct NetworkF {
    gpu: Gpu,
    capacity: u32,
    size: DeformSize,
    stage: Stage,
    parameters: Parameters,
    /// How far the mean of the weights goes towards them in a step.
    mean_rate: f32,
    /// Encoding, then the hidden layers' outputs.
    activation: Buffer,
    /// Gradients before the ReLU of each hidden layer, then of the heads.
    activation_gradient: Buffer,
    /// Gradients of the weights, laid out as the parameters; the padding stays 0.
    gradient: Buffer,
}

/// Shapes of the hidden layers and of the heads.
fn shapes(size: DeformSize) -> Vec<Shape> {
    let (width, encoding) = (size.width as u32, ENCODING_WIDTH as u32);
    let hidden = (0..size.layers).map(|i| match i {
        0 => Shape { inputs_0: encoding, inputs_1: 0, outputs: width },
        _ if size.skip_layer() == Some(i) => Shape { inputs_0: encoding, inputs_1: width, outputs: width },
        _ => Shape { inputs_0: width, inputs_1: 0, outputs: width },
    });
    hidden.chain([Shape { inputs_0: width, inputs_1: 0, outputs: HEADS }]).collect()
}

impl NetworkF {
    /// For up to `capacity` superpoints; the moments start at 0.
    pub fn new(gpu: &Gpu, network: &DeformNetwork, capacity: u32) -> Result<Self> {
        let size = network.size();
        let layers = layers(network)?;
        let parameters = Parameters::new(gpu, "network_f", &shapes(size), &layers)?;
        let capacity = capacity.max(1).next_multiple_of(64);
        let bytes = |columns: usize| u64::from(capacity) * columns as u64 * 4;
        let hidden = size.layers * size.width;
        let buffer = |name: &str, bytes| gpu.buffer(&format!("network_f.{name}"), bytes, Memory::Device);
        Ok(Self {
            gpu: gpu.clone(),
            capacity,
            size,
            stage: Stage::of(gpu),
            activation: buffer("activation", bytes(ENCODING_WIDTH + hidden))?,
            activation_gradient: buffer("activation_gradient", bytes(hidden + HEADS as usize))?,
            gradient: gpu.buffer_with("network_f.gradient", &vec![0; (parameters.bytes() / 3) as usize])?,
            parameters,
            mean_rate: 0.0,
        })
    }

    /// The same network with its products tiled in the given way; for comparisons.
    #[must_use]
    pub fn with_stage(mut self, stage: Stage) -> Self {
        self.stage = stage;
        self
    }

    /// Keeps an exponential mean of the weights over about `steps` steps, which starts from them as they are.
    ///
    /// # Errors
    /// `OutOfMemory`.
    pub fn with_mean(mut self, steps: u64) -> Result<Self> {
        self.parameters.keep_mean("network_f")?;
        self.mean_rate = 1.0 / steps.max(1) as f32;
        Ok(self)
    }

    /// Superpoints that it has room for.
    pub fn capacity(&self) -> u32 {
        self.capacity
    }

    /// Bytes of device memory: weights and moments, then activations and gradients.
    pub fn bytes(&self) -> [u64; 2] {
        let work = self.activation.bytes() + self.activation_gradient.bytes() + self.gradient.bytes();
        [self.parameters.bytes(), work]
    }

    /// Records: poses of `superpoints` superpoints at `step.time.x`. `superpoint_position float[M][3]`, world units;
    /// `pose vec4[M][2]`.
    pub fn record_forward(
        &self,
        r: &mut Recorder,
        superpoints: u32,
        step: &Slice,
        superpoint_position: &Slice,
        pose: &Slice,
    ) -> Result<()> {
        self.record_with(r, superpoints, step, superpoint_position, pose, |layer| {
            self.parameters.slices(layer)[0].clone()
        })
    }

    /// [`NetworkF::record_forward`] with the mean of the weights, where one is kept.
    pub fn record_mean(
        &self,
        r: &mut Recorder,
        superpoints: u32,
        step: &Slice,
        superpoint_position: &Slice,
        pose: &Slice,
    ) -> Result<()> {
        self.record_with(r, superpoints, step, superpoint_position, pose, |layer| self.parameters.mean(layer))
    }

    fn record_with(
        &self,
        r: &mut Recorder,
        superpoints: u32,
        step: &Slice,
        superpoint_position: &Slice,
        pose: &Slice,
        weights: impl Fn(usize) -> Slice,
    ) -> Result<()> {
        if superpoints == 0 {
            return Ok(());
        }
        self.check_count(superpoints)?;
        let buffers = EncodeSuperpointsBuffers {
            step: step.clone(),
            superpoint_position: superpoint_position.clone(),
            encoding: self.activation(None, superpoints),
        };
        encode_superpoints::record(r, superpoints, buffers)?;
        (0..=self.size.layers).try_for_each(|i| {
            let mut layer = self.layer(i, superpoints, Some(pose));
            layer.parameters[0] = weights(i);
            layer.forward(r)
        })
    }

    /// Records, after the forward pass of the same step: gradients of all weights from those of the poses, given to Adam or
    /// kept for [`NetworkF::download_gradient`].
    pub fn record_backward(
        &self,
        r: &mut Recorder,
        superpoints: u32,
        output: Output,
        from: &Backward<'_>,
    ) -> Result<()> {
        if superpoints == 0 {
            return Ok(());
        }
        self.check_count(superpoints)?;
        let pass = Pass {
            network: Network::F,
            output,
            step: from.step.clone(),
            counters: from.counters.clone(),
            status: from.status.clone(),
        };
        let layers: Vec<Layer> = (0..=self.size.layers).map(|i| self.layer(i, superpoints, None)).collect();
        let push =
            GatherGradientPush { rows: superpoints, first_row: 0, plane_stride: from.plane_stride, columns: HEADS };
        pass.gather(r, push, from.superpoint_gradient, &self.activation_gradient(self.size.layers, superpoints))?;
        for pair in layers.windows(2).rev() {
            pair[1].backward_input(r, &pair[0])?;
        }
        for (i, layer) in layers.iter().enumerate().rev() {
            let start = u64::from(self.parameters.first_index(i)) * 4;
            let gradient = self.gradient.slice(start, u64::from(self.parameters.padded(i)) * 4);
            let split = Split { rows_per_slice: superpoints, first_slice: 0, slice_stride: 0, gradient };
            layer.backward_weight(r, &split)?;
        }
        if output == Output::Gradient {
            return Ok(());
        }
        let weights = (self.gradient.bytes() / 4) as u32;
        let push =
            LinearUpdatePush { weights, slices: 1, slice_stride: weights, first_index: 0, mean_rate: self.mean_rate };
        pass.update(r, push, self.gradient.whole(), self.parameters.all(), self.parameters.all_means(), None)
    }

    /// The weights.
    pub fn download(&self) -> Result<DeformNetwork> {
        Ok(network(&self.parameters.download()?, self.size))
    }

    /// The mean of the weights; the weights where none is kept.
    pub fn download_mean(&self) -> Result<DeformNetwork> {
        self.parameters.download_mean()?.map_or_else(|| self.download(), |layers| Ok(network(&layers, self.size)))
    }

    /// Whether a mean of the weights is kept.
    pub fn has_mean(&self) -> bool {
        self.parameters.all_means().is_some()
    }

    /// Replaces the mean of the weights.
    ///
    /// # Errors
    /// `Usage` for a network of another size.
    pub fn upload_mean(&self, network: &DeformNetwork) -> Result<()> {
        self.check_size(network)?;
        self.parameters.upload_mean(&layers(network)?)
    }

    /// Replaces the weights.
    ///
    /// # Errors
    /// `Usage` for a network of another size.
    pub fn upload(&self, network: &DeformNetwork) -> Result<()> {
        self.check_size(network)?;
        self.parameters.upload(&layers(network)?)
    }

    fn check_size(&self, network: &DeformNetwork) -> Result<()> {
        if network.size() != self.size {
            let say = |s: DeformSize| format!("{} layers of {}", s.layers, s.width);
            return Err(Error::usage("network F", say(network.size()), say(self.size)));
        }
        Ok(())
    }

    /// The gradients that [`Output::Gradient`] left, in the network's shape.
    pub fn download_gradient(&self) -> Result<DeformNetwork> {
        let words: Vec<f32> = bytemuck::pod_collect_to_vec(&self.gpu.download(&self.gradient)?);
        Ok(network(&self.parameters.split(&words), self.size))
    }

    /// First and second moments, each flat in the order of [`DeformNetwork::flatten`].
    pub fn download_moments(&self) -> Result<[Vec<f32>; 2]> {
        Ok(self.parameters.download_moments()?.map(|layers| network(&layers, self.size).flatten()))
    }

    /// Replaces the moments.
    pub fn upload_moments(&self, moments: [&[f32]; 2]) -> Result<()> {
        let unpack = |flat| layers(&DeformNetwork::from_flat(flat, self.size)?);
        self.parameters.upload_moments([&unpack(moments[0])?, &unpack(moments[1])?])
    }

    /// Weights, first and second moments as the device holds them, layer by layer with padding; indices as in
    /// [`NetworkF::weight_name`].
    pub fn state(&self) -> [Slice; 3] {
        self.parameters.all()
    }

    /// What a reported index of group `network F` stands for, as `deform.linear.2.weight[7, 30]`.
    pub fn weight_name(&self, index: u32) -> String {
        let Some((layer, at)) = self.parameters.locate(index) else { return format!("network F, word {index}") };
        let shape = self.parameters.shapes()[layer];
        let (inputs, weights) = (shape.inputs(), shape.inputs() * shape.outputs);
        let (output, input) = if at < weights { (at / inputs, Some(at % inputs)) } else { (at - weights, None) };
        let (name, output) = match (layer < self.size.layers, output) {
            (true, o) => (format!("deform.linear.{layer}"), o),
            (false, o @ 0..4) => ("deform.rotation".to_owned(), o),
            (false, o) => ("deform.translation".to_owned(), o - 4),
        };
        match input {
            Some(input) => format!("{name}.weight[{output}, {input}]"),
            None => format!("{name}.bias[{output}]"),
        }
    }

    fn check_count(&self, superpoints: u32) -> Result<()> {
        if superpoints > self.capacity {
            let what = "superpoints of network F".to_owned();
            return Err(Error::Limit { what, need: superpoints.into(), have: self.capacity.into() });
        }
        Ok(())
    }

    /// Layer `i`; `pose` is where the heads' output goes (only needed forward).
    fn layer(&self, i: usize, superpoints: u32, pose: Option<&Slice>) -> Layer {
        let shape = self.parameters.shapes()[i];
        let skip = self.size.skip_layer() == Some(i);
        let from = if i == 0 || skip { None } else { Some(i - 1) };
        let mut input = self.activation(from, superpoints);
        let mut input_1_at = 0;
        if skip {
            let second = self.activation(Some(i - 1), superpoints);
            input_1_at = (second.start / 4) as u32;
            input = self.activation.slice(0, second.start + second.bytes);
        }
        let output = match pose {
            Some(pose) if i == self.size.layers => pose.buffer.slice(pose.start, u64::from(superpoints * HEADS) * 4),
            _ => self.activation(Some(i.min(self.size.layers - 1)), superpoints),
        };
        Layer {
            stage: self.stage,
            shape,
            relu: i < self.size.layers,
            rows: superpoints,
            input,
            input_1_at,
            output,
            output_gradient: self.activation_gradient(i, superpoints),
            parameters: self.parameters.slices(i),
        }
    }

    /// The encoding (`None`) or the output of a hidden layer.
    fn activation(&self, layer: Option<usize>, superpoints: u32) -> Slice {
        let width = self.size.width;
        let (before, columns) = layer.map_or((0, ENCODING_WIDTH), |i| (ENCODING_WIDTH + i * width, width));
        let bytes = |rows: u32, columns: usize| u64::from(rows) * columns as u64 * 4;
        self.activation.slice(bytes(self.capacity, before), bytes(superpoints, columns))
    }

    /// Gradient before the ReLU of layer `i`.
    fn activation_gradient(&self, i: usize, superpoints: u32) -> Slice {
        let columns = if i < self.size.layers { self.size.width } else { HEADS as usize };
        let bytes = |rows: u32, columns: usize| u64::from(rows) * columns as u64 * 4;
        self.activation_gradient.slice(bytes(self.capacity, i * self.size.width), bytes(superpoints, columns))
    }
}

/// Weights and bias of each layer, the heads as one.
fn layers(network: &DeformNetwork) -> Result<Vec<Vec<f32>>> {
    network.check_shapes()?;
    let joined = |l: &Linear| [l.weight.as_slice(), &l.bias].concat();
    let mut all: Vec<Vec<f32>> = network.linear.iter().map(joined).collect();
    let heads = [&network.rotation, &network.translation];
    let mut head = Vec::new();
    let zeros = vec![0.0; network.size().width];
    heads.iter().for_each(|l| head.extend(l.weight.iter().chain(&zeros)));
    heads.iter().for_each(|l| head.extend(l.bias.iter().copied().chain([0.0])));
    all.push(head);
    Ok(all)
}

/// Inverse of [`layers`].
fn network(layers: &[Vec<f32>], size: DeformSize) -> DeformNetwork {
    let shapes = shapes(size);
    let hidden = |i: usize| {
        let (inputs, outputs) = (shapes[i].inputs() as usize, shapes[i].outputs as usize);
        let (weight, bias) = layers[i].split_at(inputs * outputs);
        Linear { inputs, outputs, weight: weight.to_vec(), bias: bias.to_vec() }
    };
    let all = hidden(size.layers);
    let head = |first: usize| Linear {
        inputs: size.width,
        outputs: 3,
        weight: all.weight[first * size.width..(first + 3) * size.width].to_vec(),
        bias: all.bias[first..first + 3].to_vec(),
    };
    DeformNetwork { linear: (0..size.layers).map(hidden).collect(), rotation: head(0), translation: head(4) }
}
