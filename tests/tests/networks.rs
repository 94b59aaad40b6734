//! Networks F and G on the device: passes against the f64 reference and the oracle, repeatability, poisoned input, time.

use std::path::Path;

use engine::gpu::{Buffer, Gpu, Memory, Slice, Timing};
use engine::reference::gradient::motion::pose_gradient;
use engine::reference::gradient::network::{LinearGradient, network_gradient, nonrigid_network_gradient};
use engine::reference::{self, Pose};
use engine::render::frame::Frame;
use engine::render::limits::COUNT_FAILED;
use engine::scene::{DeformNetwork, DeformSize, Linear, NonrigidNetwork};
use engine::train::linear::{Output, Stage};
use engine::train::network_f::{self, NetworkF};
use engine::train::network_g::{self, NetworkG};
use engine::train::status;
use engine::train::step::{Step, bias_corrections};
use glam::{DMat3, DVec3};
use tests_harness::gradient::assert_gradients_close;
use tests_harness::render_case::{Random, RenderInput, test_camera};
use tools::dev::oracle;

const STAGES: [Stage; 2] = [Stage::Shuffle, Stage::Shared];

fn step(time: f32) -> Step {
    let bias = bias_corrections(0.9, 0.999, 1);
    Step {
        rate_network_f: 1e-3,
        rate_network_g: 1e-3,
        bias_network_f: bias,
        bias_network_g: bias,
        time,
        exact_time: time,
        ..Step::with_usual_adam()
    }
}

/// What both passes bind.
struct Common {
    step: Slice,
    counters: Slice,
    status: Slice,
}

impl Common {
    fn new(gpu: &Gpu, time: f32) -> Self {
        let buffer = |name: &str, bytes: &[u8]| Slice::from(gpu.buffer_with(name, bytes).unwrap());
        Self {
            step: buffer("step", bytemuck::bytes_of(&step(time))),
            counters: buffer("counters", &[0; 32]),
            status: buffer("status", bytemuck::cast_slice(&status::clear())),
        }
    }

    fn reports(&self, gpu: &Gpu) -> Vec<u32> {
        bytemuck::pod_collect_to_vec(&gpu.download(&self.status).unwrap())
    }
}

fn floats(gpu: &Gpu, slice: &Slice) -> Vec<f32> {
    bytemuck::pod_collect_to_vec(&gpu.download(slice).unwrap())
}

/// A pass of network F: centres, gradient planes, pose.
struct PassF {
    common: Common,
    position: Slice,
    gradient: Slice,
    pose: Slice,
    count: u32,
}

impl PassF {
    fn new(gpu: &Gpu, time: f32, position: &[[f32; 3]], gradient: &[f32]) -> Self {
        let buffer = |name: &str, bytes: &[u8]| Slice::from(gpu.buffer_with(name, bytes).unwrap());
        Self {
            common: Common::new(gpu, time),
            position: buffer("superpoint_position", bytemuck::cast_slice(position)),
            gradient: buffer("superpoint_gradient", bytemuck::cast_slice(gradient)),
            pose: Slice::from(gpu.buffer("pose", 32 * position.len() as u64, Memory::Device).unwrap()),
            count: position.len() as u32,
        }
    }

    fn run(&self, gpu: &Gpu, network: &NetworkF, output: Output) -> Vec<Timing> {
        let c = &self.common;
        let mut r = gpu.recorder("network F").with_timestamps(true);
        network.record_forward(&mut r, self.count, &c.step, &self.position, &self.pose).unwrap();
        let from = network_f::Backward {
            step: &c.step,
            counters: &c.counters,
            status: &c.status,
            superpoint_gradient: &self.gradient,
            plane_stride: self.count,
        };
        network.record_backward(&mut r, self.count, output, &from).unwrap();
        gpu.run(r).unwrap().timings().unwrap()
    }
}

fn positions(r: &mut Random, count: usize) -> Vec<[f32; 3]> {
    (0..count).map(|_| std::array::from_fn(|_| r.range(-1.3, 1.3))).collect()
}

fn upstream(r: &mut Random, count: usize) -> Vec<f32> {
    (0..count).map(|_| r.range(-1.0, 1.0)).collect()
}

