//! `deform_project_backward` on the device against its twin, which is the f64 reference.

use engine::gpu::Gpu;
use engine::gpu::kernel::TwinCall;
use engine::render::deform_project::DEFORM_PROJECT;
use engine::render::frame::Frame;
use engine::render::limits::COUNT_FAILED;
use engine::scene::Camera;
use engine::train::deform_project_backward::{
    DEFORM_PROJECT_BACKWARD, DEFORM_PROJECT_BACKWARD_THREADS, OUTPUT_ADAM, OUTPUT_GRADIENT, parameter_planes,
};
use engine::train::status;
use engine::train::step::{Adam, Step, bias_corrections};
use glam::DVec3;
use tests_harness::render_case::{Random, RenderInput, test_camera};
use tests_harness::{UntypedCase, UntypedResult};

/// Bindings by name.
mod at {
    pub const COUNTERS: usize = 2;
    pub const STATUS: usize = 3;
    pub const TILE_COUNT: usize = 5;
    pub const SPLAT_GRADIENT: usize = 6;
    pub const MEAN: usize = 7;
    pub const ROTATION: usize = 9;
    pub const SH: usize = 13;
    pub const MOMENT_1: usize = 17;
    pub const MOMENT_2: usize = 18;
    pub const GRADIENT: usize = 19;
    pub const POSE_GRADIENT: usize = 20;
    pub const OFFSET_GRADIENT: usize = 22;
    pub const DENSITY: usize = 23;
    pub const MAX_RADIUS: usize = 24;
}

/// Kinds of parameters: name, first plane, planes.
fn kinds(degree: u32) -> Vec<(&'static str, usize, usize)> {
    let sh = parameter_planes(degree) as usize - 11;
    vec![("mean", 0, 3), ("log_scale", 3, 3), ("rotation", 6, 4), ("opacity_logit", 10, 1), ("sh", 11, sh)]
}

fn words(v: &[f32]) -> Vec<u32> {
    v.iter().map(|x| x.to_bits()).collect()
}

fn floats(v: &[u32]) -> Vec<f32> {
    v.iter().map(|&x| f32::from_bits(x)).collect()
}

fn step(statistics: bool) -> Step {
    let bias = bias_corrections(0.9, 0.999, 7);
    Step {
        rate_mean: 1.6e-3,
        rate_log_scale: 5e-3,
        rate_rotation: 1e-3,
        rate_opacity_logit: 5e-2,
        rate_sh_0: 2.5e-3,
        rate_sh_rest: 1.25e-4,
        adam: Adam::USUAL,
        bias_gaussians: bias,
        density_statistics: f32::from(u8::from(statistics)),
        ..Step::default()
    }
}

/// Rows as a handful of pixels would leave them.
fn rows(n: usize, r: &mut Random) -> Vec<f32> {
    let mut rows = vec![0.0; 12 * n];
    for row in rows.chunks_exact_mut(12) {
        let size = 10.0_f32.powf(r.range(-6.0, 0.0));
        for _ in 0..6 {
            let (h, u, v) = (size * r.range(-1.0, 1.0), r.range(-2.5, 2.5), r.range(-2.5, 2.5));
            for (x, add) in row.iter_mut().zip([h, h * u, h * v, h * u * u, h * u * v, h * v * v]) {
                *x += add;
            }
            row[6..9].iter_mut().for_each(|x| *x += size * r.range(-1.0, 1.0));
            row[9] += 1.0;
        }
    }
    rows
}

