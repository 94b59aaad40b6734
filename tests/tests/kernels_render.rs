//! `deform_project`, `blend` and `deform_network` on the device against their twins.

use engine::gpu::Kernel;
use engine::gpu::kernel::TwinCall;
use engine::image::difference;
use engine::reference::{self, ReferenceOptions};
use engine::render::blend::{self, BLEND, BLEND_PACKED, PixelFormat, Stage};
use engine::render::blend_image::{BLEND_RGBA8, BLEND_RGBA16F, BLEND_RGBA32F};
use engine::render::deform_network::{self, DEFORM_NETWORK};
use engine::render::deform_project::DEFORM_PROJECT;
use engine::render::frame::Frame;
use engine::render::rate::{ARITHMETIC_RATE, ARITHMETIC_RATE_THREADS, ArithmeticRatePush, arithmetic_rate};
use engine::scene::network::DeformSize;
use engine::scene::{Camera, DeformNetwork, Linear};
use glam::DVec3;
use tests_harness::kernel_case::POISON;
use tests_harness::render_case::{Random, RenderInput, test_camera, tile_lists};
use tests_harness::{TestGpu, UntypedCase, UntypedResult};

const SIZES: [usize; 11] = [0, 1, 7, 8, 31, 32, 33, 255, 256, 257, 65_537];

/// Counts and block sums follow the tile counts, which may flip within the tolerance: the sums must equal the device's own
/// tile counts, and those may differ from the twin's in few places.
fn assert_deform_project(result: &UntypedResult, n: usize, context: &str) {
    let (mut gpu, twin) = (result.gpu.clone(), &result.twin);
    gpu[12].truncate(n);
    gpu[11].truncate(12 * n);
    let flips = (0..n).filter(|&g| gpu[12][g] != twin[12][g]).count();
    let allowed = 1 + n / 1000;
    assert!(flips <= allowed, "{context}: {flips} tile counts of {n} differ");
    let visible = gpu[12].iter().filter(|&&t| t > 0).count() as u32;
    let instances: u64 = gpu[12].iter().map(|&t| u64::from(t)).sum();
    assert_eq!(gpu[14][0], visible, "{context}: visible");
    assert_eq!(u64::from(gpu[14][1]) | u64::from(gpu[14][2]) << 32, instances, "{context}: instances");
    assert!(gpu[14][4].abs_diff(twin[14][4]) <= allowed as u32, "{context}: {} {} rejected", gpu[14][4], twin[14][4]);
    let blocks = n.div_ceil(256).max(1);
    for (b, tiles) in gpu[12].chunks(256).enumerate() {
        let in_block = tiles.iter().filter(|&&t| t > 0).count() as u32;
        assert_eq!(gpu[13][b], in_block, "{context}: block {b}");
    }
    for s in 0..blocks.div_ceil(256) {
        let sum: u32 = gpu[13][256 * s..blocks.min(256 * (s + 1))].iter().sum();
        assert_eq!(gpu[13][blocks + s], sum, "{context}: super sum {s}");
    }
    let mut worst = 0.0_f32;
    for k in 0..gpu[11].len() {
        if gpu[12][k / 12] > 0 && twin[12][k / 12] > 0 {
            let (g, t) = (f32::from_bits(gpu[11][k]), f32::from_bits(twin[11][k]));
            assert!(g.is_finite(), "{context}: splat word {k} is {g}");
            let relative = (g - t).abs() / (1.0 + t.abs());
            worst = worst.max(relative);
        }
    }
    assert!(worst < 1e-3, "{context}: splats differ by {worst:e}");
    println!("{context}: {visible} of {n} visible, {instances} instances, splats within {worst:.1e}, {flips} flips");
}

#[test]
fn deform_project_of_random_gaussians() {
    let gpu = tests_harness::gpu();
    for (i, n) in SIZES.into_iter().enumerate() {
        let degree = i as u32 % 4;
        let input = RenderInput::random(n, degree, i as u64);
        let frame = input.frame(&test_camera(400, 300));
        assert_deform_project(&input.deform_project(&frame).run(&gpu), n, &format!("static, n = {n}, degree {degree}"));
        let input = input.moving(13, 5 + i as u64);
        let frame = input.frame(&test_camera(400, 300));
        assert_deform_project(&input.deform_project(&frame).run(&gpu), n, &format!("moving, n = {n}, degree {degree}"));
        let input = input.nonrigid(9 + i as u64);
        assert_deform_project(&input.deform_project(&frame).run(&gpu), n, &format!("non-rigid, n = {n}"));
    }
}

