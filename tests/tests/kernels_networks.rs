//! The kernels of networks F and G in training against their twins.

use engine::render::frame::Frame;
use engine::render::linear_forward::*;
use engine::render::nonrigid_network::{self, *};
use engine::scene::NonrigidNetwork;
use engine::train::linear::gather_gradient::*;
use engine::train::linear::linear_backward_input::*;
use engine::train::linear::linear_backward_weight::*;
use engine::train::linear::linear_update::*;
use engine::train::linear::{self, LinearConstants, Output, Stage};
use engine::train::lost::add_path::*;
use engine::train::network_f::encode_superpoints::*;
use engine::train::network_g::encode_gaussians::*;
use engine::train::status;
use engine::train::step::{Step, bias_corrections};
use tests_harness::render_case::{Random, RenderInput, test_camera};
use tests_harness::{KernelCase, TestGpu};

const STAGES: [Stage; 2] = [Stage::Shuffle, Stage::Shared];

/// Stages of shape `k`: compiling takes most of the time, so in small each shape has one.
fn stages(k: usize) -> impl Iterator<Item = Stage> {
    let all = STAGES.into_iter().enumerate();
    all.filter(move |(i, _)| !tests_harness::small() || i % 2 == k % 2).map(|(_, stage)| stage)
}

fn floats(r: &mut Random, count: usize, bound: f32) -> Vec<u32> {
    (0..count).map(|_| r.range(-bound, bound).to_bits()).collect()
}

fn step() -> Step {
    let bias = bias_corrections(0.9, 0.999, 5);
    Step {
        rate_network_f: 1e-2,
        rate_network_g: 2e-2,
        bias_network_f: bias,
        bias_network_g: bias,
        time: 0.37,
        exact_time: 0.37,
        ..Step::with_usual_adam()
    }
}

fn step_words() -> Vec<u32> {
    bytemuck::cast_slice(&[step()]).to_vec()
}

/// A place after the first input that lets shapes of multiples of four be loaded by fours, and others not.
fn second_input_at(rows: u32, i0: u32, outputs: u32) -> u32 {
    (rows * i0).next_multiple_of(4) + if outputs.is_multiple_of(4) { 4 } else { 5 }
}

fn forward_case(
    gpu: &TestGpu,
    (stage, relu): (Stage, u32),
    push: ForwardPush,
    layer_input: Vec<u32>,
    parameter: Vec<u32>,
) -> KernelCase<LinearForward> {
    let kernel = &LINEAR_FORWARD;
    let (stage, vectors) = push.stage(stage);
    let lanes = gpu.subgroup_size_of(kernel);
    let constants = LinearForwardConstants::new((stage, vectors), relu == 1, lanes);
    let layer_output = vec![0; (push.rows * push.outputs) as usize];
    let buffers = LinearForwardBuffers { layer_input, parameter, layer_output };
    let groups = linear::product_groups(stage, lanes, push.rows, push.outputs, 1) as u32;
    KernelCase { kernel, constants, push, buffers, groups }
}

#[test]
fn a_layer_does_not_hide_what_is_no_number() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(21);
    let (rows, inputs, outputs) = (37, 40, 72_u32);
    for (stage, relu) in stages(1).flat_map(|s| [(s, 0), (s, 1)]) {
        for nan in [f32::NAN, -f32::NAN] {
            let mut parameter = floats(&mut r, (outputs * (inputs + 1)) as usize, 0.2);
            // A weight of output 5, the bias of output 69, and an input of row 30.
            parameter[(5 * inputs + 7) as usize] = nan.to_bits();
            parameter[(outputs * inputs + 69) as usize] = nan.to_bits();
            let mut input = floats(&mut r, (rows * inputs) as usize, 1.0);
            input[(30 * inputs) as usize] = nan.to_bits();
            let push = ForwardPush { rows, outputs, inputs_0: inputs, inputs_1: 0, input_1_at: 0 };
            let result = forward_case(&gpu, (stage, relu), push, input, parameter).run(&gpu);
            for (side, words) in [("device", &result.gpu.layer_output), ("twin", &result.twin.layer_output)] {
                for (at, word) in words.iter().enumerate() {
                    let (row, o) = (at as u32 / outputs, at as u32 % outputs);
                    let expected = row == 30 || o == 5 || o == 69;
                    let found = f32::from_bits(*word).is_nan();
                    assert_eq!(found, expected, "{side}, {stage:?}, ReLU {relu}, {nan}, row {row}, output {o}");
                }
            }
        }
    }
}

