//! The tile lists on the device against their twins, chained as in a frame, and against their definition.

use engine::render::ellipse::Ellipse;
use engine::render::emit_tiles::EmitTilesConstants;
use engine::render::frame::Frame;
use engine::render::limits::{FAILED_INSTANCES, INSTANCE_GAUSSIAN, TILE_PITCH};
use engine::render::scan_tiles::tile_change_words;
use engine::render::sort_tiles::{SORT_TILES, SORT_TILES_CAPACITY, SortTilesBuffers, long_from};
use engine::render::tiles::block_words;
use tests_harness::tile_chain::{TileChain, TileLists, sort, spread, unsorted, with_room};
use tests_harness::{TestGpu, widths};

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
    ellipses: Vec<Ellipse>,
    depths: Vec<f32>,
    tile_count: Vec<u32>,
    splats: Vec<u32>,
}

impl Scene {
    fn random(n: u32, size: [u32; 2], seed: u64) -> Self {
        let mut rng = Rng(seed);
        let tiles = size.map(|s| s.div_ceil(16));
        let frame = Frame { size, tiles, tile_count: tiles[0] * tiles[1], ..Frame::default() };
        let mut scene = Self { frame, ellipses: vec![], depths: vec![], tile_count: vec![], splats: vec![] };
        for _ in 0..n {
            let l = 10_f32.powf(rng.unit() * 3.0 - 2.9);
            let first = [
                (rng.unit() * 1.6 - 0.3) * size[0] as f32,
                (rng.unit() * 1.6 - 0.3) * size[1] as f32,
                l,
                (rng.unit() - 0.5) * 2.0 * l,
            ];
            // Few depths, so that ties are common.
            let z = 0.25 + (rng.next() % 97) as f32 * 0.37;
            scene.push(first, [l * (0.3 + 2.0 * rng.unit()), (rng.unit() + 1e-3).log2(), z, 0.0]);
        }
        scene
    }

    fn push(&mut self, first: [f32; 4], second: [f32; 4]) {
        let e = Ellipse::of_splat(first, second);
        self.tile_count.push(e.tile_count(self.frame.size));
        self.ellipses.push(e);
        self.depths.push(second[2]);
        self.splats.extend(first.iter().chain(&second).chain(&[0.0; 4]).map(|v| v.to_bits()));
        self.frame.gaussians = self.tile_count.len() as u32;
    }

    fn total(&self) -> u64 {
        self.tile_count.iter().map(|c| u64::from(*c)).sum()
    }

    /// What `deform_project` counts for each tile, and in blocks.
    fn counted(&self) -> (Vec<u32>, Vec<u32>, u32) {
        let tiles = self.frame.tiles[0];
        let mut change = vec![0_u32; tile_change_words(self.frame.tile_count) as usize];
        let (words, block_capacity) = block_words(self.frame.gaussians);
        let mut blocks = vec![0; words as usize];
        for (g, e) in self.ellipses.iter().enumerate().filter(|(g, _)| self.tile_count[*g] != 0) {
            let rows = e.tile_row_range(self.frame.size);
            for row in rows[0]..rows[1] {
                let at = |c: u32| ((row * tiles + c) * TILE_PITCH) as usize;
                let columns = e.tile_columns_of_row(row, self.frame.size).map(at);
                change[columns[0]] = change[columns[0]].wrapping_add(1);
                change[columns[1]] = change[columns[1]].wrapping_sub(1);
            }
            blocks[g / 256] += self.tile_count[g];
            blocks[block_capacity as usize + g / 65_536] += self.tile_count[g];
        }
        (change, blocks, block_capacity)
    }

    /// The chain of a frame on the device; every kernel is compared with its twin.
    fn check(&self, gpu: &TestGpu, capacity: u32) -> TileLists {
        self.check_from(gpu, capacity, 0)
    }

    /// The same when the counters say `failed` before the chain begins.
    fn check_from(&self, gpu: &TestGpu, capacity: u32, failed: u32) -> TileLists {
        let chain = self.chain(capacity, failed);
        if self.frame.gaussians > 0 {
            self.check_slots(gpu, &chain);
        }
        chain.run(gpu)
    }

    fn chain(&self, capacity: u32, failed: u32) -> TileChain {
        let (tile_change, instance_block, block_capacity) = self.counted();
        let visible: u32 = self.tile_count.iter().map(|c| u32::from(*c != 0)).sum();
        TileChain {
            frame: Frame { instance_capacity: capacity, ..self.frame },
            counters: vec![visible, self.total() as u32, (self.total() >> 32) as u32, failed, 0, 0, 0, 0],
            tile_count: self.tile_count.clone(),
            splats: self.splats.clone(),
            tile_change,
            instance_block,
            block_capacity,
            constants: EmitTilesConstants::default(),
        }
    }

