//! The image loss on the device against its twins and against the f64 reference.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use engine::data::pixels::LEFT_OUT;
use engine::gpu::{Gpu, Memory};
use engine::reference::gradient::loss::image_loss;
use engine::render::frame::Frame;
use engine::scene::synthetic::Random;
use engine::train::image_loss::image_loss_sum::{IMAGE_LOSS_SUM, ImageLossSumBuffers, ImageLossSumConstants};
use engine::train::image_loss::ssim_forward::{SSIM_FORWARD, SsimForwardBuffers, SsimForwardConstants};
use engine::train::image_loss::*;
use engine::train::status;
use engine::train::step::Step;
use tests_harness::{KernelCase, TestGpu, widths};

const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.125];

fn frame(size: [u32; 2]) -> Frame {
    let [r, g, b] = BACKGROUND;
    Frame { background: [r, g, b], size, ..Frame::default() }
}

/// Words of other photos before the target.
const OTHERS: usize = 3;

fn step(lambda: f32) -> Step {
    Step { weight_dssim: lambda, photo: OTHERS as u32, ..Step::default() }
}

/// The target behind the words of other photos, which are no numbers.
fn behind_others(target: &[u32]) -> Vec<u32> {
    [&[u32::MAX; OTHERS], target].concat()
}

fn words<T: bytemuck::Pod>(values: &[T]) -> Vec<u32> {
    bytemuck::pod_collect_to_vec(values)
}

/// Rendered image (vec4) and target (RGBA8), smooth with noise and flat parts, as pictures are.
fn images(size: [u32; 2], seed: u64) -> (Vec<f32>, Vec<u32>) {
    let mut random = Random::new(seed);
    let mut color = Vec::new();
    let mut target = Vec::new();
    for i in 0..size[0] * size[1] {
        let (x, y) = (f64::from(i % size[0]), f64::from(i / size[0]));
        let alpha = if x + y < 20.0 { 255 } else { random.below(256) as u32 };
        let mut word = alpha << 24;
        for c in 0..3 {
            let wave = 0.5 + 0.4 * (0.3 * x + 0.2 * y * (c + 1) as f64).sin();
            color.push((wave + 0.1 * random.normal()) as f32);
            word |= ((wave * f64::from(alpha)) as u32).min(alpha) << (8 * c);
        }
        color.push(random.uniform() as f32);
        target.push(word);
    }
    (color, target)
}

/// Target values as the definition says, from RGBA8.
fn target_values(target: &[u32]) -> Vec<f64> {
    let value = |word: &u32, c: usize| {
        let rest = 1.0 - f64::from(word >> 24) / 255.0;
        f64::from((word >> (8 * c)) & 255) / 255.0 + rest * f64::from(BACKGROUND[c])
    };
    target.iter().flat_map(|word| [value(word, 0), value(word, 1), value(word, 2)]).collect()
}

/// Every kernel of the chain against its twin, on what the device's own kernels before it left, both ways of sharing the
/// pixels out. Gradient and loss of the device's own way.
fn chain(gpu: &Gpu, size: [u32; 2], lambda: f32, color: &[u32], target: &[u32], kind: u32) -> (Vec<f32>, Vec<f32>) {
    let own = LossStage::of(gpu);
    let other = if own == LossStage::Strip { LossStage::Shared } else { LossStage::Strip };
    chain_of(gpu, other, size, lambda, [color, target], kind);
    chain_of(gpu, own, size, lambda, [color, target], kind)
}

/// How far the SSIM maps may be from the twin's, relative L2. Where nearly all of a variance cancels (values within 0.01), a compiler
/// that fuses products into sums rounds it otherwise: 2.4e-4 on an H200. The gradient is held against f64 everywhere.
fn maps_bound(color: &[u32]) -> f64 {
    let (low, high) = words_to_floats(color).iter().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
    if high - low < 0.011 { 3e-4 } else { 2e-4 }
}

