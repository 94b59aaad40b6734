//! The backward pass behind the real forward pass, as the trainer records them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use glam::DVec3;

use super::*;
use crate::gpu::kernel::TwinCall;
use crate::gpu::{Commands, GpuOptions, Memory};
use crate::render::blend::BLEND;
use crate::render::frame::FrameOptions;
use crate::render::limits::{ALL_QUADRANTS, INSTANCE_QUADRANT_SHIFT};
use crate::render::pipeline::{FrameBuffers, Shape, record_forward};
use crate::render::quality::Quality;
use crate::render::scene_buffers::SceneBuffers;
use crate::render::work_buffers::{COUNTER_WORDS, WorkBuffers};
use crate::scene::synthetic::{Random, random_scene};
use crate::scene::{Camera, MotionSource, Scene};

/// Everything of a training step up to the splats' gradients.
struct Step {
    gpu: Gpu,
    scene: SceneBuffers,
    work: WorkBuffers,
    buffers: FrameBuffers,
    slots: SlotBuffers,
    image_gradient: Buffer,
    instance_gradient: Buffer,
    splat_gradient: Buffer,
    tiles: u32,
}

impl Step {
    fn new(scene: &Scene, camera: &Camera, capacity: u32) -> Self {
        let gpu = Gpu::open(&GpuOptions { pipeline_cache: false, ..GpuOptions::default() }).unwrap();
        let scene = SceneBuffers::new(&gpu, scene, MotionSource::Auto, &Quality::EXACT).unwrap();
        let pixels = u64::from(camera.width) * u64::from(camera.height);
        let options = FrameOptions {
            background: [0.2, 0.4, 0.1],
            gaussians: scene.gaussians,
            sh_degree: scene.sh_degree,
            instance_capacity: capacity,
            ..FrameOptions::default()
        };
        let frame = Frame::new(camera, DVec3::ZERO, &options).unwrap();
        let tiles = frame.tile_count;
        let buffer = |name: &str, bytes: u64| gpu.buffer(name, bytes, Memory::Device).unwrap();
        let buffers = FrameBuffers {
            frame: gpu.buffer_with("frame", bytemuck::bytes_of(&frame)).unwrap(),
            host_pose: None,
            color: buffer("color", pixels * 16),
            depth: None,
            counters: gpu.buffer("counters readback", COUNTER_WORDS * 4, Memory::Readback).unwrap(),
        };
        let gradient: Vec<f32> = (0..4 * pixels).map(|i| ((i * 2_654_435_761) % 1000) as f32 / 500.0 - 1.0).collect();
        Self {
            work: WorkBuffers::new(&gpu, scene.gaussians, tiles, capacity).unwrap(),
            slots: SlotBuffers::new(&gpu, scene.gaussians, capacity).unwrap(),
            image_gradient: gpu.buffer_with("image_gradient", bytemuck::cast_slice(&gradient)).unwrap(),
            instance_gradient: buffer("instance_gradient", u64::from(capacity) * 48),
            splat_gradient: buffer("splat_gradient", u64::from(scene.gaussians) * 48),
            gpu,
            scene,
            buffers,
            tiles,
        }
    }

    /// Forward and backward; the splats' gradients and the times.
    fn run(&self, target: &BackwardTarget) -> (Vec<f32>, Commands) {
        self.run_cut(target, None)
    }

    /// The same with the lists cut into segments.
    fn run_cut(&self, target: &BackwardTarget, segments: Option<Segments>) -> (Vec<f32>, Commands) {
        let pixels = self.buffers.color.bytes() / 16;
        let states = segments.map(|s| States::new(&self.gpu, s, pixels).unwrap());
        let slots = matches!(target, BackwardTarget::Instances(..)).then(|| self.slots.clone());
        let shape = Shape { tiles: self.tiles, with_depth: false, slots, states, ..Shape::default() };
        let mut r = self.gpu.recorder("step").with_timestamps(true);
        record_forward(&self.gpu, &mut r, &self.scene, &self.work, &self.buffers, &shape).unwrap();
        let input = BackwardInput {
            absolute: true,
            ..BackwardInput::new(&self.work, &self.buffers, &self.image_gradient, self.scene.gaussians, &shape)
        };
        record(&self.gpu, &mut r, &input, target, &Slice::from(&self.splat_gradient)).unwrap();
        let commands = self.gpu.run(r).unwrap();
        let bytes = self.gpu.download(Slice::from(&self.splat_gradient)).unwrap();
        (bytemuck::pod_collect_to_vec(&bytes), commands)
    }
}