/// Vector `m` of three planes from `first` on.
fn plane_vector(planes: &[f32], first: usize, count: usize, m: usize) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|c| f64::from(planes[(first + c) * count + m])))
}

fn assert_layer(gpu: &Linear, truth: &LinearGradient, context: &str) {
    let narrow = |values: &[f64]| values.iter().map(|v| *v as f32).collect::<Vec<f32>>();
    assert_gradients_close(&gpu.weight, &narrow(&truth.weight), &format!("{context}.weight"));
    assert_gradients_close(&gpu.bias, &narrow(&truth.bias), &format!("{context}.bias"));
}

fn relative(ours: impl Iterator<Item = f64>, truth: impl Iterator<Item = f64>) -> f64 {
    let (error, norm) = ours.zip(truth).fold((0.0, 0.0), |(e, n), (a, b)| (e + (a - b) * (a - b), n + b * b));
    (error / norm).sqrt()
}

/// Relative L2 error of the poses on the device.
fn pose_error(gpu: &Gpu, pose: &Slice, truth: &[Pose]) -> f64 {
    let ours = floats(gpu, pose);
    assert!(ours.chunks_exact(4).all(|v| v[3] == 0.0), "the fourth components of poses are 0");
    let ours = ours.chunks_exact(8).flat_map(|p| [p[0], p[1], p[2], p[4], p[5], p[6]]).map(f64::from);
    relative(ours, truth.iter().flat_map(|p| [p.rotation.to_array(), p.translation.to_array()].concat()))
}

#[test]
fn network_f_agrees_with_the_reference() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(12);
    let time = 0.37_f32;
    let sizes =
        [[8, 256], [8, 256], [8, 256], [1, 32], [2, 64], [5, 96]].map(|[layers, width]| DeformSize { layers, width });
    for ((seed, count), size) in [(1, 1), (2, 37), (3, 100), (4, 33), (5, 40), (6, 65)].into_iter().zip(sizes) {
        let weights = DeformNetwork::init(seed, size, false);
        let (position, planes) = (positions(&mut r, count), upstream(&mut r, 6 * count));
        let poses = reference::network_poses(&weights, &position, time.into());
        let vectors = |first: usize| (0..count).map(|m| plane_vector(&planes, first, count, m)).collect::<Vec<_>>();
        let truth = network_gradient(&weights, &position, time.into(), &vectors(0), &vectors(3));
        for stage in STAGES {
            let pass = PassF::new(&gpu, time, &position, &planes);
            let network = NetworkF::new(&gpu, &weights, count as u32).unwrap().with_stage(stage);
            pass.run(&gpu, &network, Output::Gradient);
            let error = pose_error(&gpu, &pass.pose, &poses);
            println!("M = {count}, {stage:?}: poses within {error:.1e}");
            assert!(error <= 1e-5, "{error:e}");
            let gradient = network.download_gradient().unwrap();
            for (i, layer) in gradient.linear.iter().enumerate() {
                assert_layer(layer, &truth.linear[i], &format!("M = {count}, {stage:?}: linear.{i}"));
            }
            assert_layer(&gradient.rotation, &truth.rotation, "rotation");
            assert_layer(&gradient.translation, &truth.translation, "translation");
            assert_eq!(network.download().unwrap(), weights, "kept gradients change no weight");
            // One step of Adam from rest moves every weight by the rate against the sign of its gradient.
            pass.run(&gpu, &network, Output::Adam);
            let (after, g) = (network.download().unwrap().flatten(), gradient.flatten());
            for (k, (before, after)) in weights.flatten().iter().zip(&after).enumerate() {
                let expected = if g[k] == 0.0 { *before } else { before - 1e-3 * g[k].signum() };
                assert!((after - expected).abs() < 2e-6, "[{k}]: {before} -> {after}, gradient {}", g[k]);
            }
            let [first, second] = network.download_moments().unwrap();
            assert!(first.iter().zip(&g).all(|(m, g)| (m - 0.1 * g).abs() <= 1e-5 * g.abs()));
            network.upload_moments([&second, &first]).unwrap();
            assert_eq!(network.download_moments().unwrap(), [second, first]);
            assert_eq!(status::first(&pass.common.reports(&gpu)), None);
        }
    }
}