    /// Slots are another name for the same instances, and those of a Gaussian follow one another.
    fn check_slots(&self, gpu: &TestGpu, chain: &TileChain) {
        let mut case = chain.emission(gpu);
        let without = case.clone().check(gpu, "without slots");
        case.constants.with_slots = 1;
        case.buffers.gaussian_of_slot = Some(vec![0; without.pairs.len() / 2]);
        case.buffers.first_slot = Some(vec![0; self.tile_count.len()]);
        let with = case.check(gpu, "with slots");
        let (gaussian_of_slot, first_slot) = (with.gaussian_of_slot.clone().unwrap(), with.first_slot.clone().unwrap());
        assert_eq!(with.tile_end, without.tile_end);
        let instances = with.counters[5] as usize;
        let of_slots = sort(gpu, unsorted(with), true).values;
        let of_instances = sort(gpu, unsorted(without), false).values;
        let pairs = of_slots.iter().zip(&of_instances).take(instances);
        pairs.for_each(|(slot, instance)| assert_eq!(gaussian_of_slot[*slot as usize], *instance));
        let visible = first_slot.iter().enumerate().filter(|(g, _)| instances != 0 && self.tile_count[*g] != 0);
        for (g, first) in visible {
            let own = (0..self.tile_count[g]).map(|k| (first + k) as usize).filter(|&slot| slot < instances);
            own.for_each(|slot| assert_eq!(gaussian_of_slot[slot] & INSTANCE_GAUSSIAN, g as u32));
        }
    }

    /// The chain leaves the lists by definition: Gaussians by depth, then index, each in the tiles that it is counted in.
    fn assert_lists(&self, done: &TileLists) {
        let mut expected = vec![vec![]; self.frame.tile_count as usize];
        let mut order: Vec<usize> = (0..self.ellipses.len()).filter(|g| self.tile_count[*g] != 0).collect();
        order.sort_by(|a, b| self.depths[*a].total_cmp(&self.depths[*b]).then(a.cmp(b)));
        for g in order {
            let rows = self.ellipses[g].tile_row_range(self.frame.size);
            for row in rows[0]..rows[1] {
                let [first, end] = self.ellipses[g].tile_columns_of_row(row, self.frame.size);
                (first..end).for_each(|c| expected[(row * self.frame.tiles[0] + c) as usize].push(g as u32));
            }
        }
        for (list, expected) in done.lists().zip(expected) {
            let found: Vec<u32> = list.iter().map(|v| v & INSTANCE_GAUSSIAN).collect();
            assert_eq!(found, expected);
        }
    }
}

#[test]
fn chain_equals_twins_and_definition() {
    let gpu = tests_harness::shared_gpu();
    widths::assert_lanes(&gpu);
    for (n, size) in [
        (0, [64, 64]),
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
        let done = scene.check(&gpu, scene.total() as u32 + 100);
        assert_eq!((done.counters[3], u64::from(done.counters[5])), (0, scene.total()));
        scene.assert_lists(&done);
    }
}

#[test]
fn nothing_visible() {
    let gpu = tests_harness::shared_gpu();
    let mut scene = Scene::random(300, [64, 64], 5);
    scene.tile_count.fill(0);
    let done = scene.check(&gpu, 100);
    assert_eq!((done.counters[3], done.counters[5]), (0, 0));
    assert!(done.ranges.iter().all(|r| *r == 0));
}

#[test]
fn capacity_is_exact() {
    let gpu = tests_harness::shared_gpu();
    let scene = Scene::random(600, [200, 200], 41);
    let total = scene.total() as u32;
    assert_eq!(scene.check(&gpu, total).counters[3], 0);
    let done = scene.check(&gpu, total - 1);
    assert_eq!((done.counters[3], done.counters[5]), (FAILED_INSTANCES, 0));
    assert!(done.ranges.iter().all(|r| *r == 0), "a frame that failed has empty lists");
}

#[test]
fn a_failure_from_before_stops_the_chain() {
    let gpu = tests_harness::shared_gpu();
    let scene = Scene::random(600, [200, 200], 41);
    let done = scene.check_from(&gpu, scene.total() as u32, 1);
    assert_eq!((done.counters[3], done.counters[5]), (1, 0));
    assert!(done.ranges.iter().all(|r| *r == 0));
}