/// ‖a − b‖ / ‖b‖.
fn relative_l2(a: &[f32], b: &[f32]) -> f64 {
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let distance = norm(&mut a.iter().zip(b).map(|(a, b)| f64::from(*a) - f64::from(*b)));
    distance / norm(&mut b.iter().map(|b| f64::from(*b)))
}

#[test]
fn all_ways_of_adding_agree_behind_the_forward_pass() {
    let scene = random_scene(3000, 5, 1);
    let camera = Camera::look_at(DVec3::new(0.3, -0.2, -4.0), DVec3::ZERO, -DVec3::Y, 0.8, [150, 91]);
    let step = Step::new(&scene, &camera, 60_000);
    let by_instance = BackwardTarget::Instances(step.slots.clone(), Slice::from(&step.instance_gradient));
    let (first, _) = step.run(&by_instance);
    assert!(first.iter().all(|v| v.is_finite()));
    assert!(first.iter().filter(|v| **v != 0.0).count() > 10_000, "hardly any gradient");
    // Without float atomics the same bits come out every time.
    let (second, _) = step.run(&by_instance);
    assert!(first.iter().zip(&second).all(|(a, b)| a.to_bits() == b.to_bits()), "not deterministic");
    let mut others = vec![BackwardTarget::CompareAndSwap];
    if step.gpu.info().capabilities.float_atomics {
        others.push(BackwardTarget::NativeAtomics);
    }
    for target in &others {
        let distance = relative_l2(&step.run(target).0, &first);
        assert!(distance < 1e-5, "{target:?}: {distance:e}");
    }
    // Lists of hundreds of splats in several segments: the same sums, and without float atomics the same bits every time.
    let segments = Some(Segments { per_list: 4, least: 128 });
    let (cut, _) = step.run_cut(&by_instance, segments);
    let (again, _) = step.run_cut(&by_instance, segments);
    assert!(cut.iter().zip(&again).all(|(a, b)| a.to_bits() == b.to_bits()), "segments are not deterministic");
    assert!(cut != first, "no list was cut");
    for target in [&by_instance].into_iter().chain(&others) {
        let distance = relative_l2(&step.run_cut(target, segments).0, &first);
        assert!(distance < 1e-5, "{target:?} in segments: {distance:e}");
    }
    assert!(step.gpu.take_validation_messages().is_empty());
}

/// A tile of splats in f64: mean, l11, l12, l22, log2 of opacity, colour.
type Splat = [f64; 9];

/// Loss g·colour + g_A·A over 16×16 px, by the definition of the image.
fn loss(splats: &[Splat], gradient: &[[f32; 4]], background: [f64; 3]) -> f64 {
    let mut sum = 0.0;
    for (k, g) in gradient.iter().enumerate() {
        let (mut t, mut colour) = (1.0, [0.0; 3]);
        for [x, y, l11, l12, l22, log2_opacity, rgb @ ..] in splats {
            let (dx, dy) = ((k % 16) as f64 + 0.5 - x, (k / 16) as f64 + 0.5 - y);
            let (u, v) = (l11 * dx + l12 * dy, l22 * dy);
            let alpha = (log2_opacity - u * u - v * v).exp2();
            (0..3).for_each(|c| colour[c] += t * alpha * rgb[c]);
            t *= 1.0 - alpha;
        }
        sum += (0..3).map(|c| f64::from(g[c]) * (colour[c] + t * background[c])).sum::<f64>();
        sum += f64::from(g[3]) * (1.0 - t);
    }
    sum
}