/// An array of an `.npz` file as f64.
fn array(path: &Path, name: &str) -> Vec<f64> {
    let mut archive = zip::ZipArchive::new(std::fs::File::open(path).unwrap()).unwrap();
    let npy = npyz::NpyFile::new(archive.by_name(&format!("{name}.npy")).unwrap()).unwrap();
    match npy.dtype() {
        npyz::DType::Plain(kind) if kind.size_field() == 4 => {
            npy.into_vec::<f32>().unwrap().into_iter().map(f64::from).collect()
        }
        _ => npy.into_vec().unwrap(),
    }
}

/// dL/dr and dL/dτ of L = Σ mean_t·d_mean_t + Σ rotation_t·d_rotation_t.
fn motion_upstream(case: &oracle::case::SuperpointCase, poses: &[Pose]) -> [Vec<DVec3>; 2] {
    let (d_mean, d_rotation) = (array(&case.path, "d_mean_t"), array(&case.path, "d_rotation_t"));
    let mut sums = vec![[DVec3::ZERO; 2]; poses.len()];
    for (i, &m) in case.scene.deformation.superpoint_of_gaussian().iter().enumerate() {
        let pose = &poses[m as usize];
        let d = DVec3::from_slice(&d_mean[3 * i..]);
        let g = &case.scene.gaussians;
        let turn = reference::exp(pose.rotation);
        let [omega, translation] = &mut sums[m as usize];
        *translation += d;
        *omega += (turn * DVec3::from_array(g.mean[i].map(f64::from))).cross(d);
        let axes = turn * reference::rotation_of_quaternion(g.rotation[i].map(f64::from));
        let d_axes = DMat3::from_cols_slice(&d_rotation[9 * i..9 * i + 9]).transpose();
        for (axis, d_axis) in [(axes.x_axis, d_axes.x_axis), (axes.y_axis, d_axes.y_axis), (axes.z_axis, d_axes.z_axis)]
        {
            *omega += axis.cross(d_axis);
        }
    }
    let converted: Vec<[DVec3; 2]> = poses.iter().zip(sums).map(|(p, [o, t])| pose_gradient(p, o, t)).collect();
    [0, 1].map(|part| converted.iter().map(|pair| pair[part]).collect())
}

#[test]
fn network_f_agrees_with_the_oracle() {
    let Some(folder) = tests_harness::data("oracle") else { return };
    let gpu = tests_harness::shared_gpu();
    let case = oracle::case::load_superpoint(&folder.join("superpoint_400_20.npz")).unwrap();
    let scene = &case.scene.deformation;
    let (weights, position) = (scene.network().unwrap().clone(), scene.superpoints().unwrap().position.clone());
    let poses = reference::network_poses(&weights, &position, case.time);
    let rotation = relative(poses.iter().flat_map(|p| p.rotation.to_array()), case.pose_rotation.iter().copied());
    assert!(rotation <= 1e-12, "{rotation:e}");
    let [d_rotation, d_translation] = motion_upstream(&case, &poses);
    let truth = network_gradient(&weights, &position, case.time, &d_rotation, &d_translation);
    let planes: Vec<f32> = [&d_rotation, &d_translation]
        .iter()
        .flat_map(|d| (0..3).flat_map(move |c| d.iter().map(move |v| v[c] as f32)))
        .collect();
    let pass = PassF::new(&gpu, case.time as f32, &position, &planes);
    let network = NetworkF::new(&gpu, &weights, 20).unwrap();
    pass.run(&gpu, &network, Output::Gradient);
    let error = pose_error(&gpu, &pass.pose, &poses);
    assert!(error <= 1e-4, "{error:e}");
    let gradient = network.download_gradient().unwrap();
    let truths = truth.linear.iter().chain([&truth.translation, &truth.rotation]);
    for ((name, ours), truth) in gradient.named_layers().into_iter().zip(truths) {
        let name = name.replacen("deform.", "deform_", 1);
        let wide = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
        for (part, ours, truth) in
            [("weight", wide(&ours.weight), &truth.weight), ("bias", wide(&ours.bias), &truth.bias)]
        {
            let oracle = array(&case.path, &format!("grad_motion_{name}.{part}"));
            let reference = relative(truth.iter().copied(), oracle.iter().copied());
            let device = relative(ours.into_iter(), oracle.iter().copied());
            println!("{name}.{part}: reference {reference:.1e}, device {device:.1e}");
            // The oracle's gradients of the hidden layers are stored as f32.
            assert!(reference <= 1e-7, "{name}.{part}: reference {reference:e}");
            assert!(device <= 1e-4, "{name}.{part}: device {device:e}");
        }
    }
}

