//! A whole small frame on the model, the output of one kernel as the input of the next, against the twins and the f64
//! reference.

use engine::gpu::interface::Interface;
use engine::gpu::kernel::Kernel;
use engine::image::difference;
use engine::reference::{self, ReferenceOptions};
use engine::render::blend::{self, BLEND, BLEND_PACKED, PixelFormat, Stage};
use engine::render::blend_image::{BLEND_RGBA8, BLEND_RGBA16F, BLEND_RGBA32F};
use engine::render::compact::*;
use engine::render::deform_project::DeformProjectPush;
use engine::render::frame::Frame;
use engine::render::radix_sort::*;
use engine::render::sort_scatter::{SORT_SCATTER, SortScatterBuffers};
use engine::render::sort_spine::{SORT_SPINE, SPINE_GROUPS, SortSpineBuffers};
use engine::render::emit_tiles::{EMIT_TILES, EmitTilesPush};
use engine::render::sum_tile_counts::{SUM_TILE_COUNTS, SumTileCountsPush};
use engine::render::tile_ranges::TILE_RANGES;
use engine::render::tiles::{block_words, tile_key_bits};
use engine::scene::Camera;
use tests_harness::KernelCase;
use tests_harness::UntypedCase;
use tests_harness::model::{self, Options};
use tests_harness::render_case::{RenderInput, test_camera};

/// A kernel on the model, compared with its twin.
fn run(options: &Options, case: UntypedCase) -> Vec<Vec<u32>> {
    let kernel: &'static Kernel = case.kernel;
    let result = case.run_model(options);
    result.assert_equal(kernel, &format!("{options:?}"));
    result.gpu
}

fn case(kernel: &'static Kernel, spec: &[u32], push: &[u8], buffers: Vec<Vec<u32>>, groups: u32) -> UntypedCase {
    UntypedCase { kernel, spec: spec.to_vec(), push: push.to_vec(), buffers, groups: groups.max(1) }
}

fn check<I: Interface>(options: &Options, case: KernelCase<I>) -> I::Buffers<Vec<u32>> {
    let result = case.run_model(options);
    result.assert_equal(&format!("{options:?}"));
    result.gpu
}

/// Keys and values after all passes.
fn sort(
    options: &Options,
    plan: &SortPlan,
    [mut keys, mut values]: [Vec<u32>; 2],
    mut histogram: Vec<u32>,
    counters: &[u32],
    (count_word, groups): (u32, u32),
) -> [Vec<u32>; 2] {
    for pass in 0..plan.digits.len() {
        if plan.prescanned {
            let buffers = SortSpineBuffers { counters: counters.to_vec(), histogram };
            let push = plan.spine_push(count_word);
            let case = KernelCase { kernel: &SORT_SPINE, constants: (), push, buffers, groups: SPINE_GROUPS };
            histogram = check(options, case).histogram;
        }
        let rows = histogram.len();
        let buffers = SortScatterBuffers {
            counters: counters.to_vec(),
            histogram,
            keys_out: vec![0; keys.len()],
            values_out: Some(vec![0; keys.len()]),
            keys_in: keys,
            values_in: Some(values),
            next_histogram: (pass + 1 < plan.digits.len()).then(|| vec![0; rows]),
        };
        let constants = plan.scatter_constants(pass, true, rank_by_ballot(options.lanes));
        let (push, groups) = (plan.scatter_push(pass, count_word), groups.max(1));
        let case = KernelCase { kernel: &SORT_SCATTER, constants, push, buffers, groups };
        let done = check(options, case);
        histogram = done.next_histogram.unwrap_or_default();
        values = done.values_out.unwrap();
        keys = done.keys_out;
    }
    [keys, values]
}

/// What `blend` reads: frame, ranges, values, splats.
fn lists(options: &Options, input: &RenderInput, frame: &Frame, capacity: u32) -> [Vec<u32>; 4] {
    let mut frame = *frame;
    frame.limits[0] = capacity;
    let n = input.count as u32;
    let (words, block_capacity) = block_words(n);
    let mut project = input.deform_project(&frame);
    project.buffers[13] = vec![0; words as usize];
    project.push = bytemuck::bytes_of(&DeformProjectPush { block_capacity }).to_vec();
    // A Gaussian at the edge of a tile may count otherwise than in the twin: here the picture decides.
    let mut projected = project.run_model(options).gpu;
    let counters = projected.swap_remove(14);
    let visible_block = projected.swap_remove(13);
    let tile_count = projected.swap_remove(12);
    let splats = projected.swap_remove(11);
    let frame_words: Vec<u32> = bytemuck::cast_slice(&[frame]).to_vec();

    let depth = SortPlan::new(n, 32).unwrap();
    let tile = SortPlan::new(capacity, tile_key_bits(frame.limits[1])).unwrap();
    let out = vec![0; n as usize];
    let buffers = vec![
        frame_words.clone(),
        tile_count.clone(),
        splats.clone(),
        visible_block,
        counters,
        vec![0; INDIRECT_WORDS as usize],
        out.clone(),
        out,
        vec![0; depth.histogram_rows() as usize * 256],
    ];
    let push = CompactPush { block_capacity, digit_bits: 8 };
    let compact = case(&COMPACT, &[0, 0], bytemuck::bytes_of(&push), buffers, n.div_ceil(COMPACT_GAUSSIANS));
    let mut done = run(options, compact);
    let histogram = done.swap_remove(8);
    let pairs = [done[6].clone(), done[7].clone()];
    let (counters, indirect) = (done[4].clone(), done[5].clone());
    assert_eq!(counters[3], 0, "the frame fits");
    let groups = |at: u32| indirect[at as usize] * indirect[at as usize + 1];
    let [_, order] = sort(options, &depth, pairs, histogram, &counters, (0, groups(INDIRECT_DEPTH_SORT)));

    let push = SumTileCountsPush { block_capacity };
    let buffers = vec![counters.clone(), tile_count.clone(), order.clone(), vec![0; words as usize]];
    let sums = case(&SUM_TILE_COUNTS, &[], bytemuck::bytes_of(&push), buffers, groups(INDIRECT_EMIT));
    let sums = run(options, sums).swap_remove(3);
    let push = EmitTilesPush { block_capacity, digit_bits: tile.digits[0].bits };
    let out = vec![0; capacity as usize];
    let buffers = vec![
        frame_words.clone(),
        counters.clone(),
        tile_count,
        order,
        splats.clone(),
        sums,
        out.clone(),
        out,
        vec![0; tile.histogram_rows() as usize * 256],
        vec![0; 4],
        vec![0; 4],
    ];
    let emit = case(&EMIT_TILES, &[0; 4], bytemuck::bytes_of(&push), buffers, groups(INDIRECT_EMIT));
    let mut done = run(options, emit);
    let histogram = done.swap_remove(8);
    let pairs = [done[6].clone(), done[7].clone()];
    let [keys, values] = sort(options, &tile, pairs, histogram, &counters, (5, groups(INDIRECT_TILE_SORT)));
    let buffers = vec![frame_words.clone(), counters, keys, vec![0; 2 * frame.limits[1] as usize]];
    let ranges = case(&TILE_RANGES, &[], &[], buffers, groups(INDIRECT_RANGES));
    [frame_words, run(options, ranges).swap_remove(3), values, splats]
}