/// Emits and sorts with lists that differ from what was counted: they lose members, but none runs into the next. Returns how many
/// are without some.
fn check_cut_lists(gpu: &TestGpu, scene: &Scene, chain: &TileChain) -> usize {
    // Who is left out is chance: the twin has others.
    let emitted = chain.emission(gpu).run(gpu).gpu;
    let ends: Vec<u32> = emitted.tile_end.iter().step_by(TILE_PITCH as usize).copied().collect();
    let done = sort(gpu, unsorted(emitted), false);
    let mut cut = 0;
    let starts = done.tile_start.unwrap();
    for (tile, (range, room)) in done.ranges.chunks_exact(2).zip(starts.windows(2)).enumerate() {
        assert!(
            room[0] == range[0] && range[0] <= range[1] && range[1] <= room[1],
            "tile {tile}: {range:?} in {room:?}"
        );
        assert_eq!(range[1], ends[tile].min(room[1]), "tile {tile}");
        cut += usize::from(ends[tile] > room[1]);
        for pair in done.pairs[2 * range[0] as usize..2 * range[1] as usize].chunks_exact(2) {
            let g = (pair[1] & INSTANCE_GAUSSIAN) as usize;
            assert_eq!(pair[0], scene.depths[g].to_bits(), "tile {tile}");
            let (row, column) = (tile as u32 / scene.frame.tiles[0], tile as u32 % scene.frame.tiles[0]);
            let [first, end] = scene.ellipses[g].tile_columns_of_row(row, scene.frame.size);
            assert!((first..end).contains(&column), "tile {tile}: Gaussian {g} is of another");
        }
    }
    cut
}

/// Lists with room of one size are sorted as those that lie one behind the other; where one had too little, all are empty.
#[test]
fn room_of_one_size() {
    let gpu = tests_harness::shared_gpu();
    for (n, size) in [(0, [64, 64]), (31, [1, 1]), (257, [33, 17]), (1025, [400, 300]), (5000, [200, 200])] {
        let scene = Scene::random(n, size, 21 + u64::from(n));
        let chain = scene.chain(scene.total() as u32, 0);
        let packed = unsorted(chain.emission(&gpu).check(&gpu, "packed"));
        let longest = sort(&gpu, packed.clone(), false).ranges.chunks_exact(2).map(|r| r[1] - r[0]).max().unwrap();
        for room in [longest.max(1), longest + 32] {
            let SortTilesBuffers { counters, ranges, values, .. } = sort(&gpu, with_room(&packed, room), false);
            scene.assert_lists(&TileLists { counters, ranges, values });
        }
        let mut failed = with_room(&packed, longest.max(1));
        failed.counters[3] = FAILED_INSTANCES;
        let done = sort(&gpu, failed, false);
        assert!(done.ranges.chunks_exact(2).all(|range| range[0] == range[1]), "a frame that failed has empty lists");
    }
}

/// Should two kernels ever disagree on how many tiles a splat reaches.
#[test]
fn counts_that_disagree() {
    let gpu = tests_harness::shared_gpu();
    for error in [3_i32, -2] {
        let mut scene = Scene::random(600, [200, 200], 31);
        for count in scene.tile_count.iter_mut().filter(|c| **c != 0) {
            *count = (*count as i32 + error).max(1) as u32;
        }
        let chain = scene.chain(scene.total() as u32, 0);
        check_cut_lists(&gpu, &scene, &chain);
    }
}

/// The same of a tile: lists are longer than there is room for.
#[test]
fn lists_that_are_longer_than_counted() {
    let gpu = tests_harness::shared_gpu();
    let scene = Scene::random(600, [200, 200], 31);
    let mut chain = scene.chain(scene.total() as u32, 0);
    let mut fewer = Scene { tile_count: scene.tile_count.clone(), splats: vec![], ..scene };
    fewer.tile_count.iter_mut().step_by(3).for_each(|count| *count = 0);
    chain.tile_change = fewer.counted().0;
    let tiles = fewer.frame.tile_count as usize;
    assert!(check_cut_lists(&gpu, &fewer, &chain) > tiles / 2);
}

#[test]
fn splats_over_the_whole_screen() {
    let gpu = tests_harness::shared_gpu();
    let mut scene = Scene::random(300, [1920, 1080], 51);
    for i in 0..4 {
        scene.push([900.0, 500.0, 1e-5, 0.0], [1e-5, -0.1, 3.0 + i as f32, 0.0]);
    }
    assert_eq!(*scene.tile_count.last().unwrap(), 8160);
    let done = scene.check(&gpu, scene.total() as u32);
    scene.assert_lists(&done);
}

/// Pairs of the longest list that a workgroup of one subgroup sorts on a CPU device.
fn longest_of_few_threads(gpu: &TestGpu) -> u32 {
    long_from(true, gpu.subgroup_size_of(&SORT_TILES).min(16), u32::MAX)
}

