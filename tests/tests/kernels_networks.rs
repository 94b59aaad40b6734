//! Networks F and G in training on the device: kernels against their twins, passes against the f64 reference.

use engine::gpu::{Buffer, Gpu, Memory, Slice};
use engine::render::limits::COUNT_FAILED;
use engine::scene::DeformNetwork;
use engine::train::linear::{
    self, ForwardPush, GATHER_GRADIENT, GatherPush, InputPush, LINEAR_BACKWARD_INPUT, LINEAR_BACKWARD_WEIGHT,
    LINEAR_FORWARD, LINEAR_UPDATE, Output, Stage, UpdatePush, WeightPush,
};
use engine::train::network_f::{Backward, ENCODE_SUPERPOINTS, EncodePush, NetworkF};
use engine::train::status;
use engine::train::step::{Step, bias_corrections};
use tests_harness::KernelCase;
use tests_harness::render_case::Random;

const STAGES: [Stage; 2] = [Stage::Shuffle, Stage::Shared];

fn floats(r: &mut Random, count: usize, bound: f32) -> Vec<u32> {
    (0..count).map(|_| r.range(-bound, bound).to_bits()).collect()
}

fn step() -> Step {
    let [m, v] = bias_corrections(0.9, 0.999, 5);
    Step {
        rate_1: [0.0, 0.0, 1e-2, 0.0],
        rate_2: [2e-2, 0.0, 0.0, 0.0],
        adam: [0.9, 0.999, 1e-15, 0.0],
        bias_0: [0.0, 0.0, m, v],
        bias_1: [0.0, 0.0, m, v],
        time: [0.37, 0.37, 0.0, 0.0],
        ..Step::default()
    }
}

fn step_words() -> Vec<u32> {
    bytemuck::cast_slice(&[step()]).to_vec()
}

#[test]
fn forward_and_backward_input_match_their_twins() {
    let gpu = tests_harness::gpu();
    let mut r = Random(1);
    for (rows, i0, i1, outputs) in [(1, 1, 0, 1), (16, 32, 0, 32), (33, 76, 256, 65), (7, 84, 0, 12), (130, 64, 0, 257)]
    {
        for stage in STAGES {
            let inputs = i0 + i1;
            let bound = 1.0 / (inputs as f32).sqrt();
            let parameter = floats(&mut r, (outputs * (inputs + 1)) as usize, bound);
            let input_1_at = rows * i0 + 5;
            let input = floats(&mut r, (input_1_at + rows * i1) as usize, 1.0);
            for relu in [0, 1] {
                let push = ForwardPush { rows, outputs, inputs_0: i0, inputs_1: i1, input_1_at };
                let case = KernelCase {
                    kernel: &LINEAR_FORWARD,
                    spec: vec![stage as u32, relu],
                    push: bytemuck::bytes_of(&push).to_vec(),
                    buffers: vec![input.clone(), parameter.clone(), vec![0; (rows * outputs) as usize]],
                    groups: linear::product_groups(stage, gpu.subgroup_size(), rows, outputs, 1) as u32,
                };
                case.run(&gpu).assert_equal(&LINEAR_FORWARD, &format!("{rows} x {inputs} -> {outputs}, {stage:?}"));
            }
            let (first_input, columns) = if i1 > 0 { (i0, i1) } else { (0, i0) };
            let push = InputPush { rows, outputs, inputs: columns, weight_stride: inputs, first_input };
            let case = KernelCase {
                kernel: &LINEAR_BACKWARD_INPUT,
                spec: vec![stage as u32],
                push: bytemuck::bytes_of(&push).to_vec(),
                buffers: vec![
                    floats(&mut r, (rows * outputs) as usize, 1.0),
                    parameter,
                    floats(&mut r, (rows * columns) as usize, 1.0),
                    vec![0; (rows * columns) as usize],
                ],
                groups: linear::product_groups(stage, gpu.subgroup_size(), rows, columns, 1) as u32,
            };
            case.run(&gpu).assert_equal(&LINEAR_BACKWARD_INPUT, &format!("{rows} x {outputs} -> {columns}, {stage:?}"));
        }
    }
}

struct WeightCase {
    rows: u32,
    inputs: [u32; 2],
    outputs: u32,
    rows_per_slice: u32,
    output: Output,
    network: u32,
}

