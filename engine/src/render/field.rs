//! Deformation fields on the device: each frame, the offsets of every Gaussian (`nonrigid_offset float[10][N]`, which
//! `deform_project` adds) from its centre, the time and a perceptron ([`crate::scene::field`]).
//!
//! ```text
//! field_waves | field_planes → linear_forward × layers → field_offset         (points are the Gaussians, in chunks)
//!                                                      → field_nodes          (points are control nodes)
//! ```
//!
//! A layer's activations go through memory: 2 KB per point and layer beside 130,000 operations, so the products decide. Rows of
//! matrices are filled up with zeros to whole vectors of four: a product of odd rows takes many times as long.

pub mod field_nodes;
pub mod field_offset;
pub mod field_planes;
pub mod field_waves;

use crate::error::Result;
use crate::gpu::product::Stage;
use crate::gpu::{Buffer, Gpu, Memory, Recorder, SLICE_ALIGNMENT, Slice};
use crate::reference::Offset;
use crate::scene::field::{ControlNodes, DeformationField, FieldInput, FieldRule};
use crate::scene::parameter::{LOG_SCALE, MEAN, ROTATION, transposed};
use crate::scene::{Gaussians, Linear, MotionSource, Scene};

use super::deformation::offset_buffer;
use super::frame::{Frame, FrameOptions};
use super::linear_forward::{self, ForwardPush, LinearForwardBuffers};
use super::quality::Quality;
use super::scene_buffers::SceneBuffers;

use field_nodes::{FieldNodesBuffers, FieldNodesPush};
use field_offset::{FieldOffsetBuffers, FieldOffsetPush};
use field_planes::{FieldPlanesBuffers, FieldPlanesPush, pack_planes};
use field_waves::{FieldWavesBuffers, FieldWavesPush};

/// Bytes that the activations of a chunk of points may have.
const ACTIVATION_BYTES: usize = 64 << 20;
/// Points of a chunk are a multiple of this, so that slices of the activations are aligned.
const CHUNK_STEP: usize = 64;

/// What the perceptron's input needs besides the points.
#[derive(Debug)]
enum Input {
    Waves { octaves: u32, time_network: Option<Buffer> },
    Planes { plane: Buffer, plane_size: Buffer, push: FieldPlanesPush },
}

/// Control nodes on the device.
#[derive(Debug)]
struct Nodes {
    count: u32,
    neighbors: u32,
    turn: bool,
    position: Buffer,
    neighbor: Buffer,
    weight: Buffer,
    share: Buffer,
}

/// A layer's shape and where its weights are.
#[derive(Debug)]
struct Layer {
    /// Columns taken from the input of the perceptron (a layer that sees it again), and from the layer below.
    inputs: [u32; 2],
    outputs: u32,
    relu: bool,
    parameter: Slice,
}

/// A field on the device, with the work space of a chunk.
#[derive(Debug)]
pub(crate) struct FieldBuffers {
    /// Points at a time.
    chunk: usize,
    input: Input,
    input_width: usize,
    layers: Vec<Layer>,
    rule: FieldRule,
    nodes: Option<Nodes>,
    parameter: Buffer,
    /// The input of the perceptron, then two layers' outputs, of a chunk.
    activation: Buffer,
    /// Floats of the widest layer.
    width: usize,
    /// `float[10][N]`.
    offset: Buffer,
}

impl FieldBuffers {
    /// For a field that [`DeformationField::check`] has passed.
    pub(crate) fn new(gpu: &Gpu, field: &DeformationField, gaussians: usize) -> Result<Self> {
        let points = field.nodes.as_ref().map_or(gaussians, |n| n.position.len()).max(1);
        let input_width = filled(field.input.width());
        let width = field.all_layers().map(|l| filled(l.outputs)).max().unwrap_or(1);
        let fitting = ACTIVATION_BYTES / (4 * (input_width + 2 * width)) / CHUNK_STEP * CHUNK_STEP;
        let whole = points.next_multiple_of(CHUNK_STEP);
        // Nodes are few, and what follows them needs all of them.
        let chunk = if field.nodes.is_some() { whole } else { whole.min(fitting.max(CHUNK_STEP)) };
        let (layers, parameter) = layers(gpu, field)?;
        let bytes = (chunk * (input_width + 2 * width) * 4) as u64;
        Ok(Self {
            chunk,
            input: Input::new(gpu, &field.input)?,
            input_width,
            layers,
            rule: field.rule(),
            nodes: field.nodes.as_ref().map(|n| Nodes::new(gpu, n, field.head.outputs)).transpose()?,
            parameter,
            activation: gpu.buffer("field_activation", bytes, Memory::Device)?,
            width,
            offset: offset_buffer(gpu, gaussians)?,
        })
    }