/// The kernel's call for `input`, whose splats come from the forward's twin.
fn case(input: &RenderInput, camera: &Camera, output: u32, seed: u64) -> UntypedCase {
    let frame: Frame = input.frame(camera);
    let mut forward = input.deform_project(&frame);
    let spec = [vec![8], forward.spec.clone()].concat();
    let mut call =
        TwinCall { groups: [forward.groups, 1, 1], spec: &spec, push: &forward.push, buffers: &mut forward.buffers };
    (DEFORM_PROJECT.twin)(&mut call);
    let (n, mut r) = (input.count, Random(seed));
    let planes = parameter_planes(input.degree) as usize;
    let moment =
        |r: &mut Random, low: f32, high: f32| words(&(0..planes * n).map(|_| r.range(low, high)).collect::<Vec<_>>());
    let b = forward.buffers;
    UntypedCase {
        kernel: &DEFORM_PROJECT_BACKWARD,
        // Gradients of other losses at the centres come along in every other case.
        spec: vec![spec[1], spec[2], spec[3], output, (seed % 2) as u32],
        push: Vec::new(),
        buffers: vec![
            b[0].clone(),
            bytemuck::cast_slice(&[step(true)]).to_vec(),
            vec![0; 8],
            status::clear().to_vec(),
            b[11].clone(),
            b[12].clone(),
            words(&rows(n, &mut r)),
            b[1].clone(),
            b[2].clone(),
            b[3].clone(),
            b[4].clone(),
            b[5].clone(),
            b[6].clone(),
            b[7].clone(),
            b[8].clone(),
            b[9].clone(),
            b[10].clone(),
            moment(&mut r, -0.01, 0.01),
            moment(&mut r, 1e-4, 1e-2),
            vec![0; planes * n],
            vec![0; 6 * n],
            b[15].clone(),
            vec![0; 10 * n],
            vec![0; 2 * n],
            vec![0; n],
            words(&(0..3 * n).map(|_| r.range(-1e-3, 1e-3)).collect::<Vec<_>>()),
        ],
        groups: (n as u32).div_ceil(DEFORM_PROJECT_BACKWARD_THREADS).max(1),
    }
}

/// Relative L2 error and cosine.
fn agreement(gpu: &[f32], twin: &[f32]) -> (f64, f64) {
    let pair = || gpu.iter().zip(twin).map(|(&g, &t)| (f64::from(g), f64::from(t)));
    let sum = |f: fn((f64, f64)) -> f64| pair().map(f).sum::<f64>();
    let (error, norm, own) = (sum(|(g, t)| (g - t) * (g - t)), sum(|(_, t)| t * t), sum(|(g, _)| g * g));
    if norm == 0.0 {
        return (own.sqrt(), 1.0);
    }
    ((error / norm).sqrt(), sum(|(g, t)| g * t) / (norm * own).sqrt())
}

fn assert_agrees(what: &str, gpu: &[f32], twin: &[f32], context: &str) -> f64 {
    assert!(gpu.iter().all(|x| x.is_finite()), "{context}: {what} is not finite");
    let (error, cosine) = agreement(gpu, twin);
    assert!(error <= 1e-4 && cosine >= 0.9999, "{context}: {what}: relative L2 {error:e}, cosine {cosine}");
    error
}

/// Every kind of gradient within the bounds; reports exactly as the twin.
fn assert_gradients(result: &UntypedResult, input: &RenderInput, context: &str) {
    let n = input.count;
    let planes = |side: &[Vec<u32>], binding: usize, first: usize, count: usize| {
        floats(&side[binding][first * n..(first + count) * n])
    };
    let mut line = String::new();
    let mut check = |what: &str, binding: usize, first: usize, count: usize| {
        let (gpu, twin) = (planes(&result.gpu, binding, first, count), planes(&result.twin, binding, first, count));
        line += &format!(" {what} {:.0e}", assert_agrees(what, &gpu, &twin, context));
    };
    for (what, first, count) in kinds(input.degree) {
        check(what, at::GRADIENT, first, count);
    }
    if !input.pose.is_empty() {
        check("omega", at::POSE_GRADIENT, 0, 3);
        check("translation", at::POSE_GRADIENT, 3, 3);
    }
    if !input.nonrigid_offset.is_empty() {
        check("dx", at::OFFSET_GRADIENT, 0, 3);
        check("dq", at::OFFSET_GRADIENT, 3, 4);
        check("ds", at::OFFSET_GRADIENT, 7, 3);
    }
    check("density", at::DENSITY, 0, 1);
    assert_eq!(result.gpu[at::DENSITY][n..2 * n], result.twin[at::DENSITY][n..2 * n], "{context}: views");
    let radii = floats(&result.gpu[at::MAX_RADIUS][..n]).into_iter().zip(floats(&result.twin[at::MAX_RADIUS][..n]));
    let off = radii.filter(|(g, t)| g != t).inspect(|(g, t)| assert!((g - t).abs() <= 1.0 + 1e-5 * t)).count();
    assert!(off <= 1 + n / 500, "{context}: {off} radii differ");
    assert_eq!(result.gpu[at::STATUS], result.twin[at::STATUS], "{context}: status");
    let visible = result.gpu[at::TILE_COUNT][..n].iter().filter(|&&t| t > 0).count();
    println!("{context}: {visible} of {n} visible;{line}");
}

