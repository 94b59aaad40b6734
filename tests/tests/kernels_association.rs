//! Farthest-point sampling, association, property losses and superpoint sums on the device: every kernel against its twin,
//! the whole step against the f64 reference, and the sparse association against a dense one.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use engine::gpu::kernel::Kernel;
use engine::gpu::{Memory, Slice};
use engine::reference::Pose;
use engine::reference::gradient::association::{nearest, weights};
use engine::reference::gradient::motion::left_jacobian;
use engine::reference::gradient::property::PropertyInput;
use engine::train::adam;
use engine::train::association::nearest::*;
use engine::train::association::segment::*;
use engine::train::association::update::*;
use engine::train::association::*;
use engine::train::farthest_point::*;
use engine::train::property_loss::PropertyLoss;
use engine::train::property_loss::backward::*;
use engine::train::property_loss::residual::*;
use engine::train::status;
use engine::train::step::{Step, bias_corrections};
use glam::DVec3;
use tests_harness::{KernelCase, TestGpu, gpu};

struct Rng(u64);

impl Rng {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as u32 ^ (self.0 >> 12) as u32
    }

    /// In -1..1.
    fn signed(&mut self) -> f32 {
        (self.next() >> 8) as f32 / 8_388_608.0 - 1.0
    }

    fn vector(&mut self) -> [f32; 3] {
        [0; 3].map(|_| self.signed())
    }
}

fn bits(values: impl IntoIterator<Item = f32>) -> Vec<u32> {
    values.into_iter().map(f32::to_bits).collect()
}

fn floats(words: &[u32]) -> Vec<f32> {
    words.iter().map(|w| f32::from_bits(*w)).collect()
}

fn planes(v: &[[f32; 3]]) -> Vec<f32> {
    (0..3).flat_map(|c| v.iter().map(move |x| x[c])).collect()
}

