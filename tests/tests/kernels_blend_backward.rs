//! `blend_backward` and `sum_instance_gradients` on the device against their twins.

use engine::gpu::interface::{Interface, KernelOf};
use engine::render::blend::{self, BLEND, BlendBuffers, BlendConstants, MIN_TRANSMITTANCE, Stage};
use engine::render::blend_states::{BLEND_STATES, BlendStates, BlendStatesBuffers, BlendStatesConstants};
use engine::render::deform_project::DEFORM_PROJECT;
use engine::render::frame::Frame;
use engine::render::limits::{COUNT_FAILED, INSTANCE_GAUSSIAN};
use engine::render::segments::Segments;
use engine::train::blend_backward::blend_backward_native::BLEND_BACKWARD_NATIVE;
use engine::train::blend_backward::sum_instance_gradients::*;
use engine::train::blend_backward::{self, *};
use tests_harness::gradient::{assert_gradients_close, columns};
use tests_harness::kernel_case::POISON;
use tests_harness::render_case::{Random, RenderInput, test_camera, tile_lists};
use tests_harness::{KernelCase, TestGpu, widths};

/// A rendered frame with tile lists of Gaussians and of slots, and a gradient of its image.
struct Rendered {
    frame: Frame,
    splats: Vec<u32>,
    tile_count: Vec<u32>,
    ranges: Vec<u32>,
    gaussians: Vec<u32>,
    slots: Vec<u32>,
    gaussian_of_slot: Vec<u32>,
    first_slot: Vec<u32>,
    color: Vec<u32>,
    image_gradient: Vec<u32>,
    segments: Segments,
    /// Whether the sums of absolute gradients are wanted.
    absolute: bool,
}

impl Rendered {
    fn of_input(input: &RenderInput, size: [u32; 2]) -> Self {
        let frame = input.frame(&test_camera(size[0], size[1]));
        let case = input.deform_project(&frame);
        let done = DEFORM_PROJECT.run_twin(8, case.constants, case.push, case.buffers, case.groups);
        Self::of_splats(frame, done.splats, done.tile_count)
    }

    /// `layers` splats over the middle of the image, one behind the other.
    fn layers(layers: usize, log2_opacity: f32, size: [u32; 2]) -> Self {
        let frame = RenderInput { count: layers, ..RenderInput::default() }.frame(&test_camera(size[0], size[1]));
        let mut r = Random(layers as u64);
        let splats: Vec<u32> = (0..layers)
            .flat_map(|k| {
                let mean = size.map(|s| r.range(0.3, 0.7) * s as f32);
                let colour = [r.unit(), r.unit(), r.unit()];
                let shape = [r.range(0.02, 0.2), r.range(-0.05, 0.05), r.range(0.02, 0.2)];
                [mean[0], mean[1], shape[0], shape[1], shape[2], log2_opacity, 1.0 + k as f32, 0.0]
                    .into_iter()
                    .chain(colour)
                    .chain([0.0])
            })
            .map(f32::to_bits)
            .collect();
        let ellipse = |k: usize| {
            let at = |j: usize| engine::render::twin::vec4_at(&splats, 3 * k + j);
            engine::render::ellipse::Ellipse::of_splat(at(0), at(1))
        };
        let tile_count = (0..layers).map(|k| ellipse(k).tile_count(size)).collect();
        Self::of_splats(frame, splats, tile_count)
    }