/// Static, moving, non-rigid, and both.
fn variants(n: usize, degree: u32, seed: u64) -> [(&'static str, RenderInput); 4] {
    let input = RenderInput::random(n, degree, seed);
    let moving = input.clone().moving(5, seed + 1);
    let both = moving.clone().nonrigid(seed + 2);
    [("static", input.clone()), ("moving", moving), ("non-rigid", input.nonrigid(seed + 3)), ("both", both)]
}

#[test]
fn gradients_of_random_gaussians() {
    let gpu = tests_harness::gpu();
    let counts: &[usize] = if tests_harness::small() { &[33, 1500] } else { &[1, 7, 8, 33, 127, 128, 129, 1500] };
    for (i, &n) in counts.iter().enumerate() {
        for (what, input) in variants(n, (i as u32 + 3) % 4, 100 + i as u64) {
            let result = case(&input, &test_camera(200, 150), OUTPUT_GRADIENT, i as u64).run(&gpu);
            assert_gradients(&result, &input, &format!("{what}, n = {n}, degree {}", input.degree));
        }
    }
}

#[test]
fn nothing_to_do_writes_nothing() {
    let gpu = tests_harness::gpu();
    case(&RenderInput::random(0, 3, 1), &test_camera(64, 48), OUTPUT_ADAM, 1).run(&gpu);
}

/// Needles, discs, dust, giants, Gaussians near the near plane and beside the image.
fn hard(n: usize, seed: u64) -> RenderInput {
    let mut input = RenderInput::random(n, 3, seed);
    let mut r = Random(seed);
    for g in 0..n {
        let base = r.range(-4.0, -1.0);
        let thin = -9.2; // ln 1e-4
        let scale = match g % 6 {
            0 => [base, base + thin, base + thin],
            1 => [base + 1.0, base + thin + 1.0, base + 1.0],
            2 => [-11.0, -12.0, -11.5],
            3 => [2.0, 1.0, 2.5],
            // Closer to a sphere, the rounding of exp decides the small difference that turns the Gaussian.
            4 => [base, base + 1e-2, base - 1e-2],
            _ => [base; 3],
        };
        (0..3).for_each(|c| input.log_scale[c * n + g] = scale[c]);
        if g % 5 == 0 {
            // Just behind the near plane of a camera at the origin that looks along z.
            let near = [r.range(-0.1, 0.1), r.range(-0.1, 0.1), r.range(0.2001, 0.3)];
            (0..3).for_each(|c| input.mean[c * n + g] = near[c]);
        } else {
            let place = [r.range(-3.0, 3.0), r.range(-2.0, 2.0), r.range(0.5, 4.0)];
            (0..3).for_each(|c| input.mean[c * n + g] = place[c]);
        }
    }
    input
}

#[test]
fn hard_shapes_keep_their_accuracy_one_by_one() {
    let gpu = tests_harness::gpu();
    let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.9, [300, 200]);
    for seed in 0..3 {
        let input = hard(3000, seed);
        let n = input.count;
        let result = case(&input, &camera, OUTPUT_GRADIENT, seed).run(&gpu);
        for (what, first, count) in kinds(3) {
            let of = |side: &[u32], g: usize| {
                (first..first + count).map(|p| f32::from_bits(side[p * n + g])).collect::<Vec<_>>()
            };
            let mut errors = Vec::new();
            for g in (0..n).filter(|&g| result.gpu[at::TILE_COUNT][g] > 0) {
                let (gpu, twin) = (of(&result.gpu[at::GRADIENT], g), of(&result.twin[at::GRADIENT], g));
                assert!(gpu.iter().all(|x| x.is_finite()), "{what} of {g}");
                errors.push(agreement(&gpu, &twin).0);
            }
            errors.sort_by(f64::total_cmp);
            let quantile = |q: f64| errors[((errors.len() - 1) as f64 * q) as usize];
            println!(
                "{what:14} of {} visible, error of one Gaussian: median {:.1e}, 99 % {:.1e}, worst {:.1e}",
                errors.len(),
                quantile(0.5),
                quantile(0.99),
                quantile(1.0)
            );
            assert!(quantile(0.5) < 1e-5 && quantile(0.99) < 1e-3, "{what}");
        }
        assert_gradients_of_kinds(&result, &input, &format!("hard shapes, seed {seed}"));
    }
}