#[test]
fn deform_project_of_nasty_gaussians() {
    let gpu = tests_harness::gpu();
    for seed in 0..4 {
        let mut input = RenderInput::random(5000, 3, seed).moving(7, seed);
        input.spoil(seed);
        let frame = input.frame(&test_camera(333, 211));
        let result = input.deform_project(&frame).run(&gpu);
        assert!(result.gpu[14][4] > 100, "only {} rejected", result.gpu[14][4]);
        assert_deform_project(&result, 5000, &format!("nasty, seed {seed}"));
    }
    // Every slot poisoned: nothing is drawn, everything is counted, nothing hangs.
    let mut input = RenderInput::random(777, 3, 1);
    for v in [&mut input.mean, &mut input.log_scale, &mut input.rotation, &mut input.opacity_logit] {
        v.fill(f32::from_bits(tests_harness::kernel_case::POISON));
    }
    let frame = input.frame(&test_camera(64, 64));
    let result = input.deform_project(&frame).run(&gpu);
    assert_eq!(result.gpu[14][..5], [0, 0, 0, 0, 777]);
}

fn blend_case(frame: &Frame, splats: &[u32], tile_count: &[u32], spec: [u32; 3], size: u32) -> UntypedCase {
    let (ranges, values) = tile_lists(frame, splats, tile_count);
    let pixels = frame.pixels();
    UntypedCase {
        kernel: &BLEND,
        spec: [&spec[..], &[0; 4]].concat(),
        push: Vec::new(),
        buffers: vec![
            bytemuck::cast_slice(&[*frame]).to_vec(),
            ranges,
            values,
            splats.to_vec(),
            vec![0; 4 * pixels],
            vec![0; if spec[0] == 1 { pixels } else { 4 }],
            Vec::new(),
        ],
        groups: blend::groups(frame.tile_count, size, spec[2]) as u32,
    }
}

/// The same case with values that are slots, in some order.
fn with_slots(mut case: UntypedCase) -> UntypedCase {
    let count = case.buffers[2].len() as u32;
    case.spec[3] = 1;
    case.buffers[6] = case.buffers[2].iter().rev().copied().collect();
    case.buffers[2] = (0..count).rev().collect();
    case
}

fn twin_splats(input: &RenderInput, frame: &Frame) -> (Vec<u32>, Vec<u32>) {
    let mut case = input.deform_project(frame);
    let mut call = TwinCall {
        groups: [case.groups, 1, 1],
        spec: &[8, input.degree, u32::from(!input.pose.is_empty()), u32::from(!input.nonrigid_offset.is_empty())],
        push: &case.push,
        buffers: &mut case.buffers,
    };
    (DEFORM_PROJECT.twin)(&mut call);
    (case.buffers.swap_remove(11), case.buffers.swap_remove(12))
}

fn assert_blend(result: &UntypedResult, kernel: &'static Kernel, context: &str) {
    result.assert_equal(kernel, context);
    assert!(result.gpu[4].iter().all(|w| f32::from_bits(*w).is_finite()), "{context}: a pixel was not written");
}

#[test]
fn blend_matches_its_twin() {
    let gpu = tests_harness::gpu();
    let size = gpu.subgroup_size_of(&BLEND);
    let usual = blend::pixels_per_lane(size);
    for (n, width, height) in [(0, 33, 17), (1, 1, 1), (300, 64, 64), (3000, 150, 91), (2000, 17, 200)] {
        let input = RenderInput::random(n, 1, n as u64);
        let frame = input.frame(&test_camera(width, height));
        let (splats, tile_count) = twin_splats(&input, &frame);
        for stage in [Stage::Shuffle, Stage::Shared, Stage::Reread] {
            for depth in [0, 1] {
                let mut lanes = vec![usual];
                if blend::subtile(size, 2 * usual)[2] <= 16 && usual < 16 {
                    lanes.push(2 * usual);
                }
                if usual > 1 {
                    lanes.push(usual / 2);
                }
                for per_lane in lanes {
                    let spec = [depth, stage as u32, per_lane];
                    let case = blend_case(&frame, &splats, &tile_count, spec, size);
                    let slots = (per_lane == usual && depth == 0).then(|| with_slots(case.clone()).run(&gpu));
                    let result = case.run(&gpu);
                    if let Some(slots) = slots {
                        assert_eq!(slots.gpu[4], result.gpu[4], "slots change the image");
                        assert_eq!(slots.twin[4], result.twin[4], "slots change the twin's image");
                    }
                    let context = format!("n = {n}, {width}x{height}, spec {spec:?}");
                    if depth == 0 {
                        let mut result = result;
                        result.gpu.truncate(5);
                        result.twin.truncate(5);
                        result.gpu.push(Vec::new());
                        result.twin.push(Vec::new());
                        assert_blend(&result, &BLEND, &context);
                    } else {
                        assert_blend(&result, &BLEND, &context);
                    }
                }
            }
        }
    }
}