impl WeightCase {
    fn run(&self, gpu: &Gpu, stage: Stage, failed: u32) -> tests_harness::KernelResult {
        let mut r = Random(u64::from(self.rows));
        let [i0, i1] = self.inputs;
        let weights = self.outputs * (i0 + i1 + 1);
        let slices = self.rows.div_ceil(self.rows_per_slice);
        let input_1_at = self.rows * i0 + 3;
        let push = WeightPush {
            rows: self.rows,
            outputs: self.outputs,
            inputs_0: i0,
            inputs_1: i1,
            input_1_at,
            rows_per_slice: self.rows_per_slice,
            first_slice: 1,
            slice_stride: weights,
            first_index: 64,
        };
        let mut counters = vec![0; 8];
        counters[COUNT_FAILED as usize] = failed;
        let squares = floats(&mut r, weights as usize, 1.0).into_iter().map(|w| f32::from_bits(w).powi(2) + 0.5);
        let case = KernelCase {
            kernel: &LINEAR_BACKWARD_WEIGHT,
            spec: vec![stage as u32, self.output as u32, self.network],
            push: bytemuck::bytes_of(&push).to_vec(),
            buffers: vec![
                step_words(),
                counters,
                floats(&mut r, (self.rows * self.outputs) as usize, 1.0),
                floats(&mut r, (input_1_at + self.rows * i1) as usize, 1.0),
                floats(&mut r, weights as usize, 1.0),
                floats(&mut r, weights as usize, 1.0),
                squares.map(f32::to_bits).collect(),
                vec![0; ((slices + 1) * weights) as usize],
                status::clear().to_vec(),
            ],
            groups: linear::product_groups(stage, gpu.subgroup_size(), self.outputs, i0 + i1, slices) as u32,
        };
        case.run(gpu)
    }
}

#[test]
fn weight_gradients_match_their_twins() {
    let gpu = tests_harness::gpu();
    for stage in STAGES {
        for (rows, inputs, outputs, rows_per_slice) in
            [(1, [1, 0], 1, 1), (100, [76, 256], 33, 100), (300, [64, 0], 64, 70), (65, [84, 0], 12, 64)]
        {
            for (output, network) in [(Output::Gradient, 0), (Output::Adam, 0), (Output::Adam, 1)] {
                let rows_per_slice = if output == Output::Adam { rows } else { rows_per_slice };
                let case = WeightCase { rows, inputs, outputs, rows_per_slice, output, network };
                let context = format!("{rows} rows, {inputs:?} -> {outputs}, {output:?}, {stage:?}");
                let result = case.run(&gpu, stage, 0);
                result.assert_equal(&LINEAR_BACKWARD_WEIGHT, &context);
                let failed = case.run(&gpu, stage, 1);
                failed.assert_equal(&LINEAR_BACKWARD_WEIGHT, &context);
                let changed = (4..9).any(|b| failed.gpu[b] != result.gpu[b]);
                assert!(changed, "{context}: a failed frame must change nothing, another something");
            }
        }
    }
}

#[test]
fn update_and_gather_match_their_twins() {
    let gpu = tests_harness::gpu();
    let mut r = Random(9);
    for (weights, slices) in [(1_u32, 1_u32), (300, 7), (1025, 64)] {
        for (output, network) in [(Output::Gradient, 0), (Output::Adam, 0), (Output::Adam, 1)] {
            let push = UpdatePush { weights, slices, slice_stride: weights + 7, first_index: 128 };
            let mut gradient = floats(&mut r, (slices * (weights + 7)) as usize, 0.1);
            gradient[0] = f32::NAN.to_bits();
            let case = KernelCase {
                kernel: &LINEAR_UPDATE,
                spec: vec![output as u32, network],
                push: bytemuck::bytes_of(&push).to_vec(),
                buffers: vec![
                    step_words(),
                    vec![0; 8],
                    gradient,
                    floats(&mut r, weights as usize, 1.0),
                    floats(&mut r, weights as usize, 1.0),
                    (0..weights).map(|_| r.range(0.5, 1.0).to_bits()).collect(),
                    vec![0; weights as usize],
                    status::clear().to_vec(),
                ],
                groups: weights.div_ceil(256),
            };
            let result = case.run(&gpu);
            result.assert_equal(&LINEAR_UPDATE, &format!("{weights} weights, {slices} slices, {output:?}"));
            if output == Output::Adam {
                let name = ["network F", "network G"][network as usize];
                assert_eq!(status::first(&result.gpu[7]), Some((name, 1, 128)));
                assert!(result.gpu[3].iter().all(|w| f32::from_bits(*w).is_finite()));
            }
        }
    }
    for (network, planes, columns) in [(0, 6, 8), (1, 10, 12)] {
        let mut plane = floats(&mut r, planes * 100, 1.0);
        plane[30] = f32::INFINITY.to_bits();
        let case = KernelCase {
            kernel: &GATHER_GRADIENT,
            spec: vec![network],
            push: bytemuck::bytes_of(&GatherPush { rows: 70, first_row: 20, plane_stride: 100 }).to_vec(),
            buffers: vec![plane, vec![0; 70 * columns], status::clear().to_vec()],
            groups: (70 * columns as u32).div_ceil(256),
        };
        let result = case.run(&gpu);
        result.assert_equal(&GATHER_GRADIENT, &format!("network {network}"));
        assert_eq!(status::first(&result.gpu[2]), Some((["pose", "network G"][network as usize], 1, 30)));
        assert!(result.gpu[1].iter().all(|w| f32::from_bits(*w).is_finite()));
    }
}