    /// Bytes of device memory.
    pub(crate) fn bytes(&self) -> u64 {
        let input = match &self.input {
            Input::Waves { time_network, .. } => time_network.as_ref().map_or(0, Buffer::bytes),
            Input::Planes { plane, plane_size, .. } => plane.bytes() + plane_size.bytes(),
        };
        let nodes = self
            .nodes
            .as_ref()
            .map_or(0, |n| [&n.position, &n.neighbor, &n.weight, &n.share].iter().map(|b| b.bytes()).sum::<u64>());
        input + nodes + self.parameter.bytes() + self.activation.bytes() + self.offset.bytes()
    }

    /// Records the offsets of all Gaussians at the frame's time.
    pub(crate) fn record(&self, gpu: &Gpu, r: &mut Recorder, scene: &SceneBuffers, frame: &Buffer) -> Result<Slice> {
        for first in self.parts(scene) {
            self.record_part(gpu, r, scene, frame, first)?;
        }
        Ok(Slice::from(&self.offset))
    }

    /// First Gaussians of the parts that are evaluated one after another.
    fn parts(&self, scene: &SceneBuffers) -> impl Iterator<Item = u32> + use<> {
        let step = if self.nodes.is_some() { scene.gaussians.max(1) as usize } else { self.chunk };
        (0..scene.gaussians).step_by(step)
    }

    /// Records the offsets of the Gaussians from `first` on, as many as a part has.
    fn record_part(&self, gpu: &Gpu, r: &mut Recorder, scene: &SceneBuffers, frame: &Buffer, first: u32) -> Result<()> {
        let (stage, frame) = (Stage::of(gpu), Slice::from(frame));
        let (gaussians, offset) = (scene.gaussians, Slice::from(&self.offset));
        let Some(nodes) = &self.nodes else {
            let rows = (gaussians - first).min(self.chunk as u32);
            self.evaluate(r, stage, &frame, &Slice::from(&scene.parameter[MEAN]), [first, rows, gaussians])?;
            let push = FieldOffsetPush { first_row: first, rows, outputs: self.outputs() };
            let buffers = FieldOffsetBuffers {
                frame,
                head_output: self.head_output(rows),
                mean: scene.parameter[MEAN].whole(),
                log_scale: scene.parameter[LOG_SCALE].whole(),
                rotation: scene.parameter[ROTATION].whole(),
                nonrigid_offset: offset,
            };
            return field_offset::record(r, self.rule, push, buffers);
        };
        self.evaluate(r, stage, &frame, &Slice::from(&nodes.position), [0, nodes.count, nodes.count])?;
        let push = FieldNodesPush { nodes: nodes.count, neighbors: nodes.neighbors, outputs: self.outputs() };
        let buffers = FieldNodesBuffers {
            frame,
            head_output: self.head_output(nodes.count),
            mean: scene.parameter[MEAN].whole(),
            rotation: scene.parameter[ROTATION].whole(),
            node_position: nodes.position.whole(),
            node_neighbor: nodes.neighbor.whole(),
            node_weight: nodes.weight.whole(),
            node_share: nodes.share.whole(),
            nonrigid_offset: offset,
        };
        field_nodes::record(r, gaussians, nodes.turn, push, buffers)
    }

    /// Records the perceptron for points `first..first + rows` of `points`.
    fn evaluate(&self, r: &mut Recorder, stage: Stage, frame: &Slice, point: &Slice, part: [u32; 3]) -> Result<()> {
        let [_, rows, _] = part;
        self.input.record(r, frame, point, part, &self.activation(0, rows, self.input_width))?;
        for (i, layer) in self.layers.iter().enumerate() {
            let [inputs_0, inputs_1] = layer.inputs;
            let below = (i > 0).then(|| self.region(i - 1));
            // A layer that sees the input again reads from it on to the end of what the layer below gave.
            let (input, input_1_at) = match (below, inputs_0) {
                (None, _) => (self.activation(0, rows, self.input_width), 0),
                (Some(region), 0) => (self.activation(region, rows, inputs_1 as usize), 0),
                (Some(region), _) => {
                    let at = self.start(region);
                    (self.activation.slice(0, ((at + rows as usize * inputs_1 as usize) * 4) as u64), at as u32)
                }
            };
            let (inputs_0, inputs_1) = if inputs_0 == 0 { (inputs_1, 0) } else { (inputs_0, inputs_1) };
            let push = ForwardPush { rows, outputs: layer.outputs, inputs_0, inputs_1, input_1_at };
            let layer_output = self.activation(self.region(i), rows, layer.outputs as usize);
            let buffers = LinearForwardBuffers { layer_input: input, parameter: layer.parameter.clone(), layer_output };
            linear_forward::record(r, stage, push, layer.relu, buffers)?;
        }
        Ok(())
    }