#[test]
fn blend_packed_stores_what_its_twin_stores() {
    let gpu = tests_harness::gpu();
    let size = gpu.subgroup_size_of(&BLEND);
    let input = RenderInput::random(800, 1, 5);
    let frame = input.frame(&test_camera(75, 53));
    let (splats, tile_count) = twin_splats(&input, &frame);
    for format in [PixelFormat::Rgba8, PixelFormat::Bgra8, PixelFormat::Rgba16F] {
        let spec = [1, Stage::of_device(&gpu) as u32, blend::pixels_per_lane(size)];
        let mut case = blend_case(&frame, &splats, &tile_count, spec, size);
        let words = format.bytes() as usize / 4;
        case.kernel = &BLEND_PACKED;
        case.spec.push(format as u32);
        case.buffers[4] = vec![0; words * frame.pixels()];
        let mut result = case.run(&gpu);
        let step = if words == 1 { 1.01 / 255.0 } else { 1.0 / 1024.0 };
        let pairs = result.gpu[4].chunks_exact(words).zip(result.twin[4].chunks_exact(words));
        let off = pairs.filter(|(g, t)| {
            let (g, t) = (format.unpack(g), format.unpack(t));
            g.iter().zip(t).any(|(g, t)| (g - t).abs() > step * t.abs().max(1.0))
        });
        assert!(off.count() as f32 <= BLEND_PACKED.tolerance.flips * frame.pixels() as f32, "{format:?}");
        let lit = result.gpu[4].chunks_exact(words).filter(|g| format.unpack(g)[3] > 0.5).count();
        assert!(lit > frame.pixels() / 20, "{format:?}: {lit} pixels are covered");
        // Depth as usual; pixels were compared by level above.
        result.gpu[4].clone_from(&result.twin[4]);
        result.assert_equal(&BLEND_PACKED, &format!("{format:?}"));
    }
}

/// The kernels themselves are compared by the pictures that hosts get (`embed` of the engine): their images are a host's.
#[test]
fn twins_that_store_to_an_image_store_what_those_of_buffers_do() {
    let input = RenderInput::random(800, 1, 5);
    let frame = input.frame(&test_camera(75, 53));
    let (splats, tile_count) = twin_splats(&input, &frame);
    let size = 32;
    let spec = [1, Stage::Shuffle as u32, blend::pixels_per_lane(size)];
    let formats = [PixelFormat::Rgba8, PixelFormat::Rgba16F, PixelFormat::Rgba32F];
    for (format, to_image) in formats.into_iter().zip([&BLEND_RGBA8, &BLEND_RGBA16F, &BLEND_RGBA32F]) {
        let mut case = blend_case(&frame, &splats, &tile_count, spec, size);
        case.buffers[4] = vec![POISON; format.bytes() as usize / 4 * frame.pixels()];
        let mut spec = [&[size], &case.spec[..]].concat();
        let groups = [case.groups, 1, 1];
        let mut buffers = case.buffers.clone();
        let picture = buffers.remove(4);
        buffers.push(picture);
        (to_image.twin)(&mut TwinCall { groups, spec: &spec, push: &[0; 8], buffers: &mut buffers });
        let kernel = if format == PixelFormat::Rgba32F { &BLEND } else { &BLEND_PACKED };
        spec.push(format as u32);
        (kernel.twin)(&mut TwinCall { groups, spec: &spec, push: &[], buffers: &mut case.buffers });
        assert!(case.buffers[4].iter().all(|w| *w != POISON), "{format:?}");
        assert!(buffers[6] == case.buffers[4] && buffers[4] == case.buffers[5], "{format:?}");
    }
}