#[test]
fn encoding_matches_its_twin() {
    let gpu = tests_harness::gpu();
    let mut r = Random(4);
    for rows in [1_u32, 20, 300] {
        let case = KernelCase {
            kernel: &ENCODE_SUPERPOINTS,
            spec: Vec::new(),
            push: bytemuck::bytes_of(&EncodePush { rows }).to_vec(),
            buffers: vec![step_words(), floats(&mut r, 3 * rows as usize, 8.0), vec![0; 76 * rows as usize]],
            groups: (76 * rows).div_ceil(256),
        };
        case.run(&gpu).assert_equal(&ENCODE_SUPERPOINTS, &format!("{rows} rows"));
    }
}

/// The buffers that a pass of network F needs.
struct Setup {
    step: Buffer,
    counters: Buffer,
    status: Buffer,
    position: Buffer,
    gradient: Buffer,
    pose: Buffer,
    count: u32,
}

impl Setup {
    fn new(gpu: &Gpu, step: &Step, position: &[[f32; 3]], gradient: &[f32]) -> Self {
        let buffer = |name: &str, bytes: &[u8]| gpu.buffer_with(name, bytes).unwrap();
        Self {
            step: buffer("step", bytemuck::bytes_of(step)),
            counters: buffer("counters", &[0; 32]),
            status: buffer("status", bytemuck::cast_slice(&status::clear())),
            position: buffer("superpoint_position", bytemuck::cast_slice(position)),
            gradient: buffer("superpoint_gradient", bytemuck::cast_slice(gradient)),
            pose: gpu.buffer("pose", 32 * position.len() as u64, Memory::Device).unwrap(),
            count: position.len() as u32,
        }
    }

    fn run(&self, gpu: &Gpu, network: &NetworkF, output: Output) -> Vec<engine::gpu::Timing> {
        let slice = |b: &Buffer| Slice::from(b);
        let mut r = gpu.recorder("network F").with_timestamps(true);
        network
            .record_forward(&mut r, self.count, &slice(&self.step), &slice(&self.position), &slice(&self.pose))
            .unwrap();
        let from = Backward {
            step: &slice(&self.step),
            counters: &slice(&self.counters),
            status: &slice(&self.status),
            superpoint_gradient: &slice(&self.gradient),
            plane_stride: self.count,
        };
        network.record_backward(&mut r, self.count, output, &from).unwrap();
        gpu.run(r).unwrap().timings().unwrap()
    }

    fn floats(gpu: &Gpu, buffer: &Buffer) -> Vec<f32> {
        bytemuck::pod_collect_to_vec(&gpu.download(buffer).unwrap())
    }
}

fn positions(r: &mut Random, count: usize) -> Vec<[f32; 3]> {
    (0..count).map(|_| std::array::from_fn(|_| r.range(-1.3, 1.3))).collect()
}

fn upstream(r: &mut Random, count: usize) -> Vec<f32> {
    (0..6 * count).map(|_| r.range(-1.0, 1.0)).collect()
}

#[test]
fn time_of_network_f() {
    let gpu = tests_harness::gpu();
    let mut r = Random(5);
    let weights = DeformNetwork::init(1, false);
    for count in [100, 300] {
        let setup = Setup::new(&gpu, &step(), &positions(&mut r, count), &upstream(&mut r, count));
        for stage in STAGES {
            let network = NetworkF::new(&gpu, &weights, 300).unwrap().with_stage(stage);
            setup.run(&gpu, &network, Output::Adam);
            let timings = setup.run(&gpu, &network, Output::Adam);
            let mut total = std::collections::BTreeMap::new();
            for t in &timings {
                *total.entry(t.label.clone()).or_insert(0.0) += t.us / 1e3;
            }
            println!("M = {count}, {stage:?}: {:.1} ms {total:.1?}", timings.iter().map(|t| t.us).sum::<f64>() / 1e3);
        }
    }
}