fn blend_case(
    kernel: &'static Kernel,
    options: &Options,
    stage: Stage,
    lists: &[Vec<u32>; 4],
    frame: &Frame,
) -> UntypedCase {
    let per_lane = blend::pixels_per_lane(options.lanes);
    let mut buffers = lists.to_vec();
    let pixels = frame.pixels();
    buffers.extend([vec![0; 4 * pixels], vec![0; pixels], Vec::new()]);
    let groups = blend::groups(frame.limits[1], options.lanes, per_lane) as u32;
    case(kernel, &[1, stage as u32, per_lane, 0, 0, 0, 0], &[], buffers, groups)
}

fn truth(input: &RenderInput, camera: &Camera) -> Vec<f64> {
    let options =
        ReferenceOptions { background: [0.1, 0.2, 0.3].map(|c: f32| c.into()), ..ReferenceOptions::default() };
    reference::render(&input.scene(), camera, f64::from(0.3_f32), &options).unwrap().rgb
}

/// The usual order, and with all that Vulkan leaves open.
fn variants(lanes: u32) -> [Options; 3] {
    let usual = Options::new(lanes, 1);
    [
        usual,
        Options { seed: 2, burst: 1, ..usual },
        Options { seed: 3, subgroup_barrier_is_workgroup: true, groups_in_flight: 8, ..usual },
    ]
}

#[test]
fn a_frame_at_every_subgroup_size() {
    let input = RenderInput::random(700, 1, 5).moving(5, 4);
    let camera = test_camera(75, 53);
    let frame = input.frame(&camera);
    let truth = truth(&input, &camera);
    for lanes in [4, 16, 32, 64, 128] {
        for options in variants(lanes) {
            let lists = lists(&options, &input, &frame, 20_000);
            for stage in [Stage::Shuffle, Stage::Shared, Stage::Reread] {
                let image = run(&options, blend_case(&BLEND, &options, stage, &lists, &frame)).swap_remove(4);
                let rgb = image.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(|w| f64::from(f32::from_bits(w)));
                let d = difference(truth.iter().copied(), rgb);
                println!("{lanes} lanes, {stage:?}: {:.1} dB", d.psnr);
                assert!(d.psnr >= 85.0, "{options:?}, {stage:?}: {d:?}");
            }
        }
    }
}

/// The kernels that store to an image hold what those of buffers do: bits as floats, levels within one.
#[test]
fn images_hold_what_buffers_do() {
    let input = RenderInput::random(400, 1, 6);
    let frame = input.frame(&test_camera(75, 53));
    let pixels = frame.pixels();
    for lanes in [32, 64, 128] {
        let options = Options::new(lanes, 7);
        let lists = lists(&options, &input, &frame, 20_000);
        for (kernel, format) in [
            (&BLEND_RGBA8, PixelFormat::Rgba8),
            (&BLEND_RGBA16F, PixelFormat::Rgba16F),
            (&BLEND_RGBA32F, PixelFormat::Rgba32F),
        ] {
            let mut buffer = blend_case(&BLEND_PACKED, &options, Stage::Shared, &lists, &frame);
            if format == PixelFormat::Rgba32F {
                buffer.kernel = &BLEND;
            } else {
                buffer.spec.push(format as u32);
            }
            let words = format.bytes() as usize / 4;
            buffer.buffers[4] = vec![0; words * pixels];
            let mut image = buffer.clone();
            image.kernel = kernel;
            image.spec.truncate(7);
            image.push = vec![0; 8];
            image.buffers[4..7].rotate_left(1);
            image.buffers[5] = vec![0; 4];
            let [of_buffer, of_image] = [&buffer, &image].map(|case| model::run(case, &options));
            let pairs = of_buffer[4].chunks_exact(words).zip(of_image[6].chunks_exact(words));
            let far = pairs.filter(|(b, i)| {
                let (b, i) = (format.unpack(b), format.unpack(i));
                let step = if words == 1 { 1.01 / 255.0 } else { 0.0 };
                b.iter().zip(i).any(|(b, i)| (b - i).abs() > step)
            });
            assert_eq!(far.count(), 0, "{lanes} lanes, {format:?}");
        }
    }
}