fn chain_of(
    gpu: &Gpu,
    stage: LossStage,
    size: [u32; 2],
    lambda: f32,
    [color, target]: [&[u32]; 2],
    kind: u32,
) -> (Vec<f32>, Vec<f32>) {
    let pixels = (size[0] * size[1]) as usize;
    // More workgroups than are needed must not matter.
    let needed = stage.groups(size[0], size[1]);
    let (n, stage) = (needed + 1, stage as u32);
    let (frame, step) = (words(&[frame(size)]), words(&[step(lambda)]));
    let with_ssim = u32::from(lambda != 0.0);
    let context = format!("{size:?}, target {kind}, SSIM {with_ssim}, stage {stage}");
    let partial = || vec![0; 3 * needed as usize];
    let mut ssim_maps = None;
    let mut sums = partial();
    if with_ssim == 1 {
        let buffers = SsimForwardBuffers {
            frame: frame.clone(),
            color: color.to_vec(),
            target: behind_others(target),
            ssim_maps: vec![0; map_words(size[0], size[1]) as usize],
            loss_partial: partial(),
            step: step.clone(),
        };
        let constants = SsimForwardConstants { target: kind, stage };
        let done = KernelCase { kernel: &SSIM_FORWARD, constants, push: (), buffers, groups: n }.run(gpu);
        done.assert_equal(&context);
        let relative = relative_l2(&words_to_floats(&done.gpu.ssim_maps), &words_to_floats(&done.twin.ssim_maps));
        assert!(relative < maps_bound(color), "{size:?}: maps {relative:e} from the twin");
        (sums, ssim_maps) = (done.gpu.loss_partial, Some(done.gpu.ssim_maps));
    }
    let buffers = ImageLossBuffers {
        frame: frame.clone(),
        step: step.clone(),
        color: color.to_vec(),
        target: behind_others(target),
        ssim_maps,
        image_gradient: vec![0; 4 * pixels],
        loss_partial: partial(),
        status: status::clear().to_vec(),
    };
    let constants = ImageLossConstants { target: kind, with_ssim, stage };
    let done = KernelCase { kernel: &IMAGE_LOSS, constants, push: (), buffers, groups: n }.run(gpu);
    done.assert_equal(&context);
    sums[needed as usize..].copy_from_slice(&done.gpu.loss_partial[needed as usize..]);
    let gradient = words_to_floats(&done.gpu.image_gradient);
    let twin = words_to_floats(&done.twin.image_gradient);
    let relative = relative_l2(&gradient, &twin);
    assert!(relative < 1e-4, "{size:?}: gradient {relative:e} from the twin");
    let buffers = ImageLossSumBuffers { frame, step, loss_partial: sums, loss: vec![0; 8] };
    let constants = ImageLossSumConstants { with_ssim, stage };
    let loss = KernelCase { kernel: &IMAGE_LOSS_SUM, constants, push: (), buffers, groups: 1 }.check(gpu, &context);
    (gradient, words_to_floats(&loss.loss))
}

fn words_to_floats(words: &[u32]) -> Vec<f32> {
    words.iter().map(|w| f32::from_bits(*w)).collect()
}

fn relative_l2(test: &[f32], truth: &[f32]) -> f64 {
    let (mut error, mut norm) = (0.0, 0.0);
    for (a, b) in test.iter().zip(truth) {
        error += (f64::from(*a) - f64::from(*b)).powi(2);
        norm += f64::from(*b).powi(2);
    }
    (error / f64::max(norm, f64::MIN_POSITIVE)).sqrt()
}

