//! `deform_project`, `blend` and `deform_network` on the device against their twins.

use engine::gpu::interface::{Buffers, Constants as _, of_words};
use engine::gpu::kernel::TwinCall;
use engine::gpu::{Kernel, proof};
use engine::image::difference;
use engine::reference::{self, ReferenceOptions};
use engine::render::PixelFormat;
use engine::render::arithmetic_rate::{
    ARITHMETIC_RATE, ARITHMETIC_RATE_THREADS, ArithmeticRateBuffers, ArithmeticRatePush, arithmetic_rate,
};
use engine::render::blend::{self, BLEND, Blend, BlendBuffers, BlendConstants, Stage};
use engine::render::blend_image::BlendImageBuffers;
use engine::render::blend_packed::{BLEND_PACKED, BlendPacked, BlendPackedBuffers, BlendPackedConstants};
use engine::render::blend_rgba8::{BLEND_RGBA8, BlendRgba8};
use engine::render::blend_rgba16f::BLEND_RGBA16F;
use engine::render::blend_rgba32f::BLEND_RGBA32F;
use engine::render::copy_rate::{COPY_RATE, COPY_RATE_OF_GROUP, CopyRateBuffers, CopyRatePush, copy_rate};
use engine::render::deform_network::{self, DEFORM_NETWORK, DeformNetworkBuffers, DeformNetworkConstants};
use engine::render::deform_project::DeformProject;
use engine::render::frame::Frame;
use engine::render::limits::{FAILED_INSTANCES, INSTANCE_GAUSSIAN, TILE_PITCH};
use engine::scene::network::DeformSize;
use engine::scene::{Camera, DeformNetwork, Linear};
use glam::DVec3;
use tests_harness::kernel_case::POISON;
use tests_harness::render_case::{Random, RenderInput, test_camera, tile_lists};
use tests_harness::{KernelCase, KernelResult, TestGpu};

const SIZES: [usize; 11] = [0, 1, 7, 8, 31, 32, 33, 255, 256, 257, 65_537];