/// A pass of network G.
struct PassG {
    common: Common,
    frame: Slice,
    mean: Slice,
    group: Slice,
    pose: Slice,
    offset: Slice,
    gradient: Slice,
    count: u32,
}

impl PassG {
    fn new(gpu: &Gpu, input: &RenderInput, frame: &Frame, gradient: &[f32]) -> Self {
        let buffer = |name: &str, bytes: &[u8]| Slice::from(gpu.buffer_with(name, bytes).unwrap());
        Self {
            common: Common::new(gpu, frame.time),
            frame: buffer("frame", bytemuck::bytes_of(frame)),
            mean: buffer("mean", bytemuck::cast_slice(&input.mean)),
            group: buffer("superpoint_of_gaussian", bytemuck::cast_slice(&input.superpoint_of_gaussian)),
            pose: buffer("pose", bytemuck::cast_slice(&input.pose)),
            offset: Slice::from(gpu.buffer("nonrigid_offset", 40 * input.count as u64, Memory::Device).unwrap()),
            gradient: buffer("nonrigid_gradient", bytemuck::cast_slice(gradient)),
            count: input.count as u32,
        }
    }

    fn run(&self, gpu: &Gpu, network: &NetworkG, output: Output) -> Vec<Timing> {
        let inputs = network_g::Inputs {
            frame: &self.frame,
            mean: &self.mean,
            superpoint_of_gaussian: &self.group,
            pose: &self.pose,
            moving: true,
            blend: None,
        };
        let c = &self.common;
        let from = network_g::Backward {
            step: &c.step,
            counters: &c.counters,
            status: &c.status,
            nonrigid_gradient: &self.gradient,
        };
        let mut r = gpu.recorder("network G").with_timestamps(true);
        network.record_forward(&mut r, self.count, &inputs, &self.offset).unwrap();
        network.record_backward(&mut r, self.count, output, &inputs, &from).unwrap();
        gpu.run(r).unwrap().timings().unwrap()
    }
}

fn input_g(count: usize) -> (RenderInput, Frame) {
    let input = RenderInput::random(count, 0, count as u64).moving(7, 3);
    let mut frame = input.frame(&test_camera(8, 8));
    frame.time = 0.42;
    (input, frame)
}

/// Heads that matter and little weight on the high octaves, which magnify the last bit of a centre.
fn weights_g() -> NonrigidNetwork {
    let mut network = NonrigidNetwork::init(6);
    let mut r = Random(6);
    for head in [&mut network.translation, &mut network.rotation, &mut network.scaling] {
        head.weight.iter_mut().chain(&mut head.bias).for_each(|w| *w = r.range(-0.1, 0.1));
    }
    let damp = |(i, w): (usize, &mut f32)| *w *= 0.5_f32.powi((i % 84 % 63) as i32 / 6);
    network.linear[0].weight.iter_mut().enumerate().for_each(damp);
    network
}

/// Rigidly moved centres in f64.
fn centres(input: &RenderInput, frame: &Frame) -> Vec<DVec3> {
    let (n, m) = (input.count, input.superpoints as usize);
    let weight = f64::from(frame.key_weight);
    let centre = |g: usize| {
        let s = input.superpoint_of_gaussian[g] as usize;
        let vector = |key: u32, part: usize| {
            let at = 8 * (key as usize * m + s) + 4 * part;
            DVec3::from_array(std::array::from_fn(|c| f64::from(input.pose[at + c])))
        };
        let lerp = |part| vector(frame.first_key, part) * (1.0 - weight) + vector(frame.second_key, part) * weight;
        let mean = DVec3::from_array(std::array::from_fn(|c| f64::from(input.mean[c * n + g])));
        reference::exp(lerp(0)) * mean + lerp(1)
    };
    (0..n).map(centre).collect()
}