/// Sorts lists of pairs, beside the twin. Room that is not used lies between them.
fn sort_lists(gpu: &TestGpu, lists: &[Vec<[u32; 2]>]) {
    let (mut tile_start, mut ends, mut pairs) = (vec![], vec![], vec![]);
    for list in lists {
        tile_start.push(pairs.len() as u32);
        pairs.extend(list);
        ends.push(pairs.len() as u32);
        pairs.resize(pairs.len() + 3, [0; 2]);
    }
    tile_start.push(pairs.len() as u32);
    let frame = Frame { tile_count: lists.len() as u32, ..Frame::default() };
    let frame = bytemuck::cast_slice(&[frame]).to_vec();
    let (values, ranges) = (vec![0; pairs.len()], vec![0; 2 * lists.len()]);
    let pairs = pairs.as_flattened().to_vec();
    let (tile_start, counters) = (Some(tile_start), vec![0; 8]);
    let buffers = SortTilesBuffers { frame, tile_start, pairs, values, tile_end: spread(&ends), ranges, counters };
    let ranges = sort(gpu, buffers, false).ranges;
    assert!(ranges.iter().skip(1).step_by(2).eq(&ends), "{ranges:?} do not end at {ends:?}");
}

/// Lists around what a workgroup sorts at once, around what few threads of a CPU device do, and far beyond, of depths that are all
/// alike, that crowd in a corner of their range, and that are anything.
#[test]
fn lists_of_every_length_and_kind() {
    let gpu = tests_harness::shared_gpu();
    let mut rng = Rng(3);
    type Depth = fn(&mut Rng, u32) -> u32;
    let kinds: [(&str, Depth); 6] = [
        ("spread", |rng, _| (1.0 + 3.0 * rng.unit()).to_bits()),
        ("any bits", |rng, _| rng.next() >> 1),
        ("one", |_, _| 1.5_f32.to_bits()),
        ("few", |rng, _| (1.0 + (rng.next() % 5) as f32).to_bits()),
        ("crowded", |rng, i| if i % 100 == 0 { 1e6_f32.to_bits() } else { (1.0 + 1e-5 * rng.unit()).to_bits() }),
        ("falling", |_, i| (1e4 - i as f32 * 1e-2).to_bits()),
    ];
    let (capacity, few) = (SORT_TILES_CAPACITY, longest_of_few_threads(&gpu));
    let all = [0, 1, 2, 7, 64, 255, 257, 1000, capacity, capacity + 1, 5000, few, few + 1, 40_000];
    let most = if tests_harness::small() { 5000 } else { u32::MAX };
    for (name, depth) in kinds {
        let list = |n: u32| {
            let mut names: Vec<u32> = (0..n).collect();
            for i in (1..names.len()).rev() {
                names.swap(i, rng.next() as usize % (i + 1));
            }
            let pair = |g: u32| [depth(&mut rng, g), g | rng.next() & !INSTANCE_GAUSSIAN];
            names.into_iter().map(pair).collect()
        };
        println!("{name}");
        sort_lists(&gpu, &all.into_iter().filter(|n| *n <= most).map(list).collect::<Vec<_>>());
    }
}

/// Where every pair that is looked at before a list is cut is nearer than all others, the cut leaves nearly the whole list in one
/// part, which is then sorted in memory.
#[test]
fn a_list_that_cannot_be_cut() {
    let gpu = tests_harness::shared_gpu();
    let mut rng = Rng(5);
    let mut list = |n: u32| -> Vec<[u32; 2]> {
        let near = |i: u32| i.is_multiple_of(n / 128) && i / (n / 128) < 128;
        let mut depth = |i: u32| if near(i) { rng.unit() } else { 2.0 + rng.unit() };
        (0..n).map(|i| [depth(i).to_bits(), n - i]).collect()
    };
    let lists = [3000, if tests_harness::small() { 5000 } else { longest_of_few_threads(&gpu) }].map(&mut list);
    sort_lists(&gpu, &lists);
}

#[test]
fn more_than_one_super_block() {
    // 70,001 visible Gaussians: 274 blocks, two super sums; and every instance in one tile.
    let gpu = tests_harness::shared_gpu();
    let mut scene = Scene::random(0, [16, 16], 1);
    for i in 0..70_001_u32 {
        scene.push([8.0, 8.0, 0.5, 0.1], [0.4, -0.1, 1.0 + (i % 13) as f32, 0.0]);
    }
    let done = scene.check(&gpu, 80_000);
    assert_eq!(done.ranges[..2], [0, 70_001]);
    scene.assert_lists(&done);
}
