//! Random cases: inputs, and a whole step on the device.

use engine::gpu::Slice;
use engine::reference::Pose;
use engine::reference::gradient::association::nearest;
use engine::train::association::*;
use engine::train::property_loss::PropertyLoss;
use engine::train::status;
use engine::train::step::{Step, bias_corrections};
use glam::DVec3;
use tests_harness::TestGpu;

pub struct Rng(pub u64);

impl Rng {
    pub fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as u32 ^ (self.0 >> 12) as u32
    }

    /// In -1..1.
    pub fn signed(&mut self) -> f32 {
        (self.next() >> 8) as f32 / 8_388_608.0 - 1.0
    }

    pub fn vector(&mut self) -> [f32; 3] {
        [0; 3].map(|_| self.signed())
    }
}

pub fn bits(values: impl IntoIterator<Item = f32>) -> Vec<u32> {
    values.into_iter().map(f32::to_bits).collect()
}

pub fn floats(words: &[u32]) -> Vec<f32> {
    words.iter().map(|w| f32::from_bits(*w)).collect()
}

pub fn planes(v: &[[f32; 3]]) -> Vec<f32> {
    (0..3).flat_map(|c| v.iter().map(move |x| x[c])).collect()
}

pub fn promote(v: &[f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

pub fn relative(truth: &[f64], test: &[f64]) -> f64 {
    assert_eq!(truth.len(), test.len());
    let norm: f64 = truth.iter().map(|x| x * x).sum::<f64>().sqrt();
    let error: f64 = truth.iter().zip(test).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
    error / norm.max(1e-300)
}

/// Random Gaussians, superpoints and poses, and a step.
pub struct Case {
    pub mean: Vec<[f32; 3]>,
    pub position: Vec<[f32; 3]>,
    pub pose: Vec<[[f32; 3]; 2]>,
    pub own: Vec<u32>,
    pub step: Step,
    pub neighbors: u32,
    pub slots: u32,
}

impl Case {
    pub fn new(n: usize, m: usize, neighbors: u32, slots: u32, seed: u64) -> Self {
        let mut rng = Rng(seed);
        let step = Step {
            gaussians: n as u32,
            superpoints: m as u32,
            neighbors: slots,
            iteration: 7,
            rate_association: 1e-2,
            bias_association: bias_corrections(0.9, 0.999, 3),
            weight_dssim: 0.2,
            weight_position: 1e-3,
            weight_rotation: 100.0,
            weight_translation: 10.0,
            ..Step::with_usual_adam()
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

    pub fn step_words(&self) -> Vec<u32> {
        bytemuck::cast_slice(&[self.step]).to_vec()
    }

    pub fn pose_words(&self) -> Vec<u32> {
        bits(self.pose.iter().flatten().flat_map(|v| [v[0], v[1], v[2], 0.0]))
    }

    pub fn position_words(&self) -> Vec<u32> {
        bits(self.position.as_flattened().iter().copied())
    }

    pub fn constants(&self) -> AssociationConstants {
        AssociationConstants { neighbors: self.neighbors, slots: self.slots }
    }

    pub fn groups(&self) -> u32 {
        (self.mean.len() as u32).div_ceil(256)
    }

    /// Rows that remember superpoints at random, with moments.
    pub fn rows(&self, seed: u64) -> [Vec<u32>; 4] {
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
}

/// A state on the device, with the buffers of the step.
pub struct DeviceStep {
    pub state: SuperpointState,
    pub buffers: StepBuffers,
    pub pose_gradient: Slice,
}

impl DeviceStep {
    pub fn new(gpu: &TestGpu, case: &Case, form: PropertyLoss) -> Self {
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
            failed: with("failed", vec![0; 8]),
            status: with("status", status::clear().to_vec()),
            mean: with("mean", bits(planes(&case.mean))),
            superpoint_of_gaussian: with("superpoint_of_gaussian", case.own.clone()),
            pose: with("pose", case.pose_words()),
        };
        Self { state, buffers, pose_gradient: with("pose_gradient", vec![0; 6 * n]) }
    }

    pub fn run(&self, gpu: &TestGpu) {
        let mut r = gpu.recorder("association step");
        self.state.record_before(&mut r, &self.buffers).unwrap();
        self.state.record_reduce_pose(&mut r, &self.buffers, &self.pose_gradient).unwrap();
        self.state.record_commit(&mut r, &self.buffers).unwrap();
        gpu.run(r).unwrap();
    }
}

pub fn download(gpu: &TestGpu, slice: impl Into<Slice>, count: usize) -> Vec<u32> {
    let slice = slice.into();
    bytemuck::pod_collect_to_vec(&gpu.download(slice.buffer.slice(slice.start, 4 * count as u64)).unwrap())
}

pub fn to_poses(pose: &[[[f32; 3]; 2]]) -> Vec<Pose> {
    pose.iter().map(|[r, t]| Pose { rotation: promote(r), translation: promote(t) }).collect()
}