#[test]
fn network_g_agrees_with_the_reference() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(2);
    let weights = weights_g();
    for count in [1, 130, 1500] {
        let (input, frame) = input_g(count);
        let planes = upstream(&mut r, 10 * count);
        let (centres, time) = (centres(&input, &frame), f64::from(frame.time));
        let d: Vec<[f64; 10]> = (0..count).map(|g| std::array::from_fn(|p| f64::from(planes[p * count + g]))).collect();
        let truth = nonrigid_network_gradient(&weights, &centres, time, &d);
        let offsets = reference::nonrigid_offsets(&weights, &centres, time);
        for (stage, chunk) in [(Stage::Shuffle, 65_536), (Stage::Shared, 65_536), (Stage::Shared, 512)] {
            let pass = PassG::new(&gpu, &input, &frame, &planes);
            let network = NetworkG::with_stage(&gpu, &weights, count as u32, stage, chunk).unwrap();
            pass.run(&gpu, &network, Output::Gradient);
            let ours = floats(&gpu, &pass.offset);
            let part = |o: &reference::Offset| [&o.mean[..], &o.rotation, &o.scale].concat();
            let wide = (0..count).flat_map(|g| (0..10).map(move |p| p * count + g)).map(|at| f64::from(ours[at]));
            let error = relative(wide, offsets.iter().flat_map(part));
            println!("N = {count}, {stage:?}, chunks of {chunk}: offsets within {error:.1e}");
            assert!(error <= 1e-4, "{error:e}");
            let gradient = network.download_gradient().unwrap();
            let truths = truth.linear.iter().chain([&truth.translation, &truth.rotation, &truth.scaling]);
            for ((name, ours), truth) in gradient.named_layers().into_iter().zip(truths) {
                assert_layer(ours, truth, &format!("N = {count}, {stage:?}: {name}"));
            }
            assert_eq!(network.download().unwrap(), weights);
            pass.run(&gpu, &network, Output::Adam);
            let (after, g) = (network.download().unwrap().flatten(), gradient.flatten());
            for (k, (before, after)) in weights.flatten().iter().zip(&after).enumerate() {
                let expected = if g[k] == 0.0 { *before } else { before - 1e-3 * g[k].signum() };
                assert!((after - expected).abs() < 2e-6, "[{k}]: {before} -> {after}, gradient {}", g[k]);
            }
            let [first, second] = network.download_moments().unwrap();
            network.upload_moments([&second, &first]).unwrap();
            assert_eq!(network.download_moments().unwrap(), [second, first]);
        }
    }
}

#[test]
fn passes_repeat_bit_for_bit_and_stop_with_the_frame() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(3);
    let (position, planes) = (positions(&mut r, 50), upstream(&mut r, 300));
    let (input, frame) = input_g(700);
    let planes_g = upstream(&mut r, 7000);
    let mut results = Vec::new();
    for _ in 0..2 {
        let pass = PassF::new(&gpu, 0.6, &position, &planes);
        let network = NetworkF::new(&gpu, &DeformNetwork::init(4, DeformSize::PAPER, true), 50).unwrap();
        let pass_g = PassG::new(&gpu, &input, &frame, &planes_g);
        let network_g = NetworkG::new(&gpu, &weights_g(), 700).unwrap();
        for _ in 0..3 {
            pass.run(&gpu, &network, Output::Adam);
            pass_g.run(&gpu, &network_g, Output::Adam);
        }
        let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<u32>>();
        results.push([bits(network.download().unwrap().flatten()), bits(network_g.download().unwrap().flatten())]);
        let mut counters = [0_u32; 8];
        counters[COUNT_FAILED as usize] = 1;
        for common in [&pass.common, &pass_g.common] {
            gpu.upload(&common.counters.buffer, bytemuck::cast_slice(&counters)).unwrap();
        }
        pass.run(&gpu, &network, Output::Adam);
        pass_g.run(&gpu, &network_g, Output::Adam);
        let after = [bits(network.download().unwrap().flatten()), bits(network_g.download().unwrap().flatten())];
        assert!(Some(&after) == results.last(), "a failed frame changes nothing");
    }
    assert!(results[0] == results[1]);
}