    fn of_splats(frame: Frame, splats: Vec<u32>, tile_count: Vec<u32>) -> Self {
        let (ranges, gaussians) = tile_lists(&frame, &splats, &tile_count);
        // Slots: Gaussians in depth order, each with its tiles in order.
        let mut order: Vec<usize> = (0..tile_count.len()).filter(|&g| tile_count[g] > 0).collect();
        order.sort_by_key(|&g| splats[12 * g + 6]);
        let (mut first_slot, mut gaussian_of_slot) = (vec![u32::MAX; tile_count.len()], Vec::new());
        for g in order {
            first_slot[g] = gaussian_of_slot.len() as u32;
            gaussian_of_slot.extend(std::iter::repeat_n(g as u32, tile_count[g] as usize));
        }
        let mut next = first_slot.clone();
        let mut slots = Vec::new();
        for &instance in &gaussians {
            let g = (instance & INSTANCE_GAUSSIAN) as usize;
            gaussian_of_slot[next[g] as usize] = instance;
            slots.push(next[g]);
            next[g] += 1;
        }
        let pixels = frame.pixels();
        let buffers = BlendBuffers {
            frame: bytemuck::cast_slice(&[frame]).to_vec(),
            ranges: ranges.clone(),
            values: gaussians.clone(),
            splats: splats.clone(),
            color: vec![0; 4 * pixels],
            depth: None,
            gaussian_of_slot: None,
        };
        let constants = BlendConstants { pixels_per_lane: 8, ..BlendConstants::default() };
        let mut r = Random(pixels as u64);
        let image_gradient = (0..4 * pixels).map(|_| r.range(-1.0, 1.0).to_bits()).collect();
        let color = BLEND.run_twin(8, constants, (), buffers, 1).color;
        Self {
            frame,
            splats,
            tile_count,
            ranges,
            gaussians,
            slots,
            gaussian_of_slot,
            first_slot,
            color,
            image_gradient,
            segments: Segments::WHOLE,
            absolute: true,
        }
    }

    /// The same with lists in segments.
    fn cut(self, per_list: u32, least: u32) -> Self {
        Self { segments: Segments { per_list, least }, ..self }
    }

    /// The forward pass that keeps states, of lists of Gaussians or of slots.
    fn states_case(&self, stage: Stage, size: u32, with_slots: bool) -> KernelCase<BlendStates> {
        let pixels_per_lane = blend::pixels_per_lane(size);
        let with = u32::from(with_slots);
        let blend =
            BlendConstants { stage: stage as u32, pixels_per_lane, with_slots: with, ..BlendConstants::default() };
        let pixels = self.frame.pixels();
        KernelCase {
            kernel: &BLEND_STATES,
            constants: BlendStatesConstants::new(blend, self.segments),
            push: (),
            buffers: BlendStatesBuffers {
                frame: bytemuck::cast_slice(&[self.frame]).to_vec(),
                ranges: self.ranges.clone(),
                values: if with_slots { self.slots.clone() } else { self.gaussians.clone() },
                splats: self.splats.clone(),
                color: vec![0; 4 * pixels],
                gaussian_of_slot: with_slots.then(|| self.gaussian_of_slot.clone()),
                states: vec![POISON; self.segments.state_bytes(pixels as u64) as usize / 4],
            },
            groups: blend::groups(self.frame.tile_count, size, pixels_per_lane) as u32,
        }
    }

    /// What the forward pass kept, by the twin; `None` of whole lists.
    fn states(&self) -> Option<Vec<u32>> {
        (self.segments.per_list > 1).then(|| {
            let KernelCase { constants, buffers, .. } = self.states_case(Stage::Shuffle, 8, false);
            BLEND_STATES.run_twin(8, constants, (), buffers, 1).states
        })
    }

    fn buffers(&self, accumulation: Accumulation) -> BlendBackwardBuffers<Vec<u32>> {
        let by_slot = accumulation == Accumulation::Instances;
        let rows = if by_slot { self.gaussian_of_slot.len() } else { self.tile_count.len() };
        BlendBackwardBuffers {
            frame: bytemuck::cast_slice(&[self.frame]).to_vec(),
            ranges: self.ranges.clone(),
            values: if by_slot { self.slots.clone() } else { self.gaussians.clone() },
            gaussian_of_slot: by_slot.then(|| self.gaussian_of_slot.clone()),
            splats: self.splats.clone(),
            color: self.color.clone(),
            image_gradient: self.image_gradient.clone(),
            gradient_rows: vec![0; ROW_WORDS as usize * rows],
            states: self.states(),
        }
    }

    /// Gradient rows of the device and of the twin.
    fn rows(&self, gpu: &TestGpu, accumulation: Accumulation, stage: Stage, subtiles: u32) -> [Vec<u32>; 2] {
        match accumulation {
            Accumulation::NativeAtomics => self.rows_of(&BLEND_BACKWARD_NATIVE, gpu, accumulation, stage, subtiles),
            _ => self.rows_of(&BLEND_BACKWARD, gpu, accumulation, stage, subtiles),
        }
    }