    fn outputs(&self) -> u32 {
        self.layers.last().map_or(0, |l| l.outputs)
    }

    fn head_output(&self, rows: u32) -> Slice {
        self.activation(self.region(self.layers.len() - 1), rows, self.outputs() as usize)
    }

    /// Where layer `i` writes: 1 or 2 in turn, such that what a layer reads together with the input (region 0) lies beside it.
    fn region(&self, i: usize) -> usize {
        let again = (1..self.layers.len()).find(|&i| self.layers[i].inputs[0] > 0);
        1 + (i + again.map_or(0, |again| again - 1)) % 2
    }

    /// First float of a region of the activations.
    fn start(&self, region: usize) -> usize {
        self.chunk * if region == 0 { 0 } else { self.input_width + (region - 1) * self.width }
    }

    fn activation(&self, region: usize, rows: u32, columns: usize) -> Slice {
        self.activation.slice(self.start(region) as u64 * 4, u64::from(rows) * columns as u64 * 4)
    }
}

/// Columns of a matrix whose rows have `count` numbers.
fn filled(count: usize) -> usize {
    count.next_multiple_of(4)
}

/// Weights and bias of a layer with whole vectors in each row, and as many rows; `seen` of its inputs are the perceptron's, the
/// others come from the layer below.
fn filled_parameter(layer: &Linear, seen: usize) -> Vec<f32> {
    let [seen_wide, below_wide] = [seen, layer.inputs - seen].map(filled);
    let (wide, outputs) = (seen_wide + below_wide, filled(layer.outputs));
    let mut words = vec![0.0; outputs * (wide + 1)];
    for (row, weight) in words.chunks_exact_mut(wide).zip(layer.weight.chunks_exact(layer.inputs)) {
        row[..seen].copy_from_slice(&weight[..seen]);
        row[seen_wide..][..layer.inputs - seen].copy_from_slice(&weight[seen..]);
    }
    words[outputs * wide..][..layer.outputs].copy_from_slice(&layer.bias);
    words
}

/// All layers, hidden ones and the head, with their weights in one buffer.
fn layers(gpu: &Gpu, field: &DeformationField) -> Result<(Vec<Layer>, Buffer)> {
    let all: Vec<&Linear> = field.all_layers().collect();
    let skip = field.skip_layer();
    let seen = |i: usize| if skip == Some(i) { field.input.width() } else { 0 };
    let mut words: Vec<f32> = Vec::new();
    let mut parts = Vec::with_capacity(all.len());
    for (i, layer) in all.iter().enumerate() {
        words.resize(words.len().next_multiple_of(SLICE_ALIGNMENT as usize / 4), 0.0);
        let parameter = filled_parameter(layer, seen(i));
        parts.push([words.len(), parameter.len()].map(|floats| floats as u64 * 4));
        words.extend(parameter);
    }
    let parameter = gpu.buffer_with("field_parameter", bytemuck::cast_slice(&words))?;
    let of = |(i, layer): (usize, &&Linear)| Layer {
        inputs: [seen(i), layer.inputs - seen(i)].map(|inputs| filled(inputs) as u32),
        outputs: filled(layer.outputs) as u32,
        relu: i + 1 < all.len(),
        parameter: parameter.slice(parts[i][0], parts[i][1]),
    };
    Ok((all.iter().enumerate().map(of).collect(), parameter.clone()))
}

impl Input {
    fn new(gpu: &Gpu, input: &FieldInput) -> Result<Self> {
        match input {
            FieldInput::Waves { octaves, time } => {
                let words = |network: &[Linear; 2]| -> Vec<f32> {
                    network.iter().flat_map(|l| l.weight.iter().chain(&l.bias).copied()).collect()
                };
                let upload = |network| gpu.buffer_with("field_time_network", bytemuck::cast_slice(&words(network)));
                Ok(Self::Waves { octaves: *octaves as u32, time_network: time.as_ref().map(upload).transpose()? })
            }
            FieldInput::Planes(planes) => {
                let (values, sizes) = pack_planes(planes);
                Ok(Self::Planes {
                    plane: gpu.buffer_with("field_plane", bytemuck::cast_slice(&values))?,
                    plane_size: gpu.buffer_with("field_plane_size", bytemuck::cast_slice(&sizes))?,
                    push: FieldPlanesPush::of(planes),
                })
            }
        }
    }