/// The whole loss as the trainer runs it.
fn device_loss(
    gpu: &Gpu,
    size: [u32; 2],
    lambda: f32,
    color: &[u32],
    target: &[u32],
) -> (Vec<f32>, Vec<f32>, Vec<u32>) {
    let pixels = u64::from(size[0] * size[1]);
    let upload = |name: &str, words: &[u32]| gpu.buffer_with(name, bytemuck::cast_slice(words)).unwrap();
    let frame = upload("frame", &words(&[frame(size)]));
    let step = upload("step", &words(&[step(lambda)]));
    let (color, photo) = (upload("color", color), upload("target", &behind_others(target)));
    let image_gradient = gpu.buffer("image_gradient", 16 * pixels, Memory::Device).unwrap();
    let loss = gpu.buffer("loss", 32, Memory::Device).unwrap();
    let status = upload("status", &status::clear());
    let image_loss = LossPass::new(gpu, size[0], size[1], lambda != 0.0).unwrap();
    let buffers = LossPassBuffers {
        frame: &frame,
        step: &step,
        color: &color,
        target: &photo,
        image_gradient: &image_gradient,
        loss: &loss,
        status: &status,
    };
    let mut r = gpu.recorder("image loss");
    let masked = target.contains(&LEFT_OUT);
    let format = if masked { TargetFormat::MaskedRgba8 } else { TargetFormat::Rgba8 };
    image_loss.record(&mut r, &buffers, format).unwrap();
    gpu.run(r).unwrap();
    let floats =
        |b, n| bytemuck::pod_collect_to_vec::<u8, f32>(&gpu.download(engine::gpu::Buffer::slice(b, 0, n)).unwrap());
    let report = bytemuck::pod_collect_to_vec(&gpu.download(status.slice(0, 4 * status::STATUS_WORDS as u64)).unwrap());
    (floats(&image_gradient, 16 * pixels), floats(&loss, 32), report)
}

fn check_against_truth(gpu: &TestGpu, size: [u32; 2], lambda: f32, seed: u64) {
    let (color, target) = images(size, seed);
    let (gradient, loss) = chain(gpu, size, lambda, &words(&color), &target, 0);
    let image: Vec<f64> = color.iter().enumerate().filter(|(i, _)| i % 4 != 3).map(|(_, v)| f64::from(*v)).collect();
    let size_f64 = size.map(|s| s as usize);
    let truth = image_loss(&image, &target_values(&target), size_f64, f64::from(lambda));
    assert!(gradient.iter().skip(3).step_by(4).all(|w| *w == 0.0));
    let rgb: Vec<f32> = gradient.iter().enumerate().filter(|(i, _)| i % 4 != 3).map(|(_, v)| *v).collect();
    let expected: Vec<f32> = truth.gradient.iter().map(|g| *g as f32).collect();
    let error = relative_l2(&rgb, &expected);
    assert!(error <= 1e-4, "{size:?} λ {lambda}: gradient relative error {error:e}");
    let ssim = if lambda == 0.0 { 0.0 } else { truth.ssim };
    for (i, value) in [truth.loss, truth.l1, ssim, truth.mse, 0.0, 0.0, 0.0, 0.0].into_iter().enumerate() {
        let error = (f64::from(loss[i]) - value).abs();
        assert!(error <= 1e-5 * value.abs().max(0.1), "{size:?} λ {lambda}: loss[{i}] {} against {value}", loss[i]);
    }
    println!("{size:?} λ {lambda}: gradient relative error {error:.2e}, loss {:?}", &loss[..4]);
}

#[test]
fn loss_and_gradient_equal_twins_and_truth() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    let sizes = [[1, 1], [1, 40], [3, 2], [16, 5], [31, 33], [32, 32], [33, 70], [97, 64], [130, 41]];
    for (i, size) in sizes.into_iter().enumerate().filter(|(i, _)| !tests_harness::small() || i % 3 != 0) {
        check_against_truth(&gpu, size, [0.2, 0.2, 1.0][i % 3], 100 + i as u64);
        check_against_truth(&gpu, size, 0.0, 200 + i as u64);
    }
}

/// What a mask leaves out has no gradient, and for its neighbours the photo is there what was rendered.
#[test]
fn pixels_that_a_mask_leaves_out_take_no_part() {
    let gpu = tests_harness::shared_gpu();
    let size = [45, 38];
    let (color, mut target) = images(size, 21);
    let left_out = |i: usize| (i % 45 > 30 && i / 45 < 20) || i.is_multiple_of(97);
    (0..target.len()).filter(|i| left_out(*i)).for_each(|i| target[i] = LEFT_OUT);
    let image: Vec<f64> = color.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from).collect();
    let mut shown = target_values(&target);
    (0..shown.len()).filter(|i| left_out(i / 3)).for_each(|i| shown[i] = image[i]);
    for lambda in [0.0, 0.2, 1.0] {
        let masked = TargetFormat::MaskedRgba8 as u32;
        let (gradient, loss) = chain(&gpu, size, lambda, &words(&color), &target, masked);
        let mut truth = image_loss(&image, &shown, [45, 38], f64::from(lambda));
        (0..shown.len()).filter(|i| left_out(i / 3)).for_each(|i| truth.gradient[i] = 0.0);
        let rgb: Vec<f32> = gradient.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        assert!((0..rgb.len()).all(|i| rgb[i] == 0.0 || !left_out(i / 3)));
        let error = relative_l2(&rgb, &truth.gradient.iter().map(|g| *g as f32).collect::<Vec<_>>());
        assert!(error <= 1e-4, "λ {lambda}: {error:e}");
        assert!((f64::from(loss[0]) - truth.loss).abs() < 1e-6, "λ {lambda}: {} against {}", loss[0], truth.loss);
        assert!((f64::from(loss[3]) - truth.mse).abs() < 1e-6);
    }
}

