//! `deform_project_backward` on the device against its twin, which is the f64 reference.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod case;
mod poison;

use engine::gpu::interface::Buffers as _;
use engine::gpu::kernel::Access;
use engine::render::limits::COUNT_FAILED;
use engine::scene::Camera;
use engine::scene::parameter::{PARAMETERS, Present, REQUIRED, SMOOTHING, first_plane, planes};
use engine::train::deform_project_backward::{
    DEFORM_PROJECT_BACKWARD, DeformProjectBackward, OUTPUT_ADAM, OUTPUT_GRADIENT,
};
use glam::DVec3;
use tests_harness::KernelResult;
use tests_harness::render_case::{Random, RenderInput, test_camera};

use self::case::{Buffers, case, floats, given, kinds, step};

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
fn assert_gradients(result: &KernelResult<DeformProjectBackward>, input: &RenderInput, context: &str) {
    let n = input.count;
    let mut line = String::new();
    let mut check = |what: &str, buffer: fn(&Buffers) -> &Option<Vec<u32>>, first: usize, count: usize| {
        let part = |side: &Buffers| floats(&given(buffer(side))[first * n..(first + count) * n]);
        line += &format!(" {what} {:.0e}", assert_agrees(what, &part(&result.gpu), &part(&result.twin), context));
    };
    for (what, first, count) in kinds(input) {
        check(what, |b| &b.gradient, first, count);
    }
    if !input.pose.is_empty() {
        check("omega", |b| &b.pose_gradient, 0, 3);
        check("translation", |b| &b.pose_gradient, 3, 3);
    }
    if !input.nonrigid_offset.is_empty() {
        check("dx", |b| &b.nonrigid_gradient, 0, 3);
        check("dq", |b| &b.nonrigid_gradient, 3, 4);
        check("ds", |b| &b.nonrigid_gradient, 7, 3);
    }
    check("density", |b| &b.density, 0, 1);
    let [gpu, twin] = [&result.gpu, &result.twin];
    assert_eq!(given(&gpu.density)[n..2 * n], given(&twin.density)[n..2 * n], "{context}: views");
    let [gpu_radii, twin_radii] = [gpu, twin].map(|side| floats(&given(&side.max_radius)[..n]));
    let radii = gpu_radii.into_iter().zip(twin_radii);
    let off = radii.filter(|(g, t)| g != t).inspect(|(g, t)| assert!((g - t).abs() <= 1.0 + 1e-5 * t)).count();
    assert!(off <= 1 + n / 500, "{context}: {off} radii differ");
    assert_eq!(gpu.status, twin.status, "{context}: status");
    let visible = gpu.tile_count[..n].iter().filter(|&&t| t > 0).count();
    println!("{context}: {visible} of {n} visible;{line}");
}

