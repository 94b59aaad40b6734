//! Compaction, emission and ranges on the device against their twins, bit for bit, chained as in a frame.

use engine::render::compact::*;
use engine::render::ellipse::Ellipse;
use engine::render::emit_tiles::{EMIT_TILES, EmitTiles, EmitTilesBuffers, EmitTilesConstants, EmitTilesPush};
use engine::render::frame::Frame;
use engine::render::limits::INSTANCE_GAUSSIAN;
use engine::render::radix_sort::*;
use engine::render::sort_scatter::{SORT_SCATTER, SortScatterBuffers};
use engine::render::sort_spine::{SORT_SPINE, SPINE_GROUPS, SortSpineBuffers};
use engine::render::sum_tile_counts::{SUM_TILE_COUNTS, SumTileCountsBuffers, SumTileCountsPush};
use engine::render::tile_ranges::{TILE_RANGES, TileRangesBuffers};
use engine::render::tiles::{block_words, tile_key_bits};
use tests_harness::{KernelCase, TestGpu, widths};

struct Rng(u64);

impl Rng {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as u32 ^ (self.0 >> 12) as u32
    }

    fn unit(&mut self) -> f32 {
        (self.next() >> 8) as f32 / 16_777_216.0
    }
}

/// Projected Gaussians as `deform_project` leaves them, in words.
struct Scene {
    frame: Frame,
    tile_count: Vec<u32>,
    splats: Vec<u32>,
    depths: u32,
}

impl Scene {
    fn random(n: u32, size: [u32; 2], seed: u64) -> Self {
        let mut rng = Rng(seed);
        let tiles = size.map(|s| s.div_ceil(16));
        let frame = Frame { size, tiles, gaussians: n, tile_count: tiles[0] * tiles[1], ..Frame::default() };
        let mut scene = Self { frame, tile_count: vec![], splats: vec![], depths: 97 };
        for _ in 0..n {
            let l = 10_f32.powf(rng.unit() * 3.0 - 2.9);
            let first = [
                (rng.unit() * 1.6 - 0.3) * size[0] as f32,
                (rng.unit() * 1.6 - 0.3) * size[1] as f32,
                l,
                (rng.unit() - 0.5) * 2.0 * l,
            ];
            let z = 0.25 + (rng.next() % scene.depths) as f32 * 0.37;
            scene.push(first, [l * (0.3 + 2.0 * rng.unit()), (rng.unit() + 1e-3).log2(), z, 0.0]);
        }
        scene
    }

    fn push(&mut self, first: [f32; 4], second: [f32; 4]) {
        let e = Ellipse::of_splat(first, second);
        self.tile_count.push(e.tile_count(self.frame.size));
        self.splats.extend(first.iter().chain(&second).chain(&[0.0; 4]).map(|v| v.to_bits()));
        self.frame.gaussians = self.tile_count.len() as u32;
    }

    fn total(&self) -> u64 {
        self.tile_count.iter().map(|c| u64::from(*c)).sum()
    }

    /// The chain of a frame on the device; every kernel is compared with its twin. Returns counters, indirect
    /// arguments and ranges.
    fn check(&self, gpu: &TestGpu, capacity: u32) -> (Vec<u32>, Vec<u32>, Vec<u32>) {
        self.check_from(gpu, capacity, 0)
    }

