//! `deform_project`, `blend` and `deform_network` on the device against their twins.

use engine::gpu::Kernel;
use engine::render::blend::{self, BLEND, Stage};
use engine::render::deform_project::DEFORM_PROJECT;
use engine::render::frame::Frame;
use tests_harness::render_case::{RenderInput, test_camera, tile_lists};
use tests_harness::{KernelCase, KernelResult};

const SIZES: [usize; 11] = [0, 1, 7, 8, 31, 32, 33, 255, 256, 257, 65_537];

/// Counts and block sums follow the tile counts, which may flip within the tolerance: the sums must equal the device's own
/// tile counts, and those may differ from the twin's in few places.
fn assert_deform_project(result: &KernelResult, n: usize, context: &str) {
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

fn blend_case(frame: &Frame, splats: &[u32], tile_count: &[u32], spec: [u32; 3], size: u32) -> KernelCase {
    let (ranges, values) = tile_lists(frame, splats, tile_count);
    let pixels = frame.pixels();
    KernelCase {
        kernel: &BLEND,
        spec: spec.to_vec(),
        push: Vec::new(),
        buffers: vec![
            bytemuck::cast_slice(&[*frame]).to_vec(),
            ranges,
            values,
            splats.to_vec(),
            vec![0; 4 * pixels],
            vec![0; if spec[0] == 1 { pixels } else { 4 }],
        ],
        groups: blend::groups(frame.limits[1], size, spec[2]) as u32,
    }
}

fn twin_splats(input: &RenderInput, frame: &Frame) -> (Vec<u32>, Vec<u32>) {
    let mut case = input.deform_project(frame);
    let mut call = engine::gpu::kernel::TwinCall {
        groups: [case.groups, 1, 1],
        spec: &[8, input.degree, u32::from(!input.pose.is_empty())],
        push: &case.push,
        buffers: &mut case.buffers,
    };
    (DEFORM_PROJECT.twin)(&mut call);
    (case.buffers.swap_remove(11), case.buffers.swap_remove(12))
}

fn assert_blend(result: &KernelResult, kernel: &Kernel, context: &str) {
    result.assert_equal(kernel, context);
    assert!(result.gpu[4].iter().all(|w| f32::from_bits(*w).is_finite()), "{context}: a pixel was not written");
}

#[test]
fn blend_matches_its_twin() {
    let gpu = tests_harness::gpu();
    let size = gpu.subgroup_size();
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
                    let result = blend_case(&frame, &splats, &tile_count, spec, size).run(&gpu);
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