/// The image of the chain deform_project -> tile lists -> blend, by the twins or on the device.
fn chain(gpu: Option<&TestGpu>, input: &RenderInput, camera: &Camera) -> Vec<f32> {
    let frame = input.frame(camera);
    let (splats, tile_count) = match gpu {
        None => twin_splats(input, &frame),
        Some(gpu) => {
            let mut buffers = input.deform_project(&frame).run(gpu).gpu;
            (buffers.swap_remove(11), buffers.swap_remove(12))
        }
    };
    let size = gpu.map_or(32, |gpu| gpu.subgroup_size_of(&BLEND));
    let spec = [0, Stage::Shuffle as u32, blend::pixels_per_lane(size)];
    let mut case = blend_case(&frame, &splats, &tile_count, spec, size);
    let words = match gpu {
        Some(gpu) => case.run(gpu).gpu.swap_remove(4),
        None => {
            let groups = [case.groups, 1, 1];
            let spec = [size, spec[0], spec[1], spec[2]];
            (BLEND.twin)(&mut TwinCall { groups, spec: &spec, push: &[], buffers: &mut case.buffers });
            case.buffers.swap_remove(4)
        }
    };
    words.into_iter().map(f32::from_bits).collect()
}

fn assert_close_to_reference(gpu: Option<&TestGpu>, input: &RenderInput, camera: &Camera, context: &str) {
    let options =
        ReferenceOptions { background: [0.1, 0.2, 0.3].map(|c: f32| c.into()), ..ReferenceOptions::default() };
    let truth = reference::render(&input.scene(), camera, f64::from(0.3_f32), &options).unwrap();
    let image = chain(gpu, input, camera);
    let rgb = image.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from);
    let d = difference(truth.rgb.iter().copied(), rgb);
    let alpha = difference(truth.alpha.iter().copied(), image.chunks_exact(4).map(|p| f64::from(p[3])));
    let side = if gpu.is_some() { "device" } else { "twins" };
    println!("{context}, {side}: {d:?}, alpha max {:.1e}", alpha.max);
    assert!(d.psnr >= 85.0 && d.q999 <= 1e-4 && alpha.q999 <= 1e-4, "{context}, {side}: {d:?}");
}

#[test]
fn images_agree_with_the_reference() {
    let gpu = tests_harness::gpu();
    for gpu in [None, Some(&gpu)] {
        for degree in 0..4 {
            let input = RenderInput::random(800, degree, 40 + u64::from(degree));
            assert_close_to_reference(gpu, &input, &test_camera(160, 121), &format!("static, degree {degree}"));
        }
        let moving = RenderInput::random(1500, 2, 3).moving(9, 4);
        assert_close_to_reference(gpu, &moving, &test_camera(97, 160), "moving");
        let mut off_centre = test_camera(120, 90);
        (off_centre.cx, off_centre.cy, off_centre.fy) = (20.0, 100.0, 1.3 * off_centre.fy);
        assert_close_to_reference(gpu, &moving, &off_centre, "principal point off centre");
        let inside = Camera::look_at(DVec3::ZERO, DVec3::new(0.3, 0.2, 1.0), -DVec3::Y, 1.4, [128, 128]);
        assert_close_to_reference(gpu, &moving, &inside, "camera inside");

        let mut needles = RenderInput::random(400, 0, 8);
        for g in 0..400 {
            needles.log_scale[g] = 1.5;
            needles.log_scale[400 + g] = -9.0;
            needles.log_scale[800 + g] = if g % 2 == 0 { -9.0 } else { -1.0 };
        }
        assert_close_to_reference(gpu, &needles, &test_camera(200, 200), "needles and plates");
        let mut huge = RenderInput::random(60, 1, 9);
        for g in 0..60 {
            huge.opacity_logit[g] = -3.5;
            (0..3).for_each(|c| huge.log_scale[60 * c + g] += 5.0 + 0.3 * g as f32);
        }
        assert_close_to_reference(gpu, &huge, &test_camera(90, 70), "up to e^20");
        let mut far = RenderInput::random(500, 1, 10);
        let offset = [1.0e6_f32, -2.0e6, 5.0e5];
        (0..3).for_each(|c| far.mean[500 * c..500 * (c + 1)].iter_mut().for_each(|v| *v += offset[c]));
        let mut camera = test_camera(150, 150);
        camera.position += DVec3::from_array(offset.map(f64::from)) + DVec3::new(0.01, 0.02, 0.03);
        assert_close_to_reference(gpu, &far, &camera, "a million units from the origin");
    }
}