#[test]
fn poison_never_reaches_a_weight() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(8);
    let poison = [f32::NAN, f32::INFINITY, -f32::INFINITY, 1e38, -1e38, 1e-42];
    let finite = |network: &NetworkF| {
        let [a, b] = network.download_moments().unwrap();
        network.download().unwrap().flatten().iter().chain(&a).chain(&b).all(|v| v.is_finite())
    };
    for (k, value) in poison.into_iter().enumerate() {
        let (mut position, mut planes) = (positions(&mut r, 20), upstream(&mut r, 120));
        let network = NetworkF::new(&gpu, &DeformNetwork::init(4, DeformSize::PAPER, false), 20).unwrap();
        planes[37] = value;
        let pass = PassF::new(&gpu, 0.6, &position, &planes);
        pass.run(&gpu, &network, Output::Adam);
        assert!(finite(&network), "gradient {value}");
        let reports = status::first(&pass.common.reports(&gpu));
        match k {
            0..3 => assert_eq!(reports, Some(("pose", 1, 17))),
            3 | 4 => {
                let (name, _, index) = reports.unwrap();
                assert_eq!(name, "network F");
                assert!(network.weight_name(index).starts_with("deform.linear."), "{}", network.weight_name(index));
            }
            _ => assert_eq!(reports, None),
        }
        position[3][1] = value;
        let pass = PassF::new(&gpu, 0.6, &position, &upstream(&mut r, 120));
        pass.run(&gpu, &network, Output::Adam);
        assert!(finite(&network), "position {value}");
    }
    let (input, frame) = input_g(200);
    let mut planes = upstream(&mut r, 2000);
    planes[405] = f32::NAN;
    let pass = PassG::new(&gpu, &input, &frame, &planes);
    let network = NetworkG::new(&gpu, &weights_g(), 200).unwrap();
    pass.run(&gpu, &network, Output::Adam);
    assert_eq!(status::first(&pass.common.reports(&gpu)), Some(("network G", 1, 5)));
    assert!(network.download().unwrap().flatten().iter().all(|v| v.is_finite()));
}

#[test]
fn what_does_not_fit_is_refused() {
    let gpu = tests_harness::shared_gpu();
    let network = NetworkF::new(&gpu, &DeformNetwork::init(1, DeformSize::PAPER, false), 5).unwrap();
    let dummy = |name: &str| -> Buffer { gpu.buffer(name, 1 << 16, Memory::Device).unwrap() };
    let [step, position, pose] = ["step", "superpoint_position", "pose"].map(|name| Slice::from(dummy(name)));
    let mut r = gpu.recorder("too many");
    assert!(network.record_forward(&mut r, network.capacity() + 1, &step, &position, &pose).is_err());
    let mut wrong = DeformNetwork::init(1, DeformSize::PAPER, false);
    wrong.linear[5].inputs = 256;
    assert!(NetworkF::new(&gpu, &wrong, 5).unwrap_err().to_string().contains("deform.linear.5"));
    assert!(network.upload_moments([&[0.0; 3], &[0.0; 3]]).is_err());
    assert_eq!(network.weight_name(0), "deform.linear.0.weight[0, 0]");
}

fn processor_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

fn report(what: &str, mut run: impl FnMut() -> Vec<Timing>) {
    run();
    let (before, runs) = (processor_seconds(), 5);
    let mut total = std::collections::BTreeMap::new();
    for _ in 0..runs {
        for t in run() {
            *total.entry(t.label).or_insert(0.0) += t.us / 1e3 / f64::from(runs);
        }
    }
    let seconds = (processor_seconds() - before) / f64::from(runs);
    let sum: f64 = total.values().sum();
    println!("{what}: {sum:.1} ms, {:.1} ms of processor time {total:.1?}", 1e3 * seconds);
}

#[test]
fn time_of_a_step() {
    let gpu = tests_harness::shared_gpu();
    let mut r = Random(5);
    let weights = DeformNetwork::init(1, DeformSize::PAPER, false);
    for count in [100, 300] {
        let pass = PassF::new(&gpu, 0.3, &positions(&mut r, count), &upstream(&mut r, 6 * count));
        let network = NetworkF::new(&gpu, &weights, 300).unwrap();
        report(&format!("F, M = {count}"), || pass.run(&gpu, &network, Output::Adam));
    }
    let (input, frame) = input_g(4000);
    let pass = PassG::new(&gpu, &input, &frame, &upstream(&mut r, 40_000));
    let network = NetworkG::new(&gpu, &weights_g(), 4000).unwrap();
    report("G, N = 4000", || pass.run(&gpu, &network, Output::Adam));
}