/// Static, moving, non-rigid, both, moving with all optional parameters, antialiased with offsets, and by soft superpoints with and
/// without offsets.
fn variants(n: usize, degree: u32, seed: u64) -> [(&'static str, RenderInput); 8] {
    let input = RenderInput::random(n, degree, seed);
    let moving = input.clone().moving(5, seed + 1);
    let both = moving.clone().nonrigid(seed + 2);
    let soft = moving.clone().soft(2 + seed as usize % 3, seed + 5);
    let antialiased = both.clone().antialiased();
    let soft_both = both.clone().soft(3, seed + 6);
    let optional = moving.clone().with_optional(seed + 4);
    [
        ("static", input.clone()),
        ("moving", moving),
        ("non-rigid", input.nonrigid(seed + 3)),
        ("both", both),
        ("optional parameters", optional),
        ("antialiased", antialiased),
        ("soft superpoints", soft),
        ("soft superpoints, non-rigid", soft_both),
    ]
}

#[test]
fn gradients_of_random_gaussians() {
    let gpu = tests_harness::shared_gpu();
    let counts: &[usize] = if tests_harness::small() { &[33, 1500] } else { &[1, 7, 8, 33, 127, 128, 129, 1500] };
    for (i, &n) in counts.iter().enumerate() {
        let all = variants(n, (i as u32 + 3) % 4, 100 + i as u64);
        for (v, (what, input)) in all.into_iter().enumerate() {
            // Each variant of a degree is a pipeline, which takes seconds to compile: all with all bands, else half of them; in
            // small, each once.
            if v % 2 != i % 2 && (tests_harness::small() || input.degree != 3) {
                continue;
            }
            let result = case(&input, &test_camera(200, 150), OUTPUT_GRADIENT, i as u64).run(&gpu);
            assert_gradients(&result, &input, &format!("{what}, n = {n}, degree {}", input.degree));
        }
    }
}

#[test]
fn nothing_to_do_writes_nothing() {
    let gpu = tests_harness::shared_gpu();
    case(&RenderInput::random(0, 1, 1), &test_camera(64, 48), OUTPUT_ADAM, 1).run(&gpu);
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
    let gpu = tests_harness::shared_gpu();
    let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.9, [300, 200]);
    for seed in 0..3 {
        let input = hard(3000, seed);
        let n = input.count;
        let result = case(&input, &camera, OUTPUT_GRADIENT, seed).run(&gpu);
        for (what, first, count) in kinds(&input) {
            let of = |side: &[u32], g: usize| {
                (first..first + count).map(|p| f32::from_bits(side[p * n + g])).collect::<Vec<_>>()
            };
            let mut errors = Vec::new();
            for g in (0..n).filter(|&g| result.gpu.tile_count[g] > 0) {
                let (gpu, twin) = (of(given(&result.gpu.gradient), g), of(given(&result.twin.gradient), g));
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

fn assert_gradients_of_kinds(result: &KernelResult<DeformProjectBackward>, input: &RenderInput, context: &str) {
    let n = input.count;
    for (what, first, count) in kinds(input) {
        let part = |side: &Buffers| floats(&given(&side.gradient)[first * n..(first + count) * n]);
        assert_agrees(what, &part(&result.gpu), &part(&result.twin), context);
    }
}

#[test]
fn far_from_the_origin() {
    let gpu = tests_harness::shared_gpu();
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

/// The parameter that plane `p` belongs to.
fn parameter_of_plane(p: usize, present: Present) -> usize {
    let given = |i: usize| i < REQUIRED || present.has(i);
    let begun = |i: usize| first_plane(i, present) as usize <= p;
    (0..PARAMETERS.len()).rfind(|&i| given(i) && begun(i)).expect("planes begin at 0")
}

/// Value of parameter plane `p` of Gaussian `g`.
fn parameter(b: &Buffers, present: Present, p: usize, n: usize, g: usize) -> f32 {
    let required: [&[u32]; REQUIRED] = [
        &b.mean,
        &b.log_scale,
        &b.rotation,
        &b.opacity_logit,
        &b.sh_0,
        b.sh_1.as_deref().unwrap_or_default(),
        b.sh_2.as_deref().unwrap_or_default(),
        b.sh_3.as_deref().unwrap_or_default(),
    ];
    let i = parameter_of_plane(p, present);
    let k = p - first_plane(i, present) as usize;
    f32::from_bits(match required.get(i) {
        Some(words) => words[PARAMETERS[i].word(k, g, n)],
        None => given(&b.optional)[(present.planes_before(i) as usize + k) * n + g],
    })
}

#[test]
fn adam_takes_the_step_of_the_gradient() {
    let gpu = tests_harness::shared_gpu();
    let cases = [(3, 600), (0, 33), (1, 129), (2, 257)];
    for (degree, n) in cases.into_iter().take(if tests_harness::small() { 1 } else { 4 }) {
        // Each is two pipelines, which take seconds to compile: all with all bands, and each with one of the others; in small,
        // the last.
        let of_degree = |v: usize| {
            if tests_harness::small() { v == 7 } else { degree == 3 || v % 3 == degree as usize }
        };
        let all = variants(n, degree, 40 + u64::from(degree)).into_iter().enumerate();
        for (_, (what, input)) in all.filter(|(v, _)| of_degree(*v)) {
            let input = if tests_harness::small() { input.with_optional(44) } else { input };
            let camera = test_camera(120, 90);
            let gradients = case(&input, &camera, OUTPUT_GRADIENT, 9).run(&gpu).gpu;
            let before = case(&input, &camera, OUTPUT_ADAM, 9).buffers;
            let result = case(&input, &camera, OUTPUT_ADAM, 9).run(&gpu);
            let step = step(1.0);
            let present = input.optional.present();
            let mut culled_moved = 0;
            let of_kind = |(_, first, count): (_, usize, usize)| first..first + count;
            // The smoothing is measured, not learnt.
            let learnt = |(what, ..): &(&str, usize, usize)| *what != PARAMETERS[SMOOTHING].name;
            let planes: Vec<usize> = kinds(&input).into_iter().filter(learnt).flat_map(of_kind).collect();
            for &p in &planes {
                let rate = step.rate[parameter_of_plane(p, present)];
                for g in 0..n {
                    let word = |buffer: &Option<Vec<u32>>| f32::from_bits(given(buffer)[p * n + g]);
                    let mut moments = [word(&before.moment_1), word(&before.moment_2)];
                    let old = parameter(&before, present, p, n, g);
                    let slope = word(&gradients.gradient);
                    let bias = step.bias_gaussians;
                    let new = engine::train::adam::update(&step, old, slope, &mut moments, rate, bias);
                    let found = parameter(&result.gpu, present, p, n, g);
                    assert!(
                        (found - new).abs() <= 1e-6 * (rate + new.abs()),
                        "{what}: plane {p} of {g}: {found} {new}"
                    );
                    let after = [&result.gpu.moment_1, &result.gpu.moment_2];
                    for (found, expected) in after.map(word).into_iter().zip(moments) {
                        assert!((found - expected).abs() <= 1e-5 * expected.abs() + 1e-9, "{what}: moment {p} of {g}");
                    }
                    culled_moved += usize::from(before.tile_count[g] == 0 && found != old);
                }
            }
            if n > 100 {
                assert!(culled_moved > planes.len(), "{what}: culled Gaussians move on");
            }
            // The step itself, not the value that hides it.
            for (what, first, count) in kinds(&input).into_iter().filter(learnt) {
                let steps = |after: &Buffers| -> Vec<f32> {
                    let one =
                        |p: usize, g: usize| parameter(after, present, p, n, g) - parameter(&before, present, p, n, g);
                    (first..first + count).flat_map(|p| (0..n).map(move |g| (p, g))).map(|(p, g)| one(p, g)).collect()
                };
                let (error, cosine) = agreement(&steps(&result.gpu), &steps(&result.twin));
                assert!(error < 1e-3 && cosine > 0.9999, "{what}: step differs by {error:e}, cosine {cosine}");
            }
        }
    }
}

#[test]
fn the_smoothing_follows_the_photo_that_shows_most() {
    let gpu = tests_harness::shared_gpu();
    let (n, camera) = (257, test_camera(120, 90));
    let input = RenderInput::random(n, 3, 8).with_optional(11);
    let present = input.optional.present();
    let (moment, plane) = (first_plane(SMOOTHING, present) as usize, present.planes_before(SMOOTHING) as usize);
    // Pixels per world unit of an earlier photo: every third Gaussian was seen larger, every third smaller, the others never.
    let earlier = |g: usize| [1e4, 1.0, 0.0][g % 3];
    for rate in [0.0, 1.0] {
        let mut one = case(&input, &camera, OUTPUT_ADAM, 2);
        let mut step = step(1.0);
        step.rate[SMOOTHING] = rate;
        one.buffers.step = bytemuck::cast_slice(&[step]).to_vec();
        if let Some(words) = &mut one.buffers.moment_1 {
            (0..n).for_each(|g| words[moment * n + g] = f32::to_bits(earlier(g)));
        }
        let before = one.buffers.clone();
        let result = one.run(&gpu);
        let mut measured = 0;
        for g in 0..n {
            let mean = DVec3::from_array(std::array::from_fn(|k| f64::from(input.mean[k * n + g])));
            let z = (camera.rotation * (mean - camera.position)).z;
            let now = if before.tile_count[g] > 0 { (camera.fx.max(camera.fy) / z) as f32 } else { 0.0 };
            let most = now.max(earlier(g));
            let turn = rate == 1.0 && most > 0.0;
            let old = f32::from_bits(given(&before.optional)[plane * n + g]);
            let expected = if turn { [0.2_f32.sqrt() / most, 0.0] } else { [old, most] };
            for (side, b) in [("device", &result.gpu), ("twin", &result.twin)] {
                let found = [given(&b.optional)[plane * n + g], given(&b.moment_1)[moment * n + g]].map(f32::from_bits);
                let close = found.into_iter().zip(expected).all(|(f, e)| (f - e).abs() <= 1e-5 * e.abs());
                assert!(close, "{side}, Gaussian {g}, rate {rate}: {found:?}, expected {expected:?}");
            }
            measured += usize::from(now > earlier(g));
        }
        assert!(measured > n / 4, "{measured} of {n} are shown larger than before");
    }
}

#[test]
fn a_failed_forward_changes_nothing() {
    let gpu = tests_harness::shared_gpu();
    let mut input = RenderInput::random(200, 3, 8).moving(3, 4).nonrigid(5);
    if tests_harness::small() {
        // The pipelines of the test above.
        input = input.soft(3, 6).with_optional(7);
    }
    for output in [OUTPUT_GRADIENT, OUTPUT_ADAM] {
        let mut failed = case(&input, &test_camera(100, 80), output, 2);
        failed.buffers.counters[COUNT_FAILED as usize] = 1;
        let before = failed.buffers.clone().into_list();
        let result = failed.run(&gpu);
        result.assert_equal("failed forward");
        for ((binding, before), after) in
            DEFORM_PROJECT_BACKWARD.bindings.iter().zip(before).zip(result.gpu.into_list())
        {
            assert!(binding.access == Access::Write || after == before, "{} changed", binding.name);
        }
    }
}

#[test]
fn inactive_bands_are_left_alone() {
    let gpu = tests_harness::shared_gpu();
    let input = RenderInput::random(300, 3, 8);
    for degree in (0..3_u32).filter(|degree| !tests_harness::small() || *degree == 1) {
        let mut part = case(&input, &test_camera(100, 80), OUTPUT_ADAM, 2);
        part.constants.sh_degree = degree;
        let before = part.buffers.clone();
        let after = part.run(&gpu).gpu;
        let same = [
            after.sh_0 == before.sh_0,
            after.sh_1 == before.sh_1,
            after.sh_2 == before.sh_2,
            after.sh_3 == before.sh_3,
        ];
        for (band, same) in same.into_iter().enumerate() {
            assert_eq!(same, band as u32 > degree, "band {band} at degree {degree}");
        }
        let first = planes(degree, Present::default()) as usize * 300;
        assert!(given(&after.moment_1)[first..] == given(&before.moment_1)[first..], "moments of inactive bands");
    }
}