/// A rendered value that is not finite is reported where a mask leaves the pixel out, too.
#[test]
fn nan_behind_a_mask_is_reported() {
    let gpu = tests_harness::shared_gpu();
    let size = [20, 12];
    let (mut color, mut target) = images(size, 23);
    target[50] = LEFT_OUT;
    color[4 * 50 + 1] = f32::NAN;
    let (gradient, loss, report) = device_loss(&gpu, size, 0.2, &words(&color), &target);
    assert!(gradient.iter().all(|g| g.is_finite()) && loss[0].is_finite());
    assert_eq!(report[2 * status::IMAGE_GRADIENT..][..2], [1, 50]);
    chain(&gpu, size, 0.2, &words(&color), &target, TargetFormat::MaskedRgba8 as u32);
}

#[test]
fn flat_bright_images_keep_their_digits() {
    // Variances far below C2 between moments near 1: the worst case of the cancellation.
    let gpu = tests_harness::shared_gpu();
    let (size, mut random) = ([70, 66], Random::new(5));
    let color: Vec<f32> = (0..4 * 70 * 66).map(|_| 0.98 + 0.01 * random.uniform() as f32).collect();
    let target = vec![0xfffd_fbfc; 70 * 66];
    let (gradient, _) = chain(&gpu, size, 1.0, &words(&color), &target, 0);
    let image: Vec<f64> = color.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from).collect();
    let truth = image_loss(&image, &target_values(&target), [70, 66], 1.0).gradient;
    let rgb: Vec<f32> = gradient.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let error = relative_l2(&rgb, &truth.iter().map(|g| *g as f32).collect::<Vec<_>>());
    println!("flat and bright: {error:.2e}");
    assert!(error < 5e-4, "{error:e}");
}

#[test]
fn float_targets() {
    let gpu = tests_harness::shared_gpu();
    let size = [37, 34];
    let (color, _) = images(size, 7);
    let (target, _) = images(size, 8);
    let (gradient, loss) = chain(&gpu, size, 0.2, &words(&color), &words(&target), 1);
    let rgb = |v: &[f32]| v.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from).collect::<Vec<_>>();
    let truth = image_loss(&rgb(&color), &rgb(&target), [37, 34], f64::from(0.2_f32));
    let gradient: Vec<f32> = rgb(&gradient).iter().map(|v| *v as f32).collect();
    assert!(relative_l2(&gradient, &truth.gradient.iter().map(|g| *g as f32).collect::<Vec<_>>()) < 1e-4);
    assert!((f64::from(loss[0]) - truth.loss).abs() < 1e-6);
}

/// Images of usual sizes have more workgroups than the one that adds their sums has threads.
#[test]
fn sums_of_more_workgroups_than_threads() {
    let gpu = tests_harness::shared_gpu();
    let size = [800, 800];
    let stage = LossStage::Shared;
    let n = stage.groups(size[0], size[1]);
    assert!(n > 2 * IMAGE_LOSS_SUM.kernel.local_size);
    let mut random = Random::new(17);
    let sums: Vec<f32> = (0..3 * n).map(|_| random.uniform() as f32).collect();
    for with_ssim in [0, 1] {
        let buffers = ImageLossSumBuffers {
            frame: words(&[frame(size)]),
            step: words(&[step(0.2)]),
            loss_partial: words(&sums),
            loss: vec![0; 8],
        };
        let constants = ImageLossSumConstants { with_ssim, stage: stage as u32 };
        let case = KernelCase { kernel: &IMAGE_LOSS_SUM, constants, push: (), buffers, groups: 1 };
        case.check(&gpu, &format!("{n} workgroups, SSIM {with_ssim}"));
    }
}