#[test]
fn forward_and_backward_input_match_their_twins() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(1);
    let shapes = [
        (1, 1, 0, 1),
        (16, 32, 0, 32),
        (33, 76, 256, 65),
        (33, 76, 64, 36),
        (7, 84, 0, 12),
        (130, 64, 0, 257),
        (70, 64, 0, 68),
    ];
    for (k, (rows, i0, i1, outputs)) in shapes.into_iter().enumerate() {
        for stage in stages(k) {
            let inputs = i0 + i1;
            let bound = 1.0 / (inputs as f32).sqrt();
            let parameter = floats(&mut r, (outputs * (inputs + 1)) as usize, bound);
            let input_1_at = second_input_at(rows, i0, outputs);
            let input = floats(&mut r, (input_1_at + rows * i1) as usize, 1.0);
            // Each is compiled, and that takes most of the time.
            let relus = if tests_harness::small() { vec![outputs % 2] } else { vec![0, 1] };
            for relu in relus {
                let push = ForwardPush { rows, outputs, inputs_0: i0, inputs_1: i1, input_1_at };
                let case = forward_case(&gpu, (stage, relu), push, input.clone(), parameter.clone());
                case.check(&gpu, &format!("{rows} x {inputs} -> {outputs}, {stage:?}"));
            }
            let (first_input, columns) = if i1 > 0 { (i0, i1) } else { (0, i0) };
            let kernel = &LINEAR_BACKWARD_INPUT;
            let push = LinearBackwardInputPush { rows, outputs, inputs: columns, weight_stride: inputs, first_input };
            let buffers = LinearBackwardInputBuffers {
                output_gradient: floats(&mut r, (rows * outputs) as usize, 1.0),
                parameter,
                layer_input: floats(&mut r, (rows * columns) as usize, 1.0),
                input_gradient: vec![0; (rows * columns) as usize],
            };
            let stage = push.stage(stage);
            let lanes = gpu.subgroup_size_of(kernel);
            let groups = linear::product_groups(stage.0, lanes, rows, columns, 1) as u32;
            let case = KernelCase { kernel, constants: LinearConstants::new(stage, lanes), push, buffers, groups };
            case.check(&gpu, &format!("{rows} x {outputs} -> {columns}, {stage:?}"));
        }
    }
}

#[test]
fn weight_gradients_match_their_twins() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(7);
    let shapes =
        [(1_u32, [1_u32, 0_u32], 1_u32, 1), (100, [76, 256], 33, 100), (300, [64, 20], 64, 70), (65, [84, 0], 12, 64)];
    for (k, (rows, [i0, i1], outputs, rows_per_slice)) in shapes.into_iter().enumerate() {
        for stage in stages(k) {
            let weights = outputs * (i0 + i1 + 1);
            let slices = rows.div_ceil(rows_per_slice);
            let input_1_at = second_input_at(rows, i0, outputs);
            let push = LinearBackwardWeightPush {
                rows,
                outputs,
                inputs_0: i0,
                inputs_1: i1,
                input_1_at,
                rows_per_slice,
                first_slice: 1,
                slice_stride: weights,
            };
            let kernel = &LINEAR_BACKWARD_WEIGHT;
            let buffers = LinearBackwardWeightBuffers {
                output_gradient: floats(&mut r, (rows * outputs) as usize, 1.0),
                layer_input: floats(&mut r, (input_1_at + rows * i1) as usize, 1.0),
                gradient: vec![0; ((slices + 1) * weights) as usize],
            };
            let stage = push.stage(stage);
            let lanes = gpu.subgroup_size_of(kernel);
            let groups = linear::product_groups(stage.0, lanes, outputs, i0 + i1, slices) as u32;
            let case = KernelCase { kernel, constants: LinearConstants::new(stage, lanes), push, buffers, groups };
            case.check(&gpu, &format!("{rows} rows, {} -> {outputs}, {stage:?}", i0 + i1));
        }
    }
}