fn assert_gradients_of_kinds(result: &UntypedResult, input: &RenderInput, context: &str) {
    let n = input.count;
    for (what, first, count) in kinds(input.degree) {
        let part = |side: &[Vec<u32>]| floats(&side[at::GRADIENT][first * n..(first + count) * n]);
        assert_agrees(what, &part(&result.gpu), &part(&result.twin), context);
    }
}

#[test]
fn far_from_the_origin() {
    let gpu = tests_harness::gpu();
    let shift = DVec3::new(1.0e5, -2.0e5, 5.0e4);
    let mut input = RenderInput::random(800, 3, 5);
    for (i, x) in input.mean.iter_mut().enumerate() {
        *x += shift[i / 800] as f32;
    }
    let mut camera = test_camera(160, 120);
    camera.position += shift + DVec3::splat(1.0e-3);
    let result = case(&input, &camera, OUTPUT_GRADIENT, 3).run(&gpu);
    assert_gradients(&result, &input, "a hundred thousand units from the origin");
}

/// Value of parameter plane `p` of Gaussian `g`.
fn parameter(buffers: &[Vec<u32>], p: usize, n: usize, g: usize) -> f32 {
    let (binding, k) = match p {
        0..3 => (at::MEAN, p),
        3..6 => (at::MEAN + 1, p - 3),
        6..10 => return f32::from_bits(buffers[at::ROTATION][4 * g + p - 6]),
        10 => (at::MEAN + 3, 0),
        11..14 => (at::SH, p - 11),
        14..23 => (at::SH + 1, p - 14),
        23..38 => (at::SH + 2, p - 23),
        _ => (at::SH + 3, p - 38),
    };
    f32::from_bits(buffers[binding][k * n + g])
}