/// Whatever is in the images, gradient and loss are finite, bad pixels are reported, and pixels out of reach of a bad one
/// keep their gradient.
#[test]
fn poison_stays_where_it_is() {
    let gpu = tests_harness::shared_gpu();
    let size = [50, 40];
    let (clean, target) = images(size, 11);
    for lambda in [0.0, 0.2] {
        let (before, _) = chain(&gpu, size, lambda, &words(&clean), &target, 0);
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -3e38, 1.01e6, f32::MIN_POSITIVE / 3.0, -0.0];
        for (k, value) in bad.into_iter().take(if tests_harness::small() { 3 } else { 8 }).enumerate() {
            let (pixel, channel) = (20 * 50 + 25 + k, k % 3);
            let mut color = words(&clean);
            color[4 * pixel + channel] = value.to_bits();
            let (gradient, loss) = chain(&gpu, size, lambda, &color, &target, 0);
            assert!(gradient.iter().chain(&loss).all(|g| g.is_finite()), "{value}");
            let unusable = value.is_nan() || value.abs() > MAX_COLOR;
            if unusable {
                assert_eq!(gradient[4 * pixel + channel], 0.0);
            }
            let report = device_loss(&gpu, size, lambda, &color, &target).2;
            let expected = unusable.then_some(("image gradient", 1, pixel as u32));
            assert_eq!(status::first(&report), expected, "{value}");
            let (mut changed, mut worst) = (0, 0.0_f32);
            for i in 0..before.len() {
                let (x, y) = ((i / 4) % 50, i / 4 / 50);
                let reach = x.abs_diff(pixel % 50).max(y.abs_diff(pixel / 50));
                if i % 4 != channel || reach > 10 {
                    assert_eq!(gradient[i].to_bits(), before[i].to_bits(), "{value} reaches {x}, {y}");
                } else {
                    changed += usize::from(gradient[i] != before[i]);
                    worst = worst.max((gradient[i] - before[i]).abs());
                }
            }
            let largest = before.iter().fold(0.0, |m: f32, g| m.max(g.abs()));
            assert!(changed <= 21 * 21 && worst <= 4.0 * largest, "{value}: {worst} of {largest}");
        }
        let color = vec![f32::NAN.to_bits(); clean.len()];
        let (gradient, loss) = chain(&gpu, size, lambda, &color, &target, 0);
        assert!(gradient.iter().all(|g| *g == 0.0) && loss.iter().all(|l| l.is_finite()));
    }
    // A huge usable value keeps everything finite.
    let mut color = words(&clean);
    color[4 * 777] = MAX_COLOR.to_bits();
    let (gradient, loss) = chain(&gpu, size, 0.2, &color, &target, 0);
    assert!(gradient.iter().chain(&loss).all(|g| g.is_finite()));
}

#[test]
fn runs_are_bit_identical_and_equal_the_parts() {
    let gpu = tests_harness::shared_gpu();
    let size = [101, 77];
    let (color, target) = images(size, 21);
    let first = device_loss(&gpu, size, 0.2, &words(&color), &target);
    for _ in 0..3 {
        assert!(device_loss(&gpu, size, 0.2, &words(&color), &target) == first);
    }
    // The executable model rounds otherwise than the device.
    if tests_harness::model::options().is_none() {
        let (gradient, loss) = chain(&gpu, size, 0.2, &words(&color), &target, 0);
        assert!(gradient == first.0 && loss == first.1);
    }
}

#[test]
fn independent_automatic_differentiation_agrees() {
    let Some(path) = tests_harness::data("oracle/loss_61x47.npz") else { return };
    let gpu = tests_harness::shared_gpu();
    assert!(tools::dev::oracle::loss::is_loss_file(&path).unwrap());
    let check = tools::dev::oracle::loss::check(&path, Some(&gpu)).unwrap();
    println!("{}", check.describe());
    assert!(check.passes(), "{}", check.describe());
}