#[test]
fn update_and_gather_match_their_twins() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(9);
    for (weights, slices) in [(1_u32, 1_u32), (300, 7), (1025, 64)] {
        for (output, network, mean) in
            [(Output::Gradient, 0, 0), (Output::Adam, 0, 0), (Output::Adam, 0, 1), (Output::Adam, 1, 0)]
        {
            let padded = weights.next_multiple_of(4);
            let push = LinearUpdatePush { weights, slices, slice_stride: padded + 4, first_index: 128, mean_rate: 0.3 };
            let mut gradient = floats(&mut r, (slices * (padded + 4)) as usize, 0.1);
            // What overflows only when squared is not finite in the second moment alone.
            gradient[0] = if weights == 300 { 1e25 } else { f32::NAN }.to_bits();
            let buffers = LinearUpdateBuffers {
                step: step_words(),
                counters: vec![0; 8],
                slice_gradient: gradient,
                parameter: floats(&mut r, padded as usize, 1.0),
                moment_1: floats(&mut r, padded as usize, 1.0),
                moment_2: (0..padded).map(|_| r.range(0.5, 1.0).to_bits()).collect(),
                // Given to Adam too: it must not write there.
                gradient: Some(vec![0; padded as usize]),
                // Likewise where no mean is kept.
                mean: Some(floats(&mut r, padded as usize, 1.0)),
                status: status::clear().to_vec(),
            };
            let constants = LinearUpdateConstants { output: output as u32, network, mean };
            let groups = weights.div_ceil(1024);
            let case = KernelCase { kernel: &LINEAR_UPDATE, constants, push, buffers, groups };
            let done = case.check(&gpu, &format!("{weights} weights, {slices} slices, {output:?}, mean {mean}"));
            if output == Output::Adam {
                let name = ["network F", "network G"][network as usize];
                assert_eq!(status::first(&done.status), Some((name, 1, 128)));
                assert!(done.parameter.iter().all(|w| f32::from_bits(*w).is_finite()));
            }
        }
    }
    for (network, planes, columns, used) in [(0, 6, 8, 8), (1, 10, 12, 10), (1, 10, 12, 7)] {
        let mut plane = floats(&mut r, planes * 100, 1.0);
        plane[30] = f32::INFINITY.to_bits();
        let buffers =
            GatherGradientBuffers { plane, row_gradient: vec![0; 70 * columns], status: status::clear().to_vec() };
        let push = GatherGradientPush { rows: 70, first_row: 20, plane_stride: 100, columns: used };
        let (constants, groups) = (GatherGradientConstants { network }, (70 * columns as u32).div_ceil(256));
        let case = KernelCase { kernel: &GATHER_GRADIENT, constants, push, buffers, groups };
        let done = case.check(&gpu, &format!("network {network}"));
        assert_eq!(status::first(&done.status), Some((["pose", "network G"][network as usize], 1, 30)));
        assert!(done.row_gradient.iter().all(|w| f32::from_bits(*w).is_finite()));
    }
}

#[test]
fn encoding_matches_its_twin() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(4);
    for rows in [1_u32, 20, 300] {
        let buffers = EncodeSuperpointsBuffers {
            step: step_words(),
            superpoint_position: floats(&mut r, 3 * rows as usize, 8.0),
            encoding: vec![0; 76 * rows as usize],
        };
        let (push, groups) = (EncodeSuperpointsPush { rows }, (76 * rows).div_ceil(256));
        let case = KernelCase { kernel: &ENCODE_SUPERPOINTS, constants: (), push, buffers, groups };
        case.check(&gpu, &format!("{rows} rows"));
    }
}

#[test]
fn a_path_is_added_as_its_twin_does() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(6);
    // Before, between, at and after the path's times; one time alone; more superpoints than a workgroup has threads.
    for (superpoints, times) in
        [(1_u32, vec![0.9_f32]), (20, vec![0.4, 0.6]), (300, vec![0.0, 0.1, 0.37, 1.0]), (7, vec![0.1, 0.2, 0.3])]
    {
        let follows: Vec<u32> = (0..superpoints).map(|m| m % 3).collect();
        let buffers = AddPathBuffers {
            step: step_words(),
            path_time: times.iter().map(|t| t.to_bits()).collect(),
            path_offset: floats(&mut r, 3 * times.len(), 2.0),
            follows: follows.clone(),
            pose: floats(&mut r, 8 * superpoints as usize, 1.0),
        };
        let before = buffers.pose.clone();
        let push = AddPathPush { superpoints, times: times.len() as u32 };
        let case = KernelCase { kernel: &ADD_PATH, constants: (), push, buffers, groups: superpoints.div_ceil(256) };
        let done = case.check(&gpu, &format!("{superpoints} superpoints, {} times", times.len()));
        for (m, (old, new)) in before.chunks(8).zip(done.pose.chunks(8)).enumerate() {
            assert_eq!(old == new, follows[m] == 0, "superpoint {m}");
        }
    }
}

/// Gaussians that move, some of them spoilt, and a frame at time 0.42.
fn moving_input(count: usize) -> (RenderInput, Frame) {
    let mut input = RenderInput::random(count, 0, count as u64).moving(7, 3);
    input.spoil(2);
    let mut frame = input.frame(&test_camera(8, 8));
    frame.time = 0.42;
    (input, frame)
}