/// The sums are the gradient: every parameter of a splat against central differences of the image in f64.
#[test]
fn sums_are_the_gradient_by_central_differences() {
    // Wide enough that no pixel falls below 1/255, faint enough that no alpha is clamped and no pixel closes.
    let mut random = Random::new(3);
    let splats: Vec<Splat> = (0..12)
        .map(|_| {
            let mut r = |low, high| f64::from(random.range(low, high) as f32);
            let shape = [r(0.02, 0.06), r(-0.02, 0.02), r(0.02, 0.06)];
            [
                r(2.0, 14.0),
                r(2.0, 14.0),
                shape[0],
                shape[1],
                shape[2],
                r(-2.0, -0.5),
                r(0.0, 1.0),
                r(0.0, 1.0),
                r(0.0, 1.0),
            ]
        })
        .collect();
    let gradient: Vec<[f32; 4]> = (0..256).map(|_| [0; 4].map(|_| random.range(-1.0, 1.0) as f32)).collect();
    let options = FrameOptions { background: [0.2, 0.4, 0.1], gaussians: 12, ..FrameOptions::default() };
    let frame = Frame::new(&Camera::look_at(DVec3::Z, DVec3::ZERO, DVec3::Y, 1.0, [16, 16]), DVec3::ZERO, &options);
    let frame = frame.unwrap();
    let background = [0, 1, 2].map(|c| f64::from(frame.background[c]));
    let rows = twin_rows(&frame, &splats, &gradient);
    let two_ln2 = 2.0 * std::f64::consts::LN_2;
    for (k, row) in rows.chunks_exact(12).enumerate() {
        let [h, hu, hv, huu, huv, hvv] = [0, 1, 2, 3, 4, 5].map(|c| f64::from(row[c]));
        let [_, _, l11, l12, l22, ..] = splats[k];
        let analytic = [
            two_ln2 * l11 * hu,
            two_ln2 * (l12 * hu + l22 * hv),
            -two_ln2 * (huu - l12 / l22 * huv) / l11,
            -two_ln2 * huv / l22,
            -two_ln2 * hvv / l22,
            std::f64::consts::LN_2 * h,
            f64::from(row[6]),
            f64::from(row[7]),
            f64::from(row[8]),
        ];
        assert_eq!(row[9], 256.0);
        for (parameter, analytic) in analytic.into_iter().enumerate() {
            let step = 1e-5;
            let mut moved = [splats.clone(), splats.clone()];
            moved[0][k][parameter] += step;
            moved[1][k][parameter] -= step;
            let [plus, minus] = moved.map(|s| loss(&s, &gradient, background));
            let numeric = (plus - minus) / (2.0 * step);
            let scale = numeric.abs().max(1e-2);
            assert!((analytic - numeric).abs() < 2e-4 * scale, "splat {k}, [{parameter}]: {analytic} {numeric}");
        }
    }
}

/// Rows of the twins' forward and backward pass.
fn twin_rows(frame: &Frame, splats: &[Splat], gradient: &[[f32; 4]]) -> Vec<f32> {
    let words = |s: &Splat| {
        let s = s.map(|v| (v as f32).to_bits());
        [s[0], s[1], s[2], s[3], s[4], s[5], 0, 0, s[6], s[7], s[8], 0]
    };
    let n = splats.len() as u32;
    let splats: Vec<u32> = splats.iter().flat_map(words).collect();
    let frame = bytemuck::cast_slice(&[*frame]).to_vec();
    let (ranges, values) = (vec![0, n], (0..n).map(|g| g | ALL_QUADRANTS << INSTANCE_QUADRANT_SHIFT).collect());
    // Depth, which is not asked for, and slots.
    let mut forward = [frame, ranges, values, splats, vec![0; 4 * 256], vec![0; 4], vec![0; 4]];
    let (spec, buffers) = (&[8, 0, 0, 8, 0, 0, 0, 0], &mut forward);
    (BLEND.twin)(&mut TwinCall { groups: [1, 1, 1], spec, push: &[], buffers });
    let [frame, ranges, values, splats, color, ..] = forward;
    let buffers = BlendBackwardBuffers {
        frame,
        ranges,
        values,
        gaussian_of_slot: None,
        splats,
        color,
        image_gradient: gradient.iter().flatten().map(|g| g.to_bits()).collect(),
        gradient_rows: vec![0; 12 * n as usize],
        states: None,
    };
    let constants =
        BlendBackwardConstants::new(Accumulation::CompareAndSwap, Stage::Shuffle, 8, 4, Segments::WHOLE, true);
    let rows = BLEND_BACKWARD.run_twin(8, constants, (), buffers, 1).gradient_rows;
    rows.iter().map(|w| f32::from_bits(*w)).collect()
}