    fn rows_of<I>(
        &self,
        kernel: &'static KernelOf<I>,
        gpu: &TestGpu,
        accumulation: Accumulation,
        stage: Stage,
        subtiles: u32,
    ) -> [Vec<u32>; 2]
    where
        I: Interface<Constants = BlendBackwardConstants, Push = (), Buffers<Vec<u32>> = BlendBackwardBuffers<Vec<u32>>>,
    {
        let size = gpu.subgroup_size_of(kernel);
        let constants = BlendBackwardConstants::new(accumulation, stage, size, subtiles, self.segments, self.absolute);
        let groups = blend_backward::groups(self.frame.tile_count * self.segments.per_list, size, subtiles) as u32;
        let result = KernelCase { kernel, constants, push: (), buffers: self.buffers(accumulation), groups }.run(gpu);
        [result.gpu.gradient_rows, result.twin.gradient_rows]
    }

    fn sum_case(&self, rows: Vec<u32>) -> KernelCase<SumInstanceGradients> {
        let gaussians = self.tile_count.len() as u32;
        KernelCase {
            kernel: &SUM_INSTANCE_GRADIENTS,
            constants: (),
            push: SumInstanceGradientsPush { gaussians },
            buffers: SumInstanceGradientsBuffers {
                counters: vec![0, 0, 0, 0, 0, self.gaussian_of_slot.len() as u32, 0, 0],
                tile_count: self.tile_count.clone(),
                first_slot: self.first_slot.clone(),
                instance_gradient: rows,
                splat_gradient: vec![0; (ROW_WORDS * gaussians) as usize],
            },
            groups: (3 * gaussians).div_ceil(256).max(1),
        }
    }

    /// Every way of adding, on the device and by twins, and all of them against each other.
    fn check(&self, gpu: &TestGpu, context: &str) -> Vec<f32> {
        let all = blend_backward::subtiles_of_tile(gpu.subgroup_size_of(&BLEND_BACKWARD));
        let mut truth: Option<Vec<f32>> = None;
        for stage in [Stage::Shuffle, Stage::Shared] {
            for (accumulation, subtiles) in [
                (Accumulation::Instances, all),
                (Accumulation::CompareAndSwap, all),
                (Accumulation::CompareAndSwap, 1),
                (Accumulation::NativeAtomics, all),
                (Accumulation::NativeAtomics, 1),
            ] {
                // Each pipeline takes seconds to compile: in small, every choice once, not every pair of choices.
                let pair = match accumulation {
                    Accumulation::Instances => stage == Stage::Shuffle,
                    _ => (stage == Stage::Shared) == (subtiles == all),
                };
                if tests_harness::small() && !pair {
                    continue;
                }
                // The engine refuses this kernel on such a device.
                if accumulation == Accumulation::NativeAtomics && !gpu.info().capabilities.float_atomics {
                    continue;
                }
                let context = format!("{context}, {accumulation:?}, {stage:?}, {subtiles} subtiles");
                let [device, twin] = self.rows(gpu, accumulation, stage, subtiles);
                assert_rows_close(&floats(&device), &floats(&twin), &context);
                let rows = if accumulation == Accumulation::Instances {
                    let sums = self.sum_case(device).check(gpu, &context).splat_gradient;
                    floats(&sums[..12 * self.tile_count.len()])
                } else {
                    floats(&device)
                };
                let truth = truth.get_or_insert_with(|| {
                    // Of whole lists.
                    let (way, stage) = (Accumulation::CompareAndSwap, Stage::Shuffle);
                    let constants = BlendBackwardConstants::new(way, stage, 8, 4, Segments::WHOLE, self.absolute);
                    let buffers = BlendBackwardBuffers { states: None, ..self.buffers(way) };
                    floats(&BLEND_BACKWARD.run_twin(8, constants, (), buffers, 1).gradient_rows)
                });
                assert_rows_close(&rows[..truth.len()], truth, &context);
            }
        }
        truth.unwrap_or_default()
    }
}

fn floats(words: &[u32]) -> Vec<f32> {
    words.iter().map(|w| f32::from_bits(*w)).collect()
}

fn assert_rows_close(device: &[f32], twin: &[f32], context: &str) {
    let row = ROW_WORDS as usize;
    let n = twin.len() / row * row;
    for (name, range) in [
        ("h", 0..1),
        ("first moments", 1..3),
        ("second moments", 3..6),
        ("colour", 6..9),
        ("pixels", 9..10),
        ("absolute gradients", 10..12),
    ] {
        let columns = |v: &[f32]| columns(&v[..n], row, range.clone());
        assert_gradients_close(&columns(device), &columns(twin), &format!("{context}: {name}"));
    }
}