    /// The same when the counters say `failed` before the chain begins.
    fn check_from(&self, gpu: &TestGpu, capacity: u32, failed: u32) -> (Vec<u32>, Vec<u32>, Vec<u32>) {
        let n = self.tile_count.len() as u32;
        let tiles = self.frame.tile_count;
        let frame: Vec<u32> = bytemuck::cast_slice(&[Frame { instance_capacity: capacity, ..self.frame }]).to_vec();
        let (words, block_capacity) = block_words(n);
        let mut visible_block = vec![0; words as usize];
        for (i, count) in self.tile_count.iter().enumerate() {
            visible_block[i / 256] += u32::from(*count != 0);
            visible_block[block_capacity as usize + i / 65_536] += u32::from(*count != 0);
        }
        let visible: u32 = self.tile_count.iter().map(|c| u32::from(*c != 0)).sum();
        let counters = vec![visible, self.total() as u32, (self.total() >> 32) as u32, failed, 0, 0, 0, 0];
        let depth = SortPlan::new(n, 32).unwrap();
        let tile = SortPlan::new(capacity, tile_key_bits(tiles)).unwrap();
        let out = vec![0; n as usize];
        let buffers = CompactBuffers {
            frame: frame.clone(),
            tile_count: self.tile_count.clone(),
            splats: self.splats.clone(),
            visible_block,
            counters,
            indirect: vec![0; 16],
            keys: out.clone(),
            values: out,
            next_histogram: vec![0; depth.histogram_rows() as usize * 256],
        };
        let push = CompactPush {
            block_capacity,
            digit_bits: 8,
            depth_partition_shift: depth.partition_shift(),
            tile_partition_shift: tile.partition_shift(),
        };
        let constants = CompactConstants::default();
        let case = KernelCase { kernel: &COMPACT, constants, push, buffers, groups: n.div_ceil(1024) + 1 };
        let CompactBuffers { counters, indirect, keys, values, next_histogram, .. } = case.check(gpu, "chain");
        let groups = |at: u32| indirect[at as usize] * indirect[at as usize + 1];
        let order = sort(gpu, &depth, keys, values, next_histogram, &counters, 0, groups(INDIRECT_DEPTH_SORT)).1;

        let push = SumTileCountsPush { block_capacity };
        let buffers = SumTileCountsBuffers {
            counters: counters.clone(),
            tile_count: self.tile_count.clone(),
            order: order.clone(),
            instance_block: vec![0; words as usize],
        };
        let emit_groups = groups(INDIRECT_EMIT) + 1;
        let case = KernelCase { kernel: &SUM_TILE_COUNTS, constants: (), push, buffers, groups: emit_groups };
        let instance_block = case.check(gpu, "chain").instance_block;
        let out = vec![0; capacity as usize];
        let buffers = EmitTilesBuffers {
            frame: frame.clone(),
            counters: counters.clone(),
            tile_count: self.tile_count.clone(),
            order,
            splats: self.splats.clone(),
            instance_block,
            keys: out.clone(),
            values: out,
            next_histogram: vec![0; tile.histogram_rows() as usize * 256],
            gaussian_of_slot: None,
            first_slot: None,
        };
        let push =
            EmitTilesPush { block_capacity, digit_bits: tile.digits[0].bits, partition_shift: tile.partition_shift() };
        let constants = EmitTilesConstants::default();
        let case = KernelCase { kernel: &EMIT_TILES, constants, push, buffers, groups: emit_groups };
        let emitted = case.clone().check(gpu, "chain");
        self.check_slots(gpu, case, &emitted, &counters);
        let EmitTilesBuffers { keys, values, next_histogram, .. } = emitted;
        let keys = sort(gpu, &tile, keys, values, next_histogram, &counters, 5, groups(INDIRECT_TILE_SORT)).0;
        // `ranges` is zeroed each frame and only partly written, so it is compared where it was written.
        let ranges = vec![0; 2 * tiles as usize];
        let buffers = TileRangesBuffers { frame, counters: counters.clone(), keys, ranges };
        let groups = groups(INDIRECT_RANGES) + 1;
        let ranges =
            KernelCase { kernel: &TILE_RANGES, constants: (), push: (), buffers, groups }.check(gpu, "chain").ranges;
        (counters, indirect, ranges)
    }

    /// Slots are another name for the same instances, and those of a Gaussian follow one another.
    fn check_slots(
        &self,
        gpu: &TestGpu,
        mut case: KernelCase<EmitTiles>,
        without: &EmitTilesBuffers<Vec<u32>>,
        counters: &[u32],
    ) {
        case.constants.with_slots = 1;
        case.buffers.gaussian_of_slot = Some(vec![0; without.keys.len()]);
        case.buffers.first_slot = Some(vec![0; self.tile_count.len()]);
        let with = case.check(gpu, "with slots");
        let (gaussian_of_slot, first_slot) = (with.gaussian_of_slot.unwrap(), with.first_slot.unwrap());
        assert_eq!(with.keys, without.keys);
        let instances = counters[5] as usize;
        assert!(with.values[..instances].iter().zip(0..).all(|(slot, i)| *slot == i));
        assert_eq!(gaussian_of_slot[..instances], without.values[..instances]);
        for (g, first) in first_slot.iter().enumerate().filter(|_| counters[3] == 0) {
            let own = (0..self.tile_count[g]).map(|k| (first + k) as usize).filter(|&slot| slot < instances);
            own.for_each(|slot| assert_eq!(gaussian_of_slot[slot] & INSTANCE_GAUSSIAN, g as u32));
        }
    }
}