fn network(seed: u64, size: DeformSize) -> DeformNetwork {
    let mut r = Random(seed);
    let mut linear = |inputs: usize, outputs: usize| {
        let bound = (6.0 / inputs as f32).sqrt();
        Linear {
            inputs,
            outputs,
            weight: (0..inputs * outputs).map(|_| r.range(-bound, bound)).collect(),
            bias: (0..outputs).map(|_| r.range(-0.1, 0.1)).collect(),
        }
    };
    DeformNetwork {
        linear: (0..size.layers).map(|i| linear(size.layer_inputs(i), size.width)).collect(),
        translation: linear(size.width, 3),
        rotation: linear(size.width, 3),
    }
}

#[test]
fn deform_network_matches_twin_and_reference() {
    let gpu = tests_harness::gpu();
    let small = |layers, width| DeformSize { layers, width };
    let narrow = [1, 2, 3, 5].into_iter().zip([32, 64, 128, 224]).map(|(layers, width)| (9, small(layers, width)));
    for (count, size) in [1_u32, 7, 8, 9, 33, 300].map(|count| (count, DeformSize::PAPER)).into_iter().chain(narrow) {
        let network = network(11, size);
        for fp16 in [false, true] {
            let mut r = Random(u64::from(count));
            let position: Vec<[f32; 3]> = (0..count).map(|_| std::array::from_fn(|_| r.range(-10.0, 10.0))).collect();
            let mut frame = RenderInput::random(0, 0, 0).frame(&test_camera(8, 8));
            frame.superpoints = count;
            frame.time = 0.617;
            let weights = deform_network::pack_weights(&network, fp16).unwrap();
            let case = UntypedCase {
                kernel: &DEFORM_NETWORK,
                spec: deform_network::spec_constants(size, fp16).to_vec(),
                push: Vec::new(),
                buffers: vec![
                    bytemuck::cast_slice(&[frame]).to_vec(),
                    bytemuck::cast_slice(&position).to_vec(),
                    weights,
                    vec![0; 8 * count as usize],
                ],
                groups: deform_network::groups(count) as u32,
            };
            let result = case.run(&gpu);
            result.assert_equal(&DEFORM_NETWORK, &format!("M = {count}, {size:?}, fp16 {fp16}"));
            let truth = reference::network_poses(&network, &position, f64::from(0.617_f32));
            let (mut error, mut norm) = (0.0, 0.0);
            for (pose, words) in truth.iter().zip(result.gpu[3].chunks_exact(8)) {
                let ours: Vec<f64> = words.iter().map(|w| f64::from(f32::from_bits(*w))).collect();
                for c in 0..3 {
                    error += (ours[c] - pose.rotation[c]).powi(2) + (ours[4 + c] - pose.translation[c]).powi(2);
                    norm += pose.rotation[c].powi(2) + pose.translation[c].powi(2);
                }
            }
            let relative = (error / norm).sqrt();
            println!("network F, M = {count}, {size:?}, fp16 {fp16}: relative L2 error {relative:.2e}");
            assert!(relative < if fp16 { 5e-3 } else { 5e-6 }, "M = {count}, {size:?}, fp16 {fp16}: {relative:e}");
        }
    }
}

#[test]
fn the_rate_kernel_adds_up_what_its_twin_does() {
    let gpu = tests_harness::gpu();
    for (count, rounds) in [(0_u32, 4_u32), (1, 0), (255, 1), (300, 7), (513, 40)] {
        let push = bytemuck::bytes_of(&ArithmeticRatePush { count, rounds }).to_vec();
        let groups = count.div_ceil(ARITHMETIC_RATE_THREADS).max(1);
        let buffers = vec![vec![0; count as usize]];
        let case = UntypedCase { kernel: &ARITHMETIC_RATE, spec: vec![], push, buffers, groups };
        case.run(&gpu).assert_equal(&ARITHMETIC_RATE, &format!("{count} × {rounds}"));
    }
    assert!(arithmetic_rate(&gpu).unwrap() > 0.01);
}