    /// Records what the perceptron sees of points `first..first + rows` of `points`.
    fn record(
        &self,
        r: &mut Recorder,
        frame: &Slice,
        point: &Slice,
        [first_row, rows, points]: [u32; 3],
        encoding: &Slice,
    ) -> Result<()> {
        match self {
            Self::Waves { octaves, time_network } => {
                let push = FieldWavesPush { first_row, rows, points };
                let buffers = FieldWavesBuffers {
                    frame: frame.clone(),
                    point: point.clone(),
                    parameter: time_network.as_ref().map(Buffer::whole),
                    encoding: encoding.clone(),
                };
                field_waves::record(r, *octaves, push, buffers)
            }
            Self::Planes { plane, plane_size, push } => {
                let push = FieldPlanesPush { first_row, rows, points, ..*push };
                let buffers = FieldPlanesBuffers {
                    frame: frame.clone(),
                    point: point.clone(),
                    plane: plane.whole(),
                    plane_size: plane_size.whole(),
                    encoding: encoding.clone(),
                };
                field_planes::record(r, push, buffers)
            }
        }
    }
}

impl Nodes {
    fn new(gpu: &Gpu, nodes: &ControlNodes, outputs: usize) -> Result<Self> {
        let upload = |name: &str, bytes: &[u8]| gpu.buffer_with(name, bytes);
        Ok(Self {
            count: nodes.position.len() as u32,
            neighbors: nodes.neighbors as u32,
            turn: ControlNodes::turn(outputs),
            position: upload("node_position", bytemuck::cast_slice(&transposed(nodes.position.as_flattened(), 3)))?,
            neighbor: upload("node_neighbor", bytemuck::cast_slice(&nodes.neighbor))?,
            weight: upload("node_weight", bytemuck::cast_slice(&nodes.weight))?,
            share: upload("node_share", bytemuck::cast_slice(&nodes.share))?,
        })
    }
}

/// Evaluates a scene's field on a device at any times, away from rendering: for tables and files of one time.
#[derive(Debug)]
pub struct FieldEvaluator {
    gpu: Gpu,
    scene: SceneBuffers,
    field: FieldBuffers,
    frame: Buffer,
    readback: Buffer,
}

impl FieldEvaluator {
    /// For a scene with a field.
    ///
    /// # Errors
    /// `Usage` when the scene has none or it does not fit together; `OutOfMemory`, `Limit`.
    pub fn new(gpu: &Gpu, scene: &Scene) -> Result<Self> {
        let Some(field) = scene.deformation.field() else {
            return Err(crate::Error::usage("deformation field", "a scene without one", "a scene with one"));
        };
        // Colours play no part: one band of them is the least there is.
        let plain = Gaussians { sh_degree: 0, sh: vec![0.0; 3 * scene.gaussians.len()], ..scene.gaussians.clone() };
        let plain = Scene { gaussians: plain, ..Scene::default() };
        let buffers = SceneBuffers::new(gpu, &plain, MotionSource::Auto, &Quality::EXACT)?;
        field.check(scene.gaussians.len())?;
        let field = FieldBuffers::new(gpu, field, scene.gaussians.len())?;
        let readback = gpu.buffer("offset readback", field.offset.bytes(), Memory::Readback)?;
        let frame = gpu.buffer("frame", size_of::<Frame>() as u64, Memory::Constants)?;
        Ok(Self { gpu: gpu.clone(), scene: buffers, field, frame, readback })
    }

    /// `[N]` offsets at `time`, f32 values. Blocks.
    ///
    /// # Errors
    /// `DeviceLost`, `Vulkan`.
    pub fn offsets(&self, time: f64) -> Result<Vec<Offset>> {
        let camera = crate::scene::Camera::look_at(glam::DVec3::Z, glam::DVec3::ZERO, glam::DVec3::Y, 1.0, [16, 16]);
        let frame = self.scene.frame(&camera, FrameOptions { time, ..FrameOptions::default() })?;
        self.frame.write(0, bytemuck::bytes_of(&frame))?;
        // Part by part: a submission then stays far from the time-out, however slow the device.
        for first in self.field.parts(&self.scene) {
            let mut r = self.gpu.recorder("deformation field");
            self.field.record_part(&self.gpu, &mut r, &self.scene, &self.frame, first)?;
            self.gpu.run(r)?;
        }
        let mut r = self.gpu.recorder("deformation field");
        r.copy(&self.field.offset, self.readback.slice(0, self.readback.bytes()))?;
        r.host_read(&self.readback);
        self.gpu.run(r)?;
        let n = self.scene.gaussians as usize;
        let mut planes = vec![0.0_f32; self.readback.bytes() as usize / 4];
        self.readback.read(0, bytemuck::cast_slice_mut(&mut planes))?;
        let at = |plane: usize, g: usize| f64::from(planes[plane * n + g]);
        let one = |g: usize| Offset {
            mean: std::array::from_fn(|i| at(i, g)),
            rotation: std::array::from_fn(|i| at(3 + i, g)),
            scale: std::array::from_fn(|i| at(7 + i, g)),
        };
        Ok((0..n).map(one).collect())
    }
}