#[test]
fn gradients_match_the_twins() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    for (n, size) in [(1, [1, 1]), (1, [64, 64]), (40, [17, 1]), (300, [33, 17]), (700, [61, 47]), (0, [33, 17])] {
        let input = RenderInput::random(n, 1, n as u64);
        Rendered::of_input(&input, size).check(&gpu, &format!("{n} Gaussians, {size:?}"));
    }
}

/// They cost what trains without them nothing.
#[test]
fn absolute_gradients_are_left_out_unless_wanted() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    let all = blend_backward::subtiles_of_tile(gpu.subgroup_size_of(&BLEND_BACKWARD));
    let with = Rendered::layers(60, -2.0, [33, 17]);
    let [wanted, _] = with.rows(&gpu, Accumulation::Instances, Stage::Shuffle, all);
    let [device, twin] = Rendered { absolute: false, ..with }.rows(&gpu, Accumulation::Instances, Stage::Shuffle, all);
    let (wanted, device, twin) = (floats(&wanted), floats(&device), floats(&twin));
    let row = ROW_WORDS as usize;
    assert!(wanted[SIGNED_SUMS..row].iter().all(|sum| *sum > 0.0), "{wanted:?}");
    for ((one, two), twin) in device.chunks(row).zip(wanted.chunks(row)).zip(twin.chunks(row)) {
        assert_eq!((&one[..SIGNED_SUMS], &one[SIGNED_SUMS..]), (&two[..SIGNED_SUMS], &[0.0; 2][..]));
        assert_eq!(twin[SIGNED_SUMS..], [0.0; 2]);
    }
}

#[test]
fn layers_and_opaque_splats() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    for (layers, log2_opacity) in [(200, -5.0), (200, -1.0), (60, 0.0), (60, 3.0)] {
        let rows =
            Rendered::layers(layers, log2_opacity, [33, 17]).check(&gpu, &format!("{layers} at 2^{log2_opacity}"));
        assert!(rows[9] > 0.0 && rows[6] != 0.0, "the first layer is drawn");
    }
}

/// Lists of one tile that end around the ends of segments; opaque ones close pixels in front of the later segments.
#[test]
fn segments_add_up_to_the_list() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    for (layers, log2_opacity) in
        [(127, -6.0), (128, -6.0), (129, -6.0), (257, -6.0), (700, -6.5), (400, -1.0), (300, 3.0)]
    {
        let scene = Rendered::layers(layers, log2_opacity, [16, 16]).cut(4, 128);
        assert_eq!(scene.ranges, [0, layers as u32], "every layer reaches the tile");
        let kept = scene.states().unwrap();
        let boundaries = (layers - 1) / scene.segments.length(layers);
        let written = kept.iter().take_while(|w| **w != POISON).count();
        assert!(written == 4 * 256 * boundaries && kept[written..].iter().all(|w| *w == POISON), "{layers} layers");
        let closed = kept[..written].chunks_exact(4).filter(|s| f32::from_bits(s[3]) < 0.0).count();
        assert_eq!(closed > 50, log2_opacity >= -1.0, "{closed} pixels closed in front of a segment");
        scene.check(&gpu, &format!("{layers} at 2^{log2_opacity} in segments"));
    }
    // Several tiles, lists of different lengths, empty ones too.
    let input = RenderInput::random(3000, 1, 9);
    Rendered::of_input(&input, [61, 47]).cut(8, 1).check(&gpu, "3000 Gaussians in segments");
}