fn promote(v: &[f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

fn relative(truth: &[f64], test: &[f64]) -> f64 {
    assert_eq!(truth.len(), test.len());
    let norm: f64 = truth.iter().map(|x| x * x).sum::<f64>().sqrt();
    let error: f64 = truth.iter().zip(test).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
    error / norm.max(1e-300)
}

fn run(
    gpu: &TestGpu,
    kernel: &'static Kernel,
    spec: &[u32],
    push: &[u8],
    buffers: Vec<Vec<u32>>,
    groups: u32,
) -> Vec<Vec<u32>> {
    let case = KernelCase { kernel, spec: spec.to_vec(), push: push.to_vec(), buffers, groups };
    let result = case.run(gpu);
    result.assert_equal(kernel, &format!("{groups} groups, spec {spec:?}"));
    result.gpu
}

/// Random Gaussians, superpoints and poses, and a step.
struct Case {
    mean: Vec<[f32; 3]>,
    position: Vec<[f32; 3]>,
    pose: Vec<[[f32; 3]; 2]>,
    own: Vec<u32>,
    step: Step,
    neighbors: u32,
    slots: u32,
}

impl Case {
    fn new(n: usize, m: usize, neighbors: u32, slots: u32, seed: u64) -> Self {
        let mut rng = Rng(seed);
        let step = Step {
            counts: [n as u32, m as u32, slots, 7],
            rate_1: [0.0, 0.0, 0.0, 1e-2],
            adam: [0.9, 0.999, 1e-15, 0.0],
            bias_1: {
                let b = bias_corrections(0.9, 0.999, 3);
                [b[0], b[1], 0.0, 0.0]
            },
            weights: [0.2, 1e-3, 100.0, 10.0],
            ..Step::default()
        };
        Self {
            mean: (0..n).map(|_| rng.vector()).collect(),
            position: (0..m).map(|_| rng.vector()).collect(),
            pose: (0..m).map(|_| [rng.vector(), rng.vector().map(|x| 0.3 * x)]).collect(),
            own: (0..n).map(|_| rng.next() % m as u32).collect(),
            step,
            neighbors,
            slots,
        }
    }

    fn step_words(&self) -> Vec<u32> {
        bytemuck::cast_slice(&[self.step]).to_vec()
    }

    fn pose_words(&self) -> Vec<u32> {
        bits(self.pose.iter().flatten().flat_map(|v| [v[0], v[1], v[2], 0.0]))
    }

    fn groups(&self) -> u32 {
        (self.mean.len() as u32).div_ceil(256)
    }

    /// Rows that remember superpoints at random, with moments.
    fn rows(&self, seed: u64) -> [Vec<u32>; 4] {
        let mut rng = Rng(seed);
        let (n, m) = (self.mean.len(), self.position.len() as u32);
        let mut rows: [Vec<u32>; 4] = Default::default();
        for _ in 0..n {
            let first = rng.next() % m;
            let known = 1 + rng.next() % self.slots.min(m);
            for s in 0..self.slots {
                let known = s < known;
                rows[0].push(if known { (first + s) % m } else { NO_SUPERPOINT });
                rows[1].push(if known { 2.0 * rng.signed() } else { 0.1 }.to_bits());
                rows[2].push(if known { 1e-3 * rng.signed() } else { 0.0 }.to_bits());
                rows[3].push(if known { 1e-6 * rng.signed().abs() } else { 0.0 }.to_bits());
            }
        }
        rows
    }

    /// Runs the whole chain kernel by kernel, each against its twin. Returns logits after it.
    fn chain(&self, gpu: &TestGpu, form: PropertyLoss, failed: u32) -> Vec<u32> {
        let (n, m) = (self.mean.len(), self.position.len());
        let words = self.step_words();
        let counters = vec![0, 0, 0, failed, 0, 0, 0, 0];
        let mean = bits(planes(&self.mean));
        let position = bits(self.position.as_flattened().iter().copied());
        let shape = [self.neighbors, self.slots];
        let k = self.neighbors as usize;
        let pairs = n * (k + 1);
        let clear = status::clear().to_vec();
        let [neighbor, logit, m1, m2] = self.rows(5);
        let done = run(
            gpu,
            &NEAREST_SUPERPOINTS,
            &shape,
            &[],
            vec![
                words.clone(),
                counters.clone(),
                mean.clone(),
                position.clone(),
                self.own.clone(),
                neighbor,
                logit,
                m1,
                m2,
                vec![0; n * k],
                vec![0; n],
                vec![0; pairs],
                vec![0; pairs],
                clear.clone(),
            ],
            self.groups(),
        );
        let [_, _, _, _, _, neighbor, logit, m1, m2, weight, next, key, value, _] = done.try_into().unwrap();
        // The sort is tested on its own: here the order comes from the host.
        let mut order: Vec<usize> = (0..pairs).collect();
        order.sort_by_key(|&p| key[p]);
        let key: Vec<u32> = order.iter().map(|&p| key[p]).collect();
        let value: Vec<u32> = order.iter().map(|&p| value[p]).collect();
        let sum = |spec: [u32; 4], pair_data: &Vec<u32>, own_data: &Vec<u32>| {
            let push = SuperpointSumPush { neighbors: self.neighbors, pairs: pairs as u32, status_group: 6 };
            let buffers = vec![
                words.clone(),
                key.clone(),
                value.clone(),
                weight.clone(),
                mean.clone(),
                pair_data.clone(),
                own_data.clone(),
                vec![0; SUM_PLANES * m],
                clear.clone(),
            ];
            run(gpu, &SUPERPOINT_SUM, &spec, bytemuck::bytes_of(&push), buffers, m as u32).swap_remove(7)
        };
        let residual = |sums: &Vec<u32>, paper: u32| {
            let spec = [self.neighbors, self.slots, paper];
            let buffers = vec![
                words.clone(),
                counters.clone(),
                mean.clone(),
                self.own.clone(),
                self.pose_words(),
                position.clone(),
                sums.clone(),
                neighbor.clone(),
                weight.clone(),
                logit.clone(),
                m1.clone(),
                m2.clone(),
                vec![0; 9 * n],
                vec![0; 4 * n.div_ceil(256)],
                clear.clone(),
            ];
            let mut done = run(gpu, &PROPERTY_RESIDUAL, &spec, &[], buffers, self.groups());
            (done.swap_remove(12), done.swap_remove(9))
        };
        let (first, property, properties, logit) = if form == PropertyLoss::Paper {
            let buffers = vec![words.clone(), mean.clone(), self.own.clone(), self.pose_words(), vec![0; 9 * n]];
            let values = run(gpu, &PROPERTY_VALUES, &[], &[], buffers, self.groups()).swap_remove(4);
            let first = sum([1, 9, 0, 0], &values, &values);
            let (g, _) = residual(&first, 1);
            let pulls = sum([0, 9, 0, 0], &g, &g);
            let buffers = vec![
                words.clone(),
                counters.clone(),
                mean.clone(),
                self.own.clone(),
                self.pose_words(),
                first.clone(),
                pulls,
                neighbor.clone(),
                weight.clone(),
                logit,
                m1.clone(),
                m2.clone(),
                g,
                vec![0; 9 * n],
                vec![0; 3 * n],
                clear.clone(),
            ];
            let mut done = run(gpu, &PROPERTY_BACKWARD, &shape, &[], buffers, self.groups());
            let own = done.swap_remove(13);
            (first, sum([0, 0, 0, 9], &own, &own), 2, done.swap_remove(9))
        } else {
            let (g, logit) = residual(&vec![0; SUM_PLANES * m], 0);
            let sums = sum([1, 9, 3, 6], &g, &g);
            (sums.clone(), sums, 1, logit)
        };
        let mut rng = Rng(99);
        let pose_gradient = bits((0..6 * n).map(|_| rng.signed()));
        let pose_sum = sum([0, 0, 0, 6], &pose_gradient, &pose_gradient);
        let buffers =
            vec![words.clone(), self.pose_words(), position.clone(), property, pose_sum, vec![0; 6 * m], clear.clone()];
        run(gpu, &SUPERPOINT_GRADIENT, &[properties], &[], buffers, (m as u32).div_ceil(256));
        let buffers = vec![words, counters, first, next, self.own.clone(), position, clear];
        let groups = (n.max(m) as u32).div_ceil(256);
        run(gpu, &SUPERPOINT_COMMIT, &[], &[], buffers, groups);
        logit
    }
}

#[test]
fn every_kernel_agrees_with_its_twin() {
    let gpu = gpu();
    for (n, m, k, slots) in [(700, 40, 5, 8), (257, 3, 3, 16), (64, 1, 1, 1), (1, 1, 1, 4), (300, 300, 7, 7)] {
        for form in [PropertyLoss::Code, PropertyLoss::Paper] {
            let case = Case::new(n, m, k, slots, n as u64);
            let after = case.chain(&gpu, form, 0);
            assert_ne!(after, case.rows(5)[1], "logits did not move");
        }
    }
}

#[test]
fn a_failed_forward_pass_changes_nothing() {
    let case = Case::new(300, 20, 5, 8, 3);
    for form in [PropertyLoss::Code, PropertyLoss::Paper] {
        assert_eq!(case.chain(&gpu(), form, 1), case.rows(5)[1]);
    }
}

#[test]
fn equal_distances_go_to_the_lowest_index() {
    let gpu = gpu();
    let mut case = Case::new(200, 24, 5, 8, 11);
    // Superpoints in groups of four at the same place; Gaussians on a lattice, many at equal distance.
    case.position = (0..24).map(|j| [(j / 4) as f32, 0.0, 0.0]).collect();
    case.mean = (0..200).map(|i| [(i % 11) as f32 * 0.5, (i / 11) as f32, 0.0]).collect();
    case.chain(&gpu, PropertyLoss::Code, 0);
}

#[test]
fn poison_never_reaches_a_parameter() {
    let gpu = gpu();
    let poison = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -1e38, 1e-42, 0.0];
    for (round, bad) in poison.into_iter().enumerate() {
        let mut case = Case::new(300, 20, 5, 8, round as u64);
        case.mean[17][round % 3] = bad;
        case.mean[280] = [bad; 3];
        case.pose[3][round % 2][1] = bad;
        case.position[7][2] = bad;
        for form in [PropertyLoss::Code, PropertyLoss::Paper] {
            let state = DeviceStep::new(&gpu, &case, form);
            for _ in 0..3 {
                state.run(&gpu);
            }
            for (name, slice) in [
                ("logit", Slice::from(&state.state.rows().logit)),
                ("moment 1", Slice::from(&state.state.rows().moment_1)),
                ("moment 2", Slice::from(&state.state.rows().moment_2)),
                ("gradient", Slice::from(&state.state.gradient)),
            ] {
                let bytes = slice.bytes.min(if name == "gradient" { 4 * 6 * 20 } else { u64::MAX });
                let values: Vec<f32> =
                    bytemuck::pod_collect_to_vec(&gpu.download(slice.buffer.slice(0, bytes)).unwrap());
                assert!(values.iter().all(|v| v.is_finite()), "{name} with {bad} in {form:?}");
            }
            let position: Vec<f32> = bytemuck::pod_collect_to_vec(&gpu.download(&state.state.position).unwrap());
            let rotten = position[..60].iter().enumerate().find(|(i, v)| !v.is_finite() && *i != 23);
            assert_eq!(rotten, None, "centres with {bad} in {form:?}");
        }
    }
}

/// A state on the device, with the buffers of the step.
struct DeviceStep {
    state: SuperpointState,
    buffers: StepBuffers,
    pose_gradient: Slice,
}

impl DeviceStep {
    fn new(gpu: &TestGpu, case: &Case, form: PropertyLoss) -> Self {
        let (n, m) = (case.mean.len(), case.position.len());
        let near = nearest(
            &case.mean.iter().map(promote).collect::<Vec<_>>(),
            &case.position.iter().map(promote).collect::<Vec<_>>(),
            case.neighbors as usize,
        );
        let mut rng = Rng(4);
        let (slots, k) = (case.slots as usize, case.neighbors as usize);
        let mut neighbor = vec![NO_SUPERPOINT; n * slots];
        let mut logit = vec![NEW_LOGIT; n * slots];
        for i in 0..n {
            neighbor[i * slots..][..k].copy_from_slice(&near[i * k..][..k]);
            logit[i * slots..][..k].iter_mut().for_each(|l| *l = rng.signed());
        }
        let association = engine::scene::Association { neighbors: slots, neighbor, logit };
        let options = AssociationOptions {
            superpoints: m as u32,
            neighbors: case.neighbors,
            slots: case.slots,
            property_loss: form,
            ..AssociationOptions::default()
        };
        let state = SuperpointState::from_parts(gpu, &case.position, &association, [&[], &[]], options).unwrap();
        let with =
            |name: &str, words: Vec<u32>| Slice::from(&gpu.buffer_with(name, bytemuck::cast_slice(&words)).unwrap());
        let buffers = StepBuffers {
            step: with("step", case.step_words()),
            counters: with("counters", vec![0; 8]),
            status: with("status", status::clear().to_vec()),
            mean: with("mean", bits(planes(&case.mean))),
            superpoint_of_gaussian: with("superpoint_of_gaussian", case.own.clone()),
            pose: with("pose", case.pose_words()),
        };
        Self { state, buffers, pose_gradient: with("pose_gradient", vec![0; 6 * n]) }
    }

    fn run(&self, gpu: &TestGpu) {
        let mut r = gpu.recorder("association step");
        self.state.record_before(&mut r, &self.buffers).unwrap();
        self.state.record_reduce_pose(&mut r, &self.buffers, &self.pose_gradient).unwrap();
        self.state.record_commit(&mut r, &self.buffers).unwrap();
        gpu.run(r).unwrap();
    }
}

fn download(gpu: &TestGpu, slice: impl Into<Slice>, count: usize) -> Vec<u32> {
    let slice = slice.into();
    bytemuck::pod_collect_to_vec(&gpu.download(slice.buffer.slice(slice.start, 4 * count as u64)).unwrap())
}

fn to_poses(pose: &[[[f32; 3]; 2]]) -> Vec<Pose> {
    pose.iter().map(|[r, t]| Pose { rotation: promote(r), translation: promote(t) }).collect()
}

#[test]
fn a_step_agrees_with_the_f64_reference() {
    let gpu = gpu();
    for (form, seed) in [(PropertyLoss::Code, 1), (PropertyLoss::Paper, 2), (PropertyLoss::Off, 3)] {
        let (n, m, k, slots) = (3000, 60, 5, 8);
        let mut case = Case::new(n, m, k as u32, slots as u32, seed);
        let mut rng = Rng(8);
        // Rotations from nothing to more than a turn.
        for (j, [r, _]) in case.pose.iter_mut().enumerate() {
            *r = r.map(|x| x * [0.0, 1e-6, 1e-3, 0.1, 1.0, 4.0][j % 6]);
        }
        let mut device = DeviceStep::new(&gpu, &case, form);
        let pose_gradient: Vec<f32> = (0..6 * n).map(|_| 1e-6 * rng.signed()).collect();
        device.pose_gradient =
            Slice::from(&gpu.buffer_with("pose_gradient", bytemuck::cast_slice(&pose_gradient)).unwrap());
        let logit = floats(&download(&gpu, &device.state.rows().logit, n * slots));
        let neighbor = download(&gpu, &device.state.rows().neighbor, n * slots);
        device.run(&gpu);

        let used = |v: &[f32]| v.chunks(slots).flat_map(|r| r[..k].iter().map(|x| f64::from(*x))).collect::<Vec<f64>>();
        let mean: Vec<DVec3> = case.mean.iter().map(promote).collect();
        let position: Vec<DVec3> = case.position.iter().map(promote).collect();
        let pose = to_poses(&case.pose);
        let logit64 = used(&logit);
        let near: Vec<u32> = neighbor.chunks(slots).flat_map(|r| r[..k].to_vec()).collect();
        let input = PropertyInput {
            mean: &mean,
            of_gaussian: &case.own,
            neighbors: k,
            neighbor: &near,
            logit: &logit64,
            position: &position,
            pose: &pose,
        };
        let lambda = [1, 2, 3].map(|i| f64::from(case.step.weights[i]));
        let off = form == PropertyLoss::Off;
        let truth = input.gradient(if off { PropertyLoss::Code } else { form }, if off { [0.0; 3] } else { lambda });

        if !off {
            let loss = floats(&download(&gpu, &device.state.property_loss, 4));
            for p in 0..3 {
                let error = (f64::from(loss[p]) - truth.loss[p]).abs() / truth.loss[p];
                assert!(error < 1e-5, "{form:?} loss {p}: {error:e}");
            }
            let moment = floats(&download(&gpu, &device.state.rows().moment_1, n * slots));
            let ours: Vec<f64> = used(&moment).iter().map(|m| m / (1.0 - f64::from(0.9_f32))).collect();
            let error = relative(&truth.logit, &ours);
            println!("{form:?} logit gradient {error:.2e}");
            assert!(error < 1e-4, "{form:?} logit gradient {error:e}");
        }
        if form == PropertyLoss::Paper {
            let ours = floats(&download(&gpu, device.state.mean_gradient().unwrap(), 3 * n));
            let truth: Vec<f64> = (0..3).flat_map(|c| truth.mean.iter().map(move |g| g[c])).collect();
            let error = relative(&truth, &ours.iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
            println!("{form:?} mean gradient {error:.2e}");
            assert!(error < 1e-4, "{form:?} mean gradient {error:e}");
        }
        let mut total = truth.pose.clone();
        let mut tangent = vec![DVec3::ZERO; m];
        for i in 0..n {
            let j = case.own[i] as usize;
            let at = |c: usize| f64::from(pose_gradient[c * n + i]);
            tangent[j] += DVec3::new(at(0), at(1), at(2));
            total[j].translation += DVec3::new(at(3), at(4), at(5));
        }
        for j in 0..m {
            total[j].rotation += left_jacobian(pose[j].rotation).transpose() * tangent[j];
        }
        let gradient = floats(&download(&gpu, &device.state.gradient, 6 * m));
        for (part, first) in [("rotation", 0), ("translation", 3)] {
            let truth: Vec<f64> = (0..3)
                .flat_map(|c| total.iter().map(move |p| if first == 0 { p.rotation[c] } else { p.translation[c] }))
                .collect();
            let ours: Vec<f64> = gradient[first * m..(first + 3) * m].iter().map(|x| f64::from(*x)).collect();
            let error = relative(&truth, &ours);
            println!("{form:?} {part} gradient {error:.2e}");
            assert!(error < 1e-4, "{form:?} {part} gradient {error:e}");
        }
        check_commit(&gpu, &device, &mean, &near, &weights(&logit64, k), &position, k);
    }
}

/// Centres and assignment of the next step.
fn check_commit(
    gpu: &TestGpu,
    device: &DeviceStep,
    mean: &[DVec3],
    near: &[u32],
    a: &[f64],
    position: &[DVec3],
    k: usize,
) {
    let mut sums = vec![(0.0, DVec3::ZERO); position.len()];
    for (at, &j) in near.iter().enumerate() {
        sums[j as usize].0 += a[at];
        sums[j as usize].1 += mean[at / k] * a[at];
    }
    let center = |j: usize| if sums[j].0 > 0.0 { sums[j].1 / sums[j].0.max(1e-5) } else { position[j] };
    let truth: Vec<f64> = (0..position.len()).flat_map(|j| center(j).to_array()).collect();
    let ours = floats(&download(gpu, &device.state.position, truth.len()));
    let error = relative(&truth, &ours.iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
    assert!(error < 1e-6, "centres {error:e}");
    let own = download(gpu, device.buffers.superpoint_of_gaussian.clone(), mean.len());
    for (i, row) in a.chunks(k).enumerate() {
        let best = (1..k).fold(0, |b, s| if row[s] > row[b] { s } else { b });
        assert_eq!(own[i], near[i * k + best], "Gaussian {i}");
    }
    let reported = status::first(&download(gpu, device.buffers.status.clone(), status::STATUS_WORDS));
    assert_eq!(reported, None);
}

/// The dense N×M matrix with Adam on every entry, in f64.
struct Dense {
    m: usize,
    logit: Vec<f64>,
    moments: Vec<[f64; 2]>,
}

impl Dense {
    fn step(&mut self, near: &[u32], k: usize, gradient: &[f64], step: &Step, t: i32) {
        let mut dense = vec![0.0; self.logit.len()];
        for (at, g) in gradient.iter().enumerate() {
            dense[at / k * self.m + near[at] as usize] = *g;
        }
        let (b1, b2) = (f64::from(step.adam[0]), f64::from(step.adam[1]));
        for (at, g) in dense.into_iter().enumerate() {
            let [first, second] = &mut self.moments[at];
            *first = b1 * *first + (1.0 - b1) * g;
            *second = b2 * *second + (1.0 - b2) * g * g;
            let (m, v) = (*first / (1.0 - b1.powi(t)), *second / (1.0 - b2.powi(t)));
            self.logit[at] -= f64::from(step.rate_1[3]) * m / (v.sqrt() + 1e-15);
        }
    }
}

#[test]
fn the_sparse_association_is_the_dense_one() {
    let gpu = gpu();
    // With a slot for every superpoint the two are the same; with few, until an entry that was forgotten comes back.
    for (slots, form) in [(12, PropertyLoss::Code), (12, PropertyLoss::Paper), (5, PropertyLoss::Code)] {
        let (n, m, k) = (80, 12, 3);
        let mut case = Case::new(n, m, k as u32, slots as u32, 21);
        let device = DeviceStep::new(&gpu, &case, form);
        let rows = |what: &engine::gpu::Buffer| download(&gpu, what, n * slots);
        let mut dense = Dense { m, logit: vec![0.1; n * m], moments: vec![[0.0; 2]; n * m] };
        let (neighbor, logit) = (rows(&device.state.rows().neighbor), floats(&rows(&device.state.rows().logit)));
        for at in 0..n * slots {
            if neighbor[at] != NO_SUPERPOINT {
                dense.logit[at / slots * m + neighbor[at] as usize] = f64::from(logit[at]);
            }
        }
        let mut rng = Rng(77);
        let velocity: Vec<[f32; 3]> = (0..n).map(|_| rng.vector()).collect();
        let (mut known, mut forgotten) = (vec![false; n * m], vec![false; n * m]);
        let (mut came_back, mut changes) = (vec![false; n], 0);
        let mut before = neighbor;
        for t in 1..=120 {
            for (x, v) in case.mean.iter_mut().zip(&velocity) {
                // Back and forth, so that superpoints are met again.
                *x = std::array::from_fn(|c| x[c] + 0.05 * v[c] * (t as f32 * 0.15).cos());
            }
            let bias = bias_corrections(0.9, 0.999, t);
            case.step.bias_1 = [bias[0], bias[1], 0.0, 0.0];
            gpu.upload(&device.buffers.step.buffer, bytemuck::bytes_of(&case.step)).unwrap();
            gpu.upload(&device.buffers.mean.buffer, bytemuck::cast_slice(&planes(&case.mean))).unwrap();
            let centers = floats(&download(&gpu, &device.state.position, 3 * m));
            let own = download(&gpu, device.buffers.superpoint_of_gaussian.clone(), n);
            device.run(&gpu);

            let mean: Vec<DVec3> = case.mean.iter().map(promote).collect();
            let position: Vec<DVec3> = centers.as_chunks::<3>().0.iter().map(promote).collect();
            let near = nearest(&mean, &position, k);
            let logit: Vec<f64> =
                near.iter().enumerate().map(|(at, &j)| dense.logit[at / k * m + j as usize]).collect();
            let pose = to_poses(&case.pose);
            let input = PropertyInput {
                mean: &mean,
                of_gaussian: &own,
                neighbors: k,
                neighbor: &near,
                logit: &logit,
                position: &position,
                pose: &pose,
            };
            let lambda = [1, 2, 3].map(|i| f64::from(case.step.weights[i]));
            let gradient = input.gradient(form, lambda).logit;
            dense.step(&near, k, &gradient, &case.step, t as i32);
            let now = rows(&device.state.rows().neighbor);
            for i in 0..n {
                assert_eq!(now[i * slots..][..k], near[i * k..][..k], "Gaussian {i} at step {t}");
                changes += u32::from(now[i * slots..][..k] != before[i * slots..][..k]);
                let has = |row: &[u32], j: usize| row[i * slots..][..slots].contains(&(j as u32));
                for j in 0..m {
                    let (old, new) = (has(&before, j), has(&now, j));
                    forgotten[i * m + j] |= old && !new;
                    came_back[i] |= new && forgotten[i * m + j];
                    known[i * m + j] = new;
                }
            }
            before = now;
        }
        let logit = floats(&rows(&device.state.rows().logit));
        let (mut worst, mut compared) = (0.0_f64, 0);
        for at in 0..n * slots {
            let (i, j) = (at / slots, before[at]);
            // In the paper's form and in the centres every Gaussian acts on all; only rows of their own count here.
            if j != NO_SUPERPOINT && !came_back[i] {
                worst = worst.max((f64::from(logit[at]) - dense.logit[i * m + j as usize]).abs());
                compared += 1;
            }
        }
        println!("{slots} slots, {form:?}: {changes} changed rows, {compared} entries compared, worst {worst:.2e}");
        assert!(changes > 500, "the test moves too little: {changes}");
        assert!(compared > 100, "{compared}");
        assert!(worst < 2e-4, "{slots} slots, {form:?}: {worst:e}");
        assert_eq!(known.iter().any(|k| *k), true);
    }
}

#[test]
fn farthest_points_are_the_ones_of_a_plain_loop() {
    let gpu = gpu();
    for (n, m, seed) in [(5000_usize, 70_u32, 1234_u64), (1, 1, 7), (40, 40, 3), (1024, 5, 1023)] {
        let mut rng = Rng(n as u64);
        // A coarse lattice: equal distances and equal points.
        let mean: Vec<[f32; 3]> = (0..n).map(|_| rng.vector().map(|x| (x * 6.0).round() / 6.0)).collect();
        let mean_buffer = gpu.buffer_with("mean", bytemuck::cast_slice(&planes(&mean))).unwrap();
        let chosen = gpu.buffer("chosen", 4 * u64::from(m), Memory::Device).unwrap();
        let position = gpu.buffer("position", 12 * u64::from(m), Memory::Device).unwrap();
        let sampling = FarthestPoint::new(&gpu, n as u32, seed).unwrap();
        let mut r = gpu.recorder("farthest points");
        sampling.record(&mut r, &(&mean_buffer).into(), m, &(&chosen).into(), &(&position).into()).unwrap();
        gpu.run(r).unwrap();

        let mut distance = vec![f32::MAX; n];
        let mut next = (seed % n as u64) as usize;
        let mut truth = Vec::new();
        for _ in 0..m {
            truth.push(next as u32);
            for (i, d) in distance.iter_mut().enumerate() {
                let v: [f32; 3] = std::array::from_fn(|c| mean[i][c] - mean[next][c]);
                *d = if i == next { -1.0 } else { d.min(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) };
            }
            next = (0..n).fold(0, |b, i| if distance[i] > distance[b] { i } else { b });
        }
        assert_eq!(download(&gpu, &chosen, m as usize), truth);
        let places: Vec<f32> = truth.iter().flat_map(|&i| mean[i as usize]).collect();
        assert_eq!(floats(&download(&gpu, &position, 3 * m as usize)), places);
    }
}

#[test]
fn one_round_agrees_with_its_twin_even_on_poison() {
    let gpu = gpu();
    for n in [1_usize, 300, 2500] {
        let mut rng = Rng(n as u64);
        let mut mean: Vec<[f32; 3]> = (0..n).map(|_| rng.vector()).collect();
        mean[n / 2][1] = f32::NAN;
        mean[n / 3] = [1e38, -1e38, f32::INFINITY];
        let groups = n.div_ceil(1024);
        let candidates: Vec<u32> = (0..5).flat_map(|_| [rng.signed().abs().to_bits(), rng.next() % n as u32]).collect();
        let push = FarthestPointPush { points: n as u32, round: 2, candidates: 5 };
        let buffers = vec![
            bits(planes(&mean)),
            candidates,
            bits((0..n).map(|i| [f32::MAX, 0.3, -1.0][i % 3])),
            vec![0; 2 * groups],
            vec![0; 3],
            vec![0; 9],
        ];
        let case = KernelCase {
            kernel: &FARTHEST_POINT,
            spec: vec![],
            push: bytemuck::bytes_of(&push).to_vec(),
            buffers,
            groups: groups as u32,
        };
        case.run(&gpu).assert_equal(&FARTHEST_POINT, &format!("{n} points"));
    }
}

#[test]
fn superpoints_start_where_the_gaussians_are() {
    let gpu = gpu();
    // More superpoints than Gaussians: one each.
    for (n, asked, init) in
        [(900, 50, AssociationInit::Code), (900, 50, AssociationInit::Paper), (7, 300, AssociationInit::Code)]
    {
        let case = Case::new(n, 1, 5, 8, 6);
        let mean = gpu.buffer_with("mean", bytemuck::cast_slice(&planes(&case.mean))).unwrap();
        let own = Slice::from(&gpu.buffer("superpoint_of_gaussian", 4 * n as u64, Memory::Device).unwrap());
        let options = AssociationOptions { superpoints: asked, init, seed: 11, ..AssociationOptions::default() };
        let state = SuperpointState::init(&gpu, &(&mean).into(), &own, n as u32, options).unwrap();
        let m = asked.min(n as u32) as usize;
        assert_eq!(state.superpoints() as usize, m);
        let (superpoints, association) = state.download(&gpu, &own).unwrap();
        let points: Vec<DVec3> = case.mean.iter().map(promote).collect();
        let centers: Vec<DVec3> = superpoints.position.iter().map(promote).collect();
        assert!(centers.iter().all(|c| points.contains(c)));
        let k = state.options().neighbors as usize;
        let near = nearest(&points, &centers, k);
        for i in 0..n {
            assert_eq!(association.neighbor[i * 8..][..k], near[i * k..][..k]);
            assert!(association.neighbor[i * 8 + k..][..8 - k].iter().all(|j| *j == NO_SUPERPOINT));
            assert_eq!(superpoints.of_gaussian[i], near[i * k]);
            let seeded = centers[near[i * k] as usize] == points[i];
            let first = match init {
                AssociationInit::Code => 1.0,
                AssociationInit::Paper if seeded => 0.9,
                AssociationInit::Paper => 0.1,
            };
            assert_eq!(association.logit[i * 8..][..8], [first, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1], "Gaussian {i}");
        }
        // Saved and loaded, it is the same.
        let loaded =
            SuperpointState::from_parts(&gpu, &superpoints.position, &association, [&[], &[]], *state.options());
        let again = loaded.unwrap().download(&gpu, &own).unwrap();
        assert_eq!(again, (superpoints, association));
    }
}

#[test]
fn wrong_shapes_are_refused() {
    let gpu = gpu();
    let mean = gpu.buffer_with("mean", &[0; 48]).unwrap();
    let own = Slice::from(&gpu.buffer("superpoint_of_gaussian", 16, Memory::Device).unwrap());
    let fails = |n: u32, options: AssociationOptions| {
        SuperpointState::init(&gpu, &(&mean).into(), &own, n, options).unwrap_err().to_string()
    };
    let default = AssociationOptions::default();
    assert!(fails(0, default).contains("gaussians"));
    assert!(fails(4, AssociationOptions { neighbors: 8, ..default }).contains("neighbors"));
    assert!(fails(4, AssociationOptions { slots: 4, ..default }).contains("slots"));
    assert!(fails(4, AssociationOptions { superpoints: 0, ..default }).contains("superpoints"));
}

#[test]
fn the_step_is_bit_identical_each_time() {
    let gpu = gpu();
    for form in [PropertyLoss::Code, PropertyLoss::Paper] {
        let results: Vec<_> = (0..2)
            .map(|_| {
                let case = Case::new(3000, 40, 5, 8, 2);
                let device = DeviceStep::new(&gpu, &case, form);
                (0..3).for_each(|_| device.run(&gpu));
                let rows = device.state.rows();
                [&rows.logit, &rows.moment_1, &rows.moment_2]
                    .map(|b| download(&gpu, b, 3000 * 8))
                    .into_iter()
                    .chain([download(&gpu, &device.state.position, 120), download(&gpu, &device.state.gradient, 240)])
                    .collect::<Vec<_>>()
            })
            .collect();
        assert_eq!(results[0], results[1]);
    }
}

#[test]
fn adam_of_the_twin_is_the_one_of_the_test() {
    let step = Case::new(1, 1, 1, 1, 1).step;
    let mut moments = [0.0; 2];
    let bias = bias_corrections(0.9, 0.999, 1);
    let value = adam::update(&step, 0.5, 1e-3, &mut moments, 1e-2, bias);
    assert!((value - 0.49).abs() < 1e-6, "{value}");
}

#[test]
fn outside_truth_of_superpoints_is_met() {
    let Some(path) = tests_harness::data("oracle/superpoint_400_20.npz") else { return };
    let gpu = gpu();
    let check = tools::oracle_superpoint::check(&path, Some(&gpu)).unwrap();
    for (name, e) in check.outputs.iter().chain(&check.losses).chain(&check.gradients) {
        println!(
            "{name:44} reference {:.1e} gpu {:.1e} f32 {}",
            e.reference,
            e.gpu.unwrap_or(f64::NAN),
            e.stored_as_f32
        );
    }
    println!("{}", check.describe());
    assert!(check.passes(), "{}", check.describe());
    assert!(check.gradients.values().filter(|e| e.gpu.is_some()).count() > 50);
}

/// Milliseconds of a step's association by kernel; run by hand.
#[test]
#[ignore = "a measurement"]
fn milliseconds_of_a_step() {
    let gpu = gpu();
    for (n, m) in [(10_000, 100), (50_000, 300)] {
        for form in [PropertyLoss::Code, PropertyLoss::Paper] {
            let case = Case::new(n, m, 5, 8, 1);
            let device = DeviceStep::new(&gpu, &case, form);
            let mut r = gpu.recorder("association step").with_timestamps(true);
            device.state.record_before(&mut r, &device.buffers).unwrap();
            device.state.record_reduce_pose(&mut r, &device.buffers, &device.pose_gradient).unwrap();
            device.state.record_commit(&mut r, &device.buffers).unwrap();
            let mut commands = r.finish().unwrap();
            let mut best = f64::MAX;
            for _ in 0..5 {
                let start = std::time::Instant::now();
                gpu.submit(&mut commands).unwrap();
                gpu.wait_for(&commands).unwrap();
                best = best.min(start.elapsed().as_secs_f64() * 1e3);
            }
            println!("N {n}, M {m}, {form:?}: {best:.2} ms");
            println!("{:?}", commands.timings().unwrap());
        }
        let mean = gpu.buffer_with("mean", bytemuck::cast_slice(&planes(&Case::new(n, 1, 1, 1, 1).mean))).unwrap();
        let own = Slice::from(&gpu.buffer("superpoint_of_gaussian", 4 * n as u64, Memory::Device).unwrap());
        let options = AssociationOptions { superpoints: m as u32, ..AssociationOptions::default() };
        let start = std::time::Instant::now();
        SuperpointState::init(&gpu, &(&mean).into(), &own, n as u32, options).unwrap();
        println!("N {n}, M {m}: init {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    }
}