/// Network G with heads that matter and little weight on the high octaves, which would magnify the last bit of a centre.
fn nonrigid() -> NonrigidNetwork {
    let mut network = NonrigidNetwork::init(6);
    let mut r = Random(6);
    for head in [&mut network.translation, &mut network.rotation, &mut network.scaling] {
        head.weight.iter_mut().chain(&mut head.bias).for_each(|w| *w = r.range(-0.1, 0.1));
    }
    let damp = |(i, w): (usize, &mut f32)| *w *= 0.5_f32.powi((i % 84 % 63) as i32 / 6);
    network.linear[0].weight.iter_mut().enumerate().for_each(damp);
    network
}

#[test]
fn network_g_matches_its_twin() {
    let gpu = tests_harness::shared_gpu();
    let parameter: Vec<u32> =
        nonrigid_network::pack_parameters(&nonrigid()).unwrap().iter().map(|v| v.to_bits()).collect();
    for count in [1, 63, 64, 65, 500] {
        let (input, frame) = moving_input(count);
        for (motion, soft) in [(0, 0), (1, 0), (1, 3)] {
            let input = if soft > 0 { input.clone().soft(soft, 5) } else { input.clone() };
            let mut stages = vec![1];
            if gpu.subgroup_size_of(&NONRIGID_NETWORK) <= 16 {
                stages.push(0);
            }
            for stage in stages {
                let words = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
                let [blend_index, blend_weight] = input.blend_words();
                let buffers = NonrigidNetworkBuffers {
                    frame: bytemuck::cast_slice(&[frame]).to_vec(),
                    mean: words(&input.mean),
                    superpoint_of_gaussian: input.hard_superpoints().filter(|_| motion == 1),
                    pose: (motion == 1).then(|| words(&input.pose)),
                    parameter: parameter.clone(),
                    nonrigid_offset: vec![0; 10 * count],
                    blend_index,
                    blend_weight,
                };
                let push = NonrigidPush { origin_x: 0.5, origin_y: -0.25, origin_z: 0.0 };
                let blend = soft as u32;
                let (constants, groups) =
                    (NonrigidNetworkConstants { motion, stage, blend }, count.div_ceil(64) as u32);
                let case = KernelCase { kernel: &NONRIGID_NETWORK, constants, push, buffers, groups };
                let done = case.check(&gpu, &format!("N = {count}, motion {motion}, K = {soft}, stage {stage}"));
                assert!(done.nonrigid_offset.iter().all(|w| f32::from_bits(*w).is_finite()));
            }
        }
    }
}

#[test]
fn encoding_of_gaussians_matches_its_twin() {
    let gpu = tests_harness::shared_gpu();
    let (input, frame) = moving_input(300);
    for (first_row, rows) in [(0, 300_u32), (64, 100), (299, 1)] {
        for (motion, soft) in [(0, 0), (1, 0), (1, 2)] {
            let input = if soft > 0 { input.clone().soft(soft, 5) } else { input.clone() };
            let words = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
            let [blend_index, blend_weight] = input.blend_words();
            let buffers = EncodeGaussiansBuffers {
                frame: bytemuck::cast_slice(&[frame]).to_vec(),
                mean: words(&input.mean),
                superpoint_of_gaussian: input.hard_superpoints().filter(|_| motion == 1),
                pose: (motion == 1).then(|| words(&input.pose)),
                encoding: vec![0; 84 * rows as usize],
                blend_index,
                blend_weight,
            };
            let (constants, push) =
                (EncodeGaussiansConstants { motion, blend: soft as u32 }, EncodeGaussiansPush { first_row, rows });
            let case = KernelCase { kernel: &ENCODE_GAUSSIANS, constants, push, buffers, groups: rows.div_ceil(64) };
            let context = format!("{rows} rows, motion {motion}, K = {soft}");
            let done = case.run(&gpu);
            done.assert_equal(&context);
            let [device, twin]: [Vec<f32>; 2] =
                [&done.gpu, &done.twin].map(|b| bytemuck::pod_collect_to_vec(&b.encoding));
            // The tolerance of all elements is that of the highest octave: a lower one has less.
            for (i, (found, expected)) in device.iter().zip(&twin).enumerate() {
                let bound = 8e-6 * octave(i % 84).exp2();
                let close = (found - expected).abs() <= bound || found.is_nan() && expected.is_nan();
                assert!(close, "{context}: element {i}: {found}, expected {expected}");
            }
        }
    }
}

/// Octave of an element of a row of 84: 3 coordinates and 10 octaves of sine and cosine of each, the same of the time.
fn octave(element: usize) -> f32 {
    (if element < 63 { element.saturating_sub(3) / 6 } else { element.saturating_sub(64) / 2 }) as f32
}
