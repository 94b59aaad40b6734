//! A whole small frame on the model, the output of one kernel as the input of the next, against the twins and the f64
//! reference.

use engine::gpu::Kernel;
use engine::gpu::interface::{Buffers, Constants as _, Interface};
use engine::gpu::proof;
use engine::image::difference;
use engine::reference::{self, ReferenceOptions};
use engine::render::PixelFormat;
use engine::render::blend::{self, BLEND, Blend, BlendBuffers, BlendConstants, Stage};
use engine::render::blend_image::BlendImageBuffers;
use engine::render::blend_packed::{BLEND_PACKED, BlendPackedBuffers, BlendPackedConstants};
use engine::render::blend_rgba8::BLEND_RGBA8;
use engine::render::blend_rgba16f::BLEND_RGBA16F;
use engine::render::blend_rgba32f::BLEND_RGBA32F;
use engine::render::deform_project::{DeformProjectBuffers, DeformProjectPush};
use engine::render::emit_tiles::EmitTilesConstants;
use engine::render::frame::Frame;
use engine::render::sort_tiles::SortTilesBuffers;
use engine::render::tiles::block_words;
use engine::scene::Camera;
use tests_harness::KernelCase;
use tests_harness::model::{self, Options};
use tests_harness::render_case::{RenderInput, test_camera};
use tests_harness::tile_chain::{TileChain, TileLists, filled, sort};

/// A kernel on the model, compared with its twin.
fn check<I: Interface>(options: &Options, case: KernelCase<I>) -> I::Buffers<Vec<u32>> {
    let result = case.run_model(options);
    result.assert_equal(&format!("{options:?}"));
    result.gpu
}

/// What `blend` reads.
struct Lists {
    frame: Vec<u32>,
    ranges: Vec<u32>,
    values: Vec<u32>,
    splats: Vec<u32>,
}

fn lists(options: &Options, input: &RenderInput, frame: &Frame, capacity: u32) -> Lists {
    let mut frame = *frame;
    frame.instance_capacity = capacity;
    let (words, block_capacity) = block_words(input.count as u32);
    let mut project = input.deform_project(&frame);
    project.buffers.instance_block = vec![0; words as usize];
    project.push = DeformProjectPush { block_capacity };
    // A Gaussian at the edge of a tile may count otherwise than in the twin: here the picture decides.
    let DeformProjectBuffers { splats, tile_count, instance_block, counters, tile_end, .. } =
        project.run_model(options).gpu;
    let constants = EmitTilesConstants::default();
    let chain = TileChain {
        frame,
        counters,
        tile_count,
        splats: splats.clone(),
        tile_change: tile_end,
        instance_block,
        block_capacity,
        constants,
    };
    let packed = chain.run(options);
    assert_eq!(packed.counters[3], 0, "the frame fits");
    assert_filled(options, input, &frame, &packed);
    let TileLists { ranges, values, .. } = packed;
    Lists { frame: chain.frame_words(), ranges, values, splats }
}

/// A frame whose lists `deform_project` fills itself has the same ones.
fn assert_filled(options: &Options, input: &RenderInput, frame: &Frame, packed: &TileLists) {
    let room = input.count.next_multiple_of(32) as u32;
    let case = input.deform_project_with_lists(&Frame { tile_room: room, ..*frame });
    let sorted = sort(options, filled(case.run_model(options).gpu), false);
    let SortTilesBuffers { counters, ranges, values, .. } = sorted;
    assert_eq!(counters[3], 0, "the lists fit");
    let own = TileLists { counters, ranges, values };
    assert!(own.lists().eq(packed.lists()), "{options:?}: other lists");
}