#[test]
fn states_match_the_twin() {
    let gpu = tests_harness::shared_gpu();
    let size = gpu.subgroup_size_of(&BLEND_STATES);
    let random = Rendered::of_input(&RenderInput::random(3000, 1, 9), [61, 47]);
    for (name, scene) in [("random", random), ("opaque", Rendered::layers(600, 3.0, [33, 17]))] {
        let scene = scene.cut(4, 128);
        for stage in [Stage::Shuffle, Stage::Shared, Stage::Reread] {
            for with_slots in [false, true] {
                // Each choice is a pipeline, which takes seconds to compile: in small, every choice once.
                if tests_harness::small() && with_slots != (stage == Stage::Shuffle) {
                    continue;
                }
                let context = format!("{name}, {stage:?}, slots: {with_slots}");
                let result = scene.states_case(stage, size, with_slots).run(&gpu);
                result.assert_equal(&context);
                let kept = result.gpu.states.chunks_exact(4).filter(|s| s[3] != POISON);
                let rest = kept.map(|s| f32::from_bits(s[3]).abs()).collect::<Vec<_>>();
                assert!(rest.len() > 100 && rest.iter().all(|t| (MIN_TRANSMITTANCE..=1.0).contains(t)), "{context}");
            }
        }
    }
}

#[test]
fn clamped_alpha_has_no_gradient() {
    let gpu = tests_harness::shared_gpu();
    // So opaque that alpha is clamped wherever it is drawn.
    let mut scene = Rendered::layers(1, 40.0, [16, 16]);
    scene.splats[2] = 0.01_f32.to_bits();
    scene.splats[4] = 0.01_f32.to_bits();
    let rows = scene.check(&gpu, "clamped");
    assert_eq!(rows[..6], [0.0; 6]);
    assert_eq!(rows[9], 256.0);
}

#[test]
fn poison_gives_finite_gradients() {
    let gpu = tests_harness::shared_gpu();
    let input = RenderInput::random(300, 1, 7);
    let clean = Rendered::of_input(&input, [33, 17]);
    let poisons = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -1e38, 1e-42];
    for poison in poisons.into_iter().take(if tests_harness::small() { 2 } else { 6 }) {
        let mut r = Random(11);
        let mut scene = Rendered { splats: clean.splats.clone(), ..Rendered::of_input(&input, [33, 17]) };
        for _ in 0..100 {
            let at = (r.bits() % scene.image_gradient.len() as u64) as usize;
            scene.image_gradient[at] = poison.to_bits();
        }
        // Gradients alone: what is left is exact.
        scene.check(&gpu, &format!("gradient with {poison}"));
        // Splats too: everything is finite, device and twin.
        for _ in 0..200 {
            let at = (r.bits() % scene.splats.len() as u64) as usize;
            scene.splats[at] = poison.to_bits();
        }
        for stage in [Stage::Shuffle, Stage::Shared].into_iter().take(if tests_harness::small() { 1 } else { 2 }) {
            let subtiles = blend_backward::subtiles_of_tile(gpu.subgroup_size_of(&BLEND_BACKWARD));
            for per_list in [1, 4] {
                scene.segments = Segments { per_list, least: 1 };
                let [device, twin] = scene.rows(&gpu, Accumulation::Instances, stage, subtiles);
                for (side, words) in [("device", device), ("twin", twin)] {
                    let finite = floats(&words).iter().all(|v| v.is_finite());
                    assert!(finite, "{side}, splats with {poison}, at most {per_list} segments");
                }
            }
        }
    }
}

#[test]
fn sums_stay_within_the_instances() {
    let gpu = tests_harness::shared_gpu();
    let scene = Rendered::layers(20, -1.0, [61, 47]);
    let rows: Vec<u32> = (0..12 * scene.gaussian_of_slot.len()).map(|i| (i as f32).to_bits()).collect();
    // A frame that failed has no gradients.
    let mut case = scene.sum_case(rows.clone());
    case.buffers.counters[COUNT_FAILED as usize] = 1;
    let sums = case.check(&gpu, "failed").splat_gradient;
    assert!(sums.iter().all(|w| *w == 0));
    // Slots that point anywhere read nothing past the instances.
    let mut case = scene.sum_case(rows);
    case.buffers.tile_count.iter_mut().step_by(3).for_each(|count| *count = u32::MAX);
    case.buffers.first_slot.iter_mut().step_by(2).for_each(|first| *first = u32::MAX - 3);
    case.check(&gpu, "wild slots");
}

#[test]
fn subtiles_cover_the_tile() {
    for size in [4, 8, 16, 32, 64, 128] {
        let all = blend_backward::subtiles_of_tile(size);
        assert_eq!(all * size * blend::pixels_per_lane(size), 256, "size {size}");
        assert_eq!(blend_backward::groups(7, size, all), u64::from((7 * size).div_ceil(128)));
    }
}