/// Counts and block sums follow the tile counts, which may flip within the tolerance: the sums must equal the device's own
/// tile counts, and those may differ from the twin's in few places.
fn assert_deform_project(result: &KernelResult<DeformProject>, n: usize, context: &str) {
    let (gpu, twin) = (&result.gpu, &result.twin);
    let (tile_count, splats, counters) = (&gpu.tile_count[..n], &gpu.splats[..12 * n], &gpu.counters);
    let flips = (0..n).filter(|&g| tile_count[g] != twin.tile_count[g]).count();
    let allowed = 1 + n / 1000;
    assert!(flips <= allowed, "{context}: {flips} tile counts of {n} differ");
    let visible = tile_count.iter().filter(|&&t| t > 0).count() as u32;
    let instances: u64 = tile_count.iter().map(|&t| u64::from(t)).sum();
    assert_eq!(counters[0], visible, "{context}: visible");
    assert_eq!(u64::from(counters[1]) | u64::from(counters[2]) << 32, instances, "{context}: instances");
    let rejected = [counters[4], twin.counters[4]];
    assert!(rejected[0].abs_diff(rejected[1]) <= allowed as u32, "{context}: {rejected:?} rejected");
    let blocks = n.div_ceil(256).max(1);
    for (b, tiles) in tile_count.chunks(256).enumerate() {
        assert_eq!(gpu.instance_block[b], tiles.iter().sum::<u32>(), "{context}: block {b}");
    }
    for s in 0..blocks.div_ceil(256) {
        let sum: u32 = gpu.instance_block[256 * s..blocks.min(256 * (s + 1))].iter().sum();
        assert_eq!(gpu.instance_block[blocks + s], sum, "{context}: super sum {s}");
    }
    // From changes to counts to their sum; past the last tile nothing is left.
    let (mut count, mut sum) = (0_u32, 0_u64);
    for counter in gpu.tile_end.chunks_exact(TILE_PITCH as usize) {
        assert_eq!(counter[1..], [0; TILE_PITCH as usize - 1], "{context}: between counters");
        count = count.wrapping_add(counter[0]);
        sum += u64::from(count);
    }
    assert_eq!((count, sum), (0, instances), "{context}: changes from tile to tile");
    let mut worst = 0.0_f32;
    for k in 0..splats.len() {
        if tile_count[k / 12] > 0 && twin.tile_count[k / 12] > 0 {
            let (g, t) = (f32::from_bits(splats[k]), f32::from_bits(twin.splats[k]));
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
    let gpu = tests_harness::shared_gpu();
    for (i, n) in SIZES.into_iter().enumerate() {
        // A degree is another three pipelines; `images_agree_with_the_reference` has all of them.
        let degree = if tests_harness::small() { 3 } else { i as u32 % 4 };
        let input = RenderInput::random(n, degree, i as u64);
        let frame = input.frame(&test_camera(400, 300));
        assert_deform_project(&input.deform_project(&frame).run(&gpu), n, &format!("static, n = {n}, degree {degree}"));
        let input = input.moving(13, 5 + i as u64);
        let frame = input.frame(&test_camera(400, 300));
        assert_deform_project(&input.deform_project(&frame).run(&gpu), n, &format!("moving, n = {n}, degree {degree}"));
        let input = input.nonrigid(9 + i as u64);
        assert_deform_project(&input.deform_project(&frame).run(&gpu), n, &format!("non-rigid, n = {n}"));
        let soft = input.clone().soft(2 + i % 3, 21 + i as u64);
        assert_deform_project(&soft.deform_project(&frame).run(&gpu), n, &format!("soft superpoints, n = {n}"));
        let antialiased = soft.antialiased();
        assert_deform_project(&antialiased.deform_project(&frame).run(&gpu), n, &format!("antialiased, n = {n}"));
        let input = input.with_optional(17 + i as u64);
        assert_deform_project(&input.deform_project(&frame).run(&gpu), n, &format!("optional parameters, n = {n}"));
    }
}

/// Every pair of each list by depth, ties by Gaussian.
fn sorted_lists(frame: &Frame, pairs: &[u32], tile_end: &[u32]) -> Vec<Vec<u32>> {
    let room = frame.tile_room as usize;
    let counts = tile_end.iter().step_by(TILE_PITCH as usize);
    let sorted = |(list, count): (&[u32], &u32)| {
        let mut list: Vec<[u32; 2]> = list.chunks_exact(2).take(*count as usize).map(|p| [p[0], p[1]]).collect();
        list.sort_by_key(|[depth, instance]| (*depth, instance & INSTANCE_GAUSSIAN));
        list.into_iter().map(|[_, instance]| instance).collect()
    };
    pairs.chunks_exact(2 * room).zip(counts).map(sorted).collect()
}

/// Lists that it fills itself are those by definition of its own splats; a frame fails where one has too little room.
#[test]
fn deform_project_fills_lists() {
    let gpu = tests_harness::shared_gpu();
    for (n, degree, size) in [(0, 0, [40, 40]), (1, 0, [40, 40]), (257, 3, [33, 17]), (5000, 1, [200, 120])] {
        let mut input = RenderInput::random(n, degree, 9 + n as u64).moving(6, 3);
        // Some reach many tiles.
        for g in (0..n).step_by(7) {
            (0..3).for_each(|c| input.log_scale[c * n + g] = -0.5);
        }
        let mut frame = input.frame(&test_camera(size[0], size[1]));
        frame.tile_room = n.next_multiple_of(32).max(32) as u32;
        let result = input.deform_project_with_lists(&frame).run(&gpu);
        let done = &result.gpu;
        let (ranges, values) = tile_lists(&frame, &done.splats[..12 * n], &done.tile_count[..n]);
        let expected: Vec<&[u32]> =
            ranges.chunks_exact(2).map(|range| &values[range[0] as usize..range[1] as usize]).collect();
        let found = sorted_lists(&frame, done.pairs.as_deref().unwrap(), &done.tile_end);
        assert!(found == expected, "{n} Gaussians: other lists");
        let longest = expected.iter().map(|list| list.len() as u32).max().unwrap();
        assert_eq!(u64::from(done.counters[1]), values.len() as u64);
        let reported = |room: u32| if longest > room / 4 * 3 { longest } else { 0 };
        assert_eq!(done.counters[3..7], [0, result.twin.counters[4], 0, reported(frame.tile_room)], "{n} Gaussians");
        if longest < 2 {
            continue;
        }
        for (room, failed) in [(longest, 0), (longest - 1, FAILED_INSTANCES)] {
            frame.tile_room = room;
            let done = input.deform_project_with_lists(&frame).run(&gpu).gpu;
            assert_eq!((done.counters[3], done.counters[6]), (failed, longest), "{n} Gaussians, room for {room}");
        }
    }
}

#[test]
fn deform_project_of_nasty_gaussians() {
    let gpu = tests_harness::shared_gpu();
    for seed in 0..4 {
        let mut input = RenderInput::random(5000, 3, seed).moving(7, seed);
        input.spoil(seed);
        let frame = input.frame(&test_camera(333, 211));
        let result = input.deform_project(&frame).run(&gpu);
        assert!(result.gpu.counters[4] > 100, "only {} rejected", result.gpu.counters[4]);
        assert_deform_project(&result, 5000, &format!("nasty, seed {seed}"));
    }
    // Every slot poisoned: nothing is drawn, everything is counted, nothing hangs.
    let mut input = RenderInput::random(777, 3, 1);
    for v in [&mut input.mean, &mut input.log_scale, &mut input.rotation, &mut input.opacity_logit] {
        v.fill(f32::from_bits(tests_harness::kernel_case::POISON));
    }
    let frame = input.frame(&test_camera(64, 64));
    let result = input.deform_project(&frame).run(&gpu);
    assert_eq!(result.gpu.counters[..5], [0, 0, 0, 0, 777]);
}

fn blend_case(
    frame: &Frame,
    splats: &[u32],
    tile_count: &[u32],
    constants: BlendConstants,
    size: u32,
) -> KernelCase<Blend> {
    let (ranges, values) = tile_lists(frame, splats, tile_count);
    let pixels = frame.pixels();
    let buffers = BlendBuffers {
        frame: bytemuck::cast_slice(&[*frame]).to_vec(),
        ranges,
        values,
        splats: splats.to_vec(),
        color: vec![0; 4 * pixels],
        depth: (constants.with_depth == 1).then(|| vec![0; pixels]),
        gaussian_of_slot: None,
    };
    let groups = blend::groups(frame.tile_count, size, constants.pixels_per_lane) as u32;
    KernelCase { kernel: &BLEND, constants, push: (), buffers, groups }
}

fn constants(with_depth: u32, stage: Stage, pixels_per_lane: u32) -> BlendConstants {
    BlendConstants { with_depth, stage: stage as u32, pixels_per_lane, ..BlendConstants::default() }
}

/// The same case with values that are slots, in some order.
fn with_slots(mut case: KernelCase<Blend>) -> KernelCase<Blend> {
    let count = case.buffers.values.len() as u32;
    case.constants.with_slots = 1;
    case.buffers.gaussian_of_slot = Some(case.buffers.values.iter().rev().copied().collect());
    case.buffers.values = (0..count).rev().collect();
    case
}

/// The same case with pixels of a format.
fn packed(case: KernelCase<Blend>, format: PixelFormat) -> KernelCase<BlendPacked> {
    let BlendBuffers { frame, ranges, values, splats, color, depth, gaussian_of_slot } = case.buffers;
    let pixels = vec![POISON; color.len() / 4 * (format.bytes() as usize / 4)];
    let buffers = BlendPackedBuffers { frame, ranges, values, splats, pixels, depth, gaussian_of_slot };
    let constants = BlendPackedConstants::new(case.constants, format);
    KernelCase { kernel: &BLEND_PACKED, constants, push: (), buffers, groups: case.groups }
}

fn twin_splats(input: &RenderInput, frame: &Frame) -> (Vec<u32>, Vec<u32>) {
    let KernelCase { kernel, constants, push, buffers, groups } = input.deform_project(frame);
    let done = kernel.run_twin(8, constants, push, buffers, groups);
    (done.splats, done.tile_count)
}

fn assert_blend(result: &KernelResult<Blend>, context: &str) {
    result.assert_equal(context);
    assert!(result.gpu.color.iter().all(|w| f32::from_bits(*w).is_finite()), "{context}: a pixel was not written");
}

#[test]
fn blend_matches_its_twin() {
    let gpu = tests_harness::shared_gpu();
    let size = gpu.subgroup_size_of(&BLEND);
    let usual = blend::pixels_per_lane(size);
    for (n, width, height) in [(0, 33, 17), (1, 1, 1), (300, 64, 64), (3000, 150, 91), (2000, 17, 200)] {
        let input = RenderInput::random(n, 1, n as u64);
        let frame = input.frame(&test_camera(width, height));
        let (splats, tile_count) = twin_splats(&input, &frame);
        for stage in [Stage::Shuffle, Stage::Shared, Stage::Reread] {
            for depth in [0, 1] {
                // Each choice is a pipeline, which takes seconds to compile: in small, every choice once.
                if tests_harness::small() && (depth == 1) != (stage == Stage::Shared) {
                    continue;
                }
                let mut lanes = vec![usual];
                let other_sizes = !tests_harness::small() || (depth == 0 && stage == Stage::Shuffle);
                if other_sizes && blend::subtile(size, 2 * usual)[2] <= 16 && usual < 16 {
                    lanes.push(2 * usual);
                }
                if other_sizes && usual > 1 {
                    lanes.push(usual / 2);
                }
                for per_lane in lanes {
                    let constants = constants(depth, stage, per_lane);
                    let case = blend_case(&frame, &splats, &tile_count, constants, size);
                    let with = per_lane == usual && depth == 0 && (!tests_harness::small() || stage == Stage::Shuffle);
                    let slots = with.then(|| with_slots(case.clone()).run(&gpu));
                    let result = case.run(&gpu);
                    if let Some(slots) = slots {
                        assert_eq!(slots.gpu.color, result.gpu.color, "slots change the image");
                        assert_eq!(slots.twin.color, result.twin.color, "slots change the twin's image");
                    }
                    assert_blend(&result, &format!("n = {n}, {width}x{height}, {constants:?}"));
                }
            }
        }
    }
}

#[test]
fn blend_packed_stores_what_its_twin_stores() {
    let gpu = tests_harness::shared_gpu();
    let size = gpu.subgroup_size_of(&BLEND);
    let input = RenderInput::random(800, 1, 5);
    // Below zero, too: halves have a sign.
    let frame = Frame { background: [-0.25, 0.5, -1.5], ..input.frame(&test_camera(75, 53)) };
    let (splats, tile_count) = twin_splats(&input, &frame);
    for format in [PixelFormat::Rgba8, PixelFormat::Bgra8, PixelFormat::Rgba16F] {
        let constants = constants(1, Stage::of_device(&gpu), blend::pixels_per_lane(size));
        let words = format.bytes() as usize / 4;
        let case = packed(blend_case(&frame, &splats, &tile_count, constants, size), format);
        let result = case.run(&gpu);
        let step = if words == 1 { 1.01 / 255.0 } else { 1.0 / 1024.0 };
        let pairs = result.gpu.pixels.chunks_exact(words).zip(result.twin.pixels.chunks_exact(words));
        let off = pairs.filter(|(g, t)| {
            let (g, t) = (format.unpack(g), format.unpack(t));
            g.iter().zip(t).any(|(g, t)| (g - t).abs() > step * t.abs().max(1.0))
        });
        assert!(off.count() as f32 <= BLEND_PACKED.tolerance.flips * frame.pixels() as f32, "{format:?}");
        let lit = result.gpu.pixels.chunks_exact(words).filter(|g| format.unpack(g)[3] > 0.5).count();
        assert!(lit > frame.pixels() / 20, "{format:?}: {lit} pixels are covered");
        // Depth as usual; pixels were compared by level above.
        let found = BlendPackedBuffers { pixels: result.twin.pixels.clone(), ..result.gpu };
        let [found, expected] = [found, result.twin].map(list);
        let mismatch = proof::mismatch(&BLEND_PACKED, &found, &expected);
        assert_eq!(mismatch.map(|m| m.why()), None, "{format:?}");
    }
}

/// Words of each buffer; none where an optional one is absent.
fn list(buffers: impl Buffers<Vec<u32>>) -> Vec<Vec<u32>> {
    buffers.into_list().into_iter().map(Option::unwrap_or_default).collect()
}

/// The kernels themselves are compared by the pictures that hosts get (`embed` of the engine): their images are a host's.
#[test]
fn twins_that_store_to_an_image_store_what_those_of_buffers_do() {
    let input = RenderInput::random(800, 1, 5);
    let frame = input.frame(&test_camera(75, 53));
    let (splats, tile_count) = twin_splats(&input, &frame);
    let size = 32;
    let constants = constants(1, Stage::Shuffle, blend::pixels_per_lane(size));
    let to_image: [(PixelFormat, &Kernel); 3] = [
        (PixelFormat::Rgba8, &BLEND_RGBA8),
        (PixelFormat::Rgba16F, &BLEND_RGBA16F),
        (PixelFormat::Rgba32F, &BLEND_RGBA32F),
    ];
    for (format, kernel) in to_image {
        let case = blend_case(&frame, &splats, &tile_count, constants, size);
        let BlendBuffers { frame, ranges, values, splats, depth, gaussian_of_slot, .. } = case.buffers.clone();
        let buffers = BlendImageBuffers { frame, ranges, values, splats, depth, gaussian_of_slot };
        let mut words = list(buffers);
        // The image comes after the buffers.
        words.push(vec![POISON; case.buffers.color.len() / 4 * (format.bytes() as usize / 4)]);
        let spec = [&[size], &constants.to_words()[..]].concat();
        (kernel.twin)(&mut TwinCall { groups: [case.groups, 1, 1], spec: &spec, push: &[0; 8], buffers: &mut words });
        let picture = words.pop().unwrap();
        let image_depth = of_words::<BlendRgba8>(words).depth;
        let (pixels, depth) = if format == PixelFormat::Rgba32F {
            let done = BLEND.run_twin(size, case.constants, (), case.buffers, case.groups);
            (done.color, done.depth)
        } else {
            let case = packed(case, format);
            let done = BLEND_PACKED.run_twin(size, case.constants, (), case.buffers, case.groups);
            (done.pixels, done.depth)
        };
        assert!(pixels.iter().all(|w| *w != POISON), "{format:?}");
        assert!(picture == pixels && image_depth == depth, "{format:?}");
    }
}

/// The image of the chain deform_project -> tile lists -> blend, by the twins or on the device.
fn chain(gpu: Option<&TestGpu>, input: &RenderInput, camera: &Camera) -> Vec<f32> {
    let frame = input.frame(camera);
    let (splats, tile_count) = match gpu {
        None => twin_splats(input, &frame),
        Some(gpu) => {
            let done = input.deform_project(&frame).run(gpu).gpu;
            (done.splats, done.tile_count)
        }
    };
    let size = gpu.map_or(32, |gpu| gpu.subgroup_size_of(&BLEND));
    let constants = constants(0, Stage::Shuffle, blend::pixels_per_lane(size));
    let case = blend_case(&frame, &splats, &tile_count, constants, size);
    let done = match gpu {
        Some(gpu) => case.run(gpu).gpu,
        None => BLEND.run_twin(size, case.constants, (), case.buffers, case.groups),
    };
    done.color.into_iter().map(f32::from_bits).collect()
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
    let gpu = tests_harness::shared_gpu();
    for gpu in [None, Some(&gpu)] {
        for degree in 0..4 {
            let input = RenderInput::random(800, degree, 40 + u64::from(degree));
            assert_close_to_reference(gpu, &input, &test_camera(160, 121), &format!("static, degree {degree}"));
        }
        let moving = RenderInput::random(1500, 2, 3).moving(9, 4);
        assert_close_to_reference(gpu, &moving, &test_camera(97, 160), "moving");
        for neighbors in [1, 2, 3, 4] {
            let soft = moving.clone().soft(neighbors, 5);
            assert_close_to_reference(gpu, &soft, &test_camera(97, 160), &format!("{neighbors} soft superpoints"));
        }
        assert_close_to_reference(gpu, &moving.clone().antialiased(), &test_camera(40, 30), "antialiased");
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
        assert_close_to_reference(
            gpu,
            &needles.antialiased(),
            &test_camera(200, 200),
            "antialiased needles and plates",
        );
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
    let gpu = tests_harness::shared_gpu();
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
            let buffers = DeformNetworkBuffers {
                frame: bytemuck::cast_slice(&[frame]).to_vec(),
                superpoint_position: bytemuck::cast_slice(&position).to_vec(),
                weights,
                pose: vec![0; 8 * count as usize],
            };
            let constants = DeformNetworkConstants::new(size, fp16);
            let groups = deform_network::groups(count) as u32;
            let case = KernelCase { kernel: &DEFORM_NETWORK, constants, push: (), buffers, groups };
            let pose = case.check(&gpu, &format!("M = {count}, {size:?}, fp16 {fp16}")).pose;
            let truth = reference::network_poses(&network, &position, f64::from(0.617_f32));
            let (mut error, mut norm) = (0.0, 0.0);
            for (expected, words) in truth.iter().zip(pose.chunks_exact(8)) {
                let ours: Vec<f64> = words.iter().map(|w| f64::from(f32::from_bits(*w))).collect();
                for c in 0..3 {
                    error += (ours[c] - expected.rotation[c]).powi(2) + (ours[4 + c] - expected.translation[c]).powi(2);
                    norm += expected.rotation[c].powi(2) + expected.translation[c].powi(2);
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
    let gpu = tests_harness::shared_gpu();
    for (count, rounds) in [(0_u32, 4_u32), (1, 0), (255, 1), (300, 7), (513, 40)] {
        let push = ArithmeticRatePush { count, rounds };
        let groups = count.div_ceil(ARITHMETIC_RATE_THREADS).max(1);
        let buffers = ArithmeticRateBuffers { sums: vec![0; count as usize] };
        let case = KernelCase { kernel: &ARITHMETIC_RATE, constants: (), push, buffers, groups };
        case.check(&gpu, &format!("{count} × {rounds}"));
    }
    assert!(arithmetic_rate(&gpu).unwrap() > 0.01);
}

#[test]
fn the_copy_kernel_copies_what_its_twin_does() {
    let gpu = tests_harness::shared_gpu();
    let group = COPY_RATE_OF_GROUP;
    for count in [0, 1, 255, group - 1, group, group + 1, 3 * group + 257] {
        let source = (0..4 * count + 8).map(|i| i.wrapping_mul(2_654_435_761)).collect();
        let buffers = CopyRateBuffers { source, destination: vec![0; 4 * count as usize + 8] };
        // One more than there are: a grid may be folded.
        let (push, groups) = (CopyRatePush { count }, count.div_ceil(group) + 1);
        let case = KernelCase { kernel: &COPY_RATE, constants: (), push, buffers, groups };
        case.check(&gpu, &format!("{count} vectors"));
    }
    assert!(copy_rate(&gpu).unwrap() > 0.01);
}