fn blend_case(options: &Options, stage: Stage, lists: &Lists, frame: &Frame) -> KernelCase<Blend> {
    let pixels_per_lane = blend::pixels_per_lane(options.lanes);
    let pixels = frame.pixels();
    let buffers = BlendBuffers {
        frame: lists.frame.clone(),
        ranges: lists.ranges.clone(),
        values: lists.values.clone(),
        splats: lists.splats.clone(),
        color: vec![0; 4 * pixels],
        depth: Some(vec![0; pixels]),
        gaussian_of_slot: None,
    };
    let constants = BlendConstants { with_depth: 1, stage: stage as u32, pixels_per_lane, ..BlendConstants::default() };
    let groups = blend::groups(frame.tile_count, options.lanes, pixels_per_lane).max(1) as u32;
    KernelCase { kernel: &BLEND, constants, push: (), buffers, groups }
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
                let image = check(&options, blend_case(&options, stage, &lists, &frame)).color;
                let rgb = image.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(|w| f64::from(f32::from_bits(w)));
                let d = difference(truth.iter().copied(), rgb);
                println!("{lanes} lanes, {stage:?}: {:.1} dB", d.psnr);
                assert!(d.psnr >= 85.0, "{options:?}, {stage:?}: {d:?}");
            }
        }
    }
}

/// What the kernel that stores a format to a buffer leaves there.
fn of_buffer(options: &Options, case: KernelCase<Blend>, format: PixelFormat) -> Vec<u32> {
    if format == PixelFormat::Rgba32F {
        return case.run_model(options).gpu.color;
    }
    let BlendBuffers { frame, ranges, values, splats, color, depth, gaussian_of_slot } = case.buffers;
    let pixels = vec![0; color.len() / 4 * (format.bytes() as usize / 4)];
    let buffers = BlendPackedBuffers { frame, ranges, values, splats, pixels, depth, gaussian_of_slot };
    let constants = BlendPackedConstants::new(case.constants, format);
    let case = KernelCase { kernel: &BLEND_PACKED, constants, push: (), buffers, groups: case.groups };
    case.run_model(options).gpu.pixels
}

/// What the kernel that stores a format to an image leaves there.
fn of_image(options: &Options, kernel: &'static Kernel, case: KernelCase<Blend>, format: PixelFormat) -> Vec<u32> {
    let BlendBuffers { frame, ranges, values, splats, color, depth, gaussian_of_slot } = case.buffers;
    let buffers = BlendImageBuffers { frame, ranges, values, splats, depth, gaussian_of_slot };
    let mut buffers: Vec<Vec<u32>> = buffers.into_list().into_iter().map(Option::unwrap_or_default).collect();
    // The image comes after the buffers.
    buffers.push(vec![0; color.len() / 4 * (format.bytes() as usize / 4)]);
    let (spec, push) = (case.constants.to_words(), vec![0; kernel.push_bytes() as usize]);
    model::run(&proof::KernelCase { kernel, spec, push, buffers, groups: case.groups }, options).pop().unwrap()
}

/// The kernels that store to an image hold what those of buffers do: bits as floats, levels within one.
#[test]
fn images_hold_what_buffers_do() {
    let input = RenderInput::random(400, 1, 6);
    let frame = input.frame(&test_camera(75, 53));
    let to_image: [(&Kernel, PixelFormat); 3] = [
        (&BLEND_RGBA8, PixelFormat::Rgba8),
        (&BLEND_RGBA16F, PixelFormat::Rgba16F),
        (&BLEND_RGBA32F, PixelFormat::Rgba32F),
    ];
    for lanes in [32, 64, 128] {
        let options = Options::new(lanes, 7);
        let lists = lists(&options, &input, &frame, 20_000);
        for (kernel, format) in to_image {
            let case = || blend_case(&options, Stage::Shared, &lists, &frame);
            let words = format.bytes() as usize / 4;
            let (of_buffer, of_image) =
                (of_buffer(&options, case(), format), of_image(&options, kernel, case(), format));
            let pairs = of_buffer.chunks_exact(words).zip(of_image.chunks_exact(words));
            let far = pairs.filter(|(b, i)| {
                let (b, i) = (format.unpack(b), format.unpack(i));
                let step = if words == 1 { 1.01 / 255.0 } else { 0.0 };
                b.iter().zip(i).any(|(b, i)| (b - i).abs() > step)
            });
            assert_eq!(far.count(), 0, "{lanes} lanes, {format:?}");
        }
    }
}