#[test]
fn adam_takes_the_step_of_the_gradient() {
    let gpu = tests_harness::gpu();
    let cases = [(3, 600), (0, 33), (1, 129), (2, 257)];
    for (degree, n) in cases.into_iter().take(if tests_harness::small() { 1 } else { 4 }) {
        for (what, input) in variants(n, degree, 40 + u64::from(degree)) {
            let camera = test_camera(120, 90);
            let gradients = case(&input, &camera, OUTPUT_GRADIENT, 9).run(&gpu).gpu;
            let before = case(&input, &camera, OUTPUT_ADAM, 9).buffers;
            let result = case(&input, &camera, OUTPUT_ADAM, 9).run(&gpu);
            let step = step(true);
            let planes = parameter_planes(degree) as usize;
            let mut culled_moved = 0;
            for p in 0..planes {
                let rate = match p {
                    0..3 => step.rate_mean,
                    3..6 => step.rate_log_scale,
                    6..10 => step.rate_rotation,
                    10 => step.rate_opacity_logit,
                    11..14 => step.rate_sh_0,
                    _ => step.rate_sh_rest,
                };
                for g in 0..n {
                    let word = |side: &[Vec<u32>], binding: usize| f32::from_bits(side[binding][p * n + g]);
                    let mut moments = [word(&before, at::MOMENT_1), word(&before, at::MOMENT_2)];
                    let old = parameter(&before, p, n, g);
                    let slope = word(&gradients, at::GRADIENT);
                    let bias = step.bias_gaussians;
                    let new = engine::train::adam::update(&step, old, slope, &mut moments, rate, bias);
                    let found = parameter(&result.gpu, p, n, g);
                    assert!(
                        (found - new).abs() <= 1e-6 * (rate + new.abs()),
                        "{what}: plane {p} of {g}: {found} {new}"
                    );
                    for (binding, expected) in [(at::MOMENT_1, moments[0]), (at::MOMENT_2, moments[1])] {
                        let found = word(&result.gpu, binding);
                        assert!((found - expected).abs() <= 1e-5 * expected.abs() + 1e-9, "{what}: moment {p} of {g}");
                    }
                    culled_moved += usize::from(before[at::TILE_COUNT][g] == 0 && found != old);
                }
            }
            if n > 100 {
                assert!(culled_moved > planes, "{what}: culled Gaussians move on");
            }
            // The step itself, not the value that hides it.
            for (what, first, count) in kinds(degree) {
                let steps = |after: &[Vec<u32>]| -> Vec<f32> {
                    let one = |p: usize, g: usize| parameter(after, p, n, g) - parameter(&before, p, n, g);
                    (first..first + count).flat_map(|p| (0..n).map(move |g| (p, g))).map(|(p, g)| one(p, g)).collect()
                };
                let (error, cosine) = agreement(&steps(&result.gpu), &steps(&result.twin));
                assert!(error < 1e-3 && cosine > 0.9999, "{what}: step differs by {error:e}, cosine {cosine}");
            }
        }
    }
}

#[test]
fn a_failed_forward_changes_nothing() {
    let gpu = tests_harness::gpu();
    let input = RenderInput::random(200, 3, 8).moving(3, 4).nonrigid(5);
    for output in [OUTPUT_GRADIENT, OUTPUT_ADAM] {
        let mut failed = case(&input, &test_camera(100, 80), output, 2);
        failed.buffers[at::COUNTERS][COUNT_FAILED as usize] = 1;
        let before = failed.buffers.clone();
        let result = failed.run(&gpu);
        for (i, binding) in DEFORM_PROJECT_BACKWARD.bindings.iter().enumerate() {
            if binding.access != engine::gpu::kernel::Access::Write {
                assert!(result.gpu[i] == before[i], "{} changed", binding.name);
            }
        }
        result.assert_equal(&DEFORM_PROJECT_BACKWARD, "failed forward");
    }
}

#[test]
fn inactive_bands_are_left_alone() {
    let gpu = tests_harness::gpu();
    let input = RenderInput::random(300, 3, 8);
    for degree in 0..3_u32 {
        let mut part = case(&input, &test_camera(100, 80), OUTPUT_ADAM, 2);
        part.spec[0] = degree;
        let before = part.buffers.clone();
        let after = part.run(&gpu).gpu;
        for band in 0..4 {
            let same = after[at::SH + band] == before[at::SH + band];
            assert_eq!(same, band as u32 > degree, "band {band} at degree {degree}");
        }
        let first = parameter_planes(degree) as usize * 300;
        assert!(after[at::MOMENT_1][first..] == before[at::MOMENT_1][first..], "moments of inactive bands");
    }
}