fn sort(
    gpu: &TestGpu,
    plan: &SortPlan,
    mut keys: Vec<u32>,
    mut values: Vec<u32>,
    mut histogram: Vec<u32>,
    counters: &[u32],
    count_word: u32,
    groups: u32,
) -> (Vec<u32>, Vec<u32>) {
    for pass in 0..plan.digits.len() {
        if plan.prescanned {
            let buffers = SortSpineBuffers { counters: counters.to_vec(), histogram };
            let push = plan.spine_push(count_word);
            let case = KernelCase { kernel: &SORT_SPINE, constants: (), push, buffers, groups: SPINE_GROUPS };
            histogram = case.check(gpu, "chain").histogram;
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
        let constants = plan.scatter_constants(pass, true, rank_by_ballot(gpu.subgroup_size_of(&SORT_SCATTER)));
        let (push, groups) = (plan.scatter_push(pass, count_word), groups.max(1));
        let case = KernelCase { kernel: &SORT_SCATTER, constants, push, buffers, groups };
        let done = case.check(gpu, "chain");
        histogram = done.next_histogram.unwrap_or_default();
        values = done.values_out.unwrap();
        keys = done.keys_out;
    }
    let count = counters[count_word as usize] as usize;
    assert!(counters[3] != 0 || keys[..count].is_sorted());
    (keys, values)
}

#[test]
fn chain_equals_twins() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    for (n, size) in [
        (1, [64, 64]),
        (31, [1, 1]),
        (255, [100, 90]),
        (256, [16, 16]),
        (257, [33, 17]),
        (1025, [400, 300]),
        (5000, [200, 200]),
        (70_000, [100, 60]),
    ] {
        if tests_harness::small() && n > 5000 {
            continue;
        }
        let scene = Scene::random(n, size, 21 + u64::from(n));
        let (counters, _, _) = scene.check(&gpu, scene.total() as u32 + 100);
        assert_eq!((counters[3], u64::from(counters[5])), (0, scene.total()));
    }
}

#[test]
fn nothing_visible() {
    let gpu = tests_harness::shared_gpu();
    let mut scene = Scene::random(300, [64, 64], 5);
    scene.tile_count.fill(0);
    let (counters, indirect, _) = scene.check(&gpu, 100);
    assert_eq!((counters[3], counters[5]), (0, 0));
    assert_eq!(indirect, [0, 0, 1, 0].repeat(4));
}

#[test]
fn capacity_is_exact() {
    let gpu = tests_harness::shared_gpu();
    let scene = Scene::random(600, [200, 200], 41);
    let total = scene.total() as u32;
    assert_eq!(scene.check(&gpu, total).0[3], 0);
    let (counters, indirect, _) = scene.check(&gpu, total - 1);
    assert_eq!((counters[3], counters[5]), (1, 0));
    assert_eq!(indirect, [0, 0, 1, 0].repeat(4));
}

#[test]
fn a_failure_from_before_stops_the_chain() {
    let gpu = tests_harness::shared_gpu();
    let scene = Scene::random(600, [200, 200], 41);
    let (counters, indirect, _) = scene.check_from(&gpu, scene.total() as u32, 1);
    assert_eq!((counters[3], counters[5]), (1, 0));
    assert_eq!(indirect, [0, 0, 1, 0].repeat(4));
}

#[test]
fn counts_that_disagree() {
    let gpu = tests_harness::shared_gpu();
    for error in [3_i32, -2] {
        let mut scene = Scene::random(600, [200, 200], 31);
        for count in scene.tile_count.iter_mut().filter(|c| **c != 0) {
            *count = (*count as i32 + error).max(1) as u32;
        }
        scene.check(&gpu, scene.total() as u32);
    }
}

#[test]
fn splats_over_the_whole_screen() {
    let gpu = tests_harness::shared_gpu();
    let mut scene = Scene::random(300, [1920, 1080], 51);
    for i in 0..4 {
        scene.push([900.0, 500.0, 1e-5, 0.0], [1e-5, -0.1, 3.0 + i as f32, 0.0]);
    }
    assert_eq!(*scene.tile_count.last().unwrap(), 8160);
    scene.check(&gpu, scene.total() as u32);
}

#[test]
fn more_than_one_super_block() {
    // 70,001 visible Gaussians: 274 blocks, two super sums; and every instance in one tile.
    let gpu = tests_harness::shared_gpu();
    let mut scene = Scene::random(0, [16, 16], 1);
    for i in 0..70_001_u32 {
        scene.push([8.0, 8.0, 0.5, 0.1], [0.4, -0.1, 1.0 + (i % 13) as f32, 0.0]);
    }
    let (_, _, ranges) = scene.check(&gpu, 80_000);
    assert_eq!(ranges, [0, 70_001]);
}