const POISON: [f32; 24] = [
    f32::NAN,
    -f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    1e38,
    -1e38,
    1e30,
    -1e30,
    1e20,
    -1e20,
    1e15,
    -1e13,
    100.0,
    -100.0,
    1e-20,
    -1e-30,
    1e-38,
    -1e-38,
    1e-45,
    -1e-42,
    0.0,
    -0.0,
];

/// Buffers that can hold a poisoned float, with words per Gaussian and whether they are planes.
fn poison_slots(planes: usize) -> Vec<(usize, usize, bool)> {
    let mut slots = vec![(4, 12, false), (at::SPLAT_GRADIENT, 12, false), (at::ROTATION, 4, false)];
    slots.extend([(at::MEAN, 3, true), (at::MEAN + 1, 3, true), (at::MEAN + 3, 1, true)]);
    slots.extend([(at::SH, 3, true), (at::SH + 1, 9, true), (at::SH + 2, 15, true), (at::SH + 3, 21, true)]);
    slots.extend([(at::MOMENT_1, planes, true), (at::MOMENT_2, planes, true), (21, 10, true)]);
    slots.extend([(at::DENSITY, 2, true), (at::MAX_RADIUS, 1, true)]);
    slots
}

/// Puts `value` into slot number g of Gaussian g; every Gaussian counts as visible if the clean one was.
fn poison(buffers: &mut [Vec<u32>], n: usize, value: f32) {
    let slots = poison_slots(parameter_planes(3) as usize);
    let total: usize = slots.iter().map(|s| s.1).sum();
    for g in 0..n {
        let mut k = g % total;
        for &(binding, count, planes) in &slots {
            if k < count {
                buffers[binding][if planes { k * n + g } else { count * g + k }] = value.to_bits();
                break;
            }
            k -= count;
        }
    }
    // Some poses too: their superpoint's Gaussians all suffer.
    for k in 0..6 {
        buffers[12][8 * k + k % 3 + 4 * (k / 3)] = value.to_bits();
    }
}

fn run_poisoned(gpu: &Gpu, input: &RenderInput, value: f32, output: u32) {
    let n = input.count;
    let mut case = case(input, &test_camera(160, 120), output, 4);
    poison(&mut case.buffers, n, value);
    let before = case.buffers.clone();
    let after = case.run(gpu).gpu;
    let context = format!("{value:e}, output {output}");
    for binding in (at::MEAN..at::MEAN + 4).chain(at::SH..=at::MOMENT_2).chain([at::DENSITY, at::MAX_RADIUS]) {
        for (k, (b, a)) in before[binding].iter().zip(&after[binding]).enumerate() {
            let rotted = f32::from_bits(*b).is_finite() && !f32::from_bits(*a).is_finite();
            assert!(!rotted, "{context}: {} [{k}] rotted", DEFORM_PROJECT_BACKWARD.bindings[binding].name);
        }
    }
    for binding in [at::GRADIENT, at::POSE_GRADIENT, at::OFFSET_GRADIENT] {
        if binding == at::GRADIENT && output == OUTPUT_ADAM {
            continue;
        }
        let name = DEFORM_PROJECT_BACKWARD.bindings[binding].name;
        assert!(floats(&after[binding]).iter().all(|x| x.is_finite()), "{context}: {name} is not finite");
    }
    if !value.is_finite() {
        assert!(status::first(&after[at::STATUS]).is_some(), "{context}: nothing was reported");
    }
}

#[test]
fn poison_never_spreads() {
    let gpu = tests_harness::gpu();
    // Half of the superpoints keep clean poses.
    let input = RenderInput::random(700, 3, 21).moving(12, 5).nonrigid(6);
    for value in POISON {
        for output in [OUTPUT_GRADIENT, OUTPUT_ADAM] {
            run_poisoned(&gpu, &input, value, output);
        }
    }
}
