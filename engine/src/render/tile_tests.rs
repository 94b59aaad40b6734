//! Tile coverage by brute force over pixels, and the tile lists against plain Rust.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use super::ellipse::{Ellipse, quadrants_of_tile};
use super::emit_tiles::{EMIT_TILES, EmitTilesBuffers, EmitTilesConstants, EmitTilesPush};
use super::frame::Frame;
use super::limits::*;
use super::scan_tiles::{SCAN_TILES, ScanTilesBuffers, ScanTilesConstants, TILES_AT_ONCE, tile_change_words};
use super::sort_tests::Rng;
use super::sort_tiles::{self, SORT_TILES, SortTilesBuffers};
use super::tiles::*;

const POISON: u32 = 0x7FC0_DEAD;
/// The twins do the same for every subgroup size.
const LANES: u32 = 32;

/// An ellipse with the given standard deviations (px, before the 0.3 px² dilation) and angle.
fn ellipse(mean: [f64; 2], sigma: [f64; 2], angle: f64, opacity: f64) -> Ellipse {
    let (sin, cos) = angle.sin_cos();
    let [p, q] = sigma.map(|s| s * s);
    let b = (p - q) * sin * cos;
    let c = p * sin * sin + q * cos * cos + 0.3;
    let det = p * q + 0.3 * (p + q) + 0.09;
    let s = (std::f64::consts::LOG2_E / 2.0).sqrt();
    Ellipse {
        mean: mean.map(|m| m as f32),
        l11: (s * (c / det).sqrt()) as f32,
        l12: (-s * b / (c * det).sqrt()) as f32,
        l22: (s / c.sqrt()) as f32,
        log2_opacity: opacity.log2() as f32,
        ..Ellipse::NONE
    }
}

/// α ≥ 1/255 at a pixel, in f64 from the f32 coefficients.
fn reaches(e: &Ellipse, x: u32, y: u32) -> bool {
    let dx = f64::from(x) + 0.5 - f64::from(e.mean[0]);
    let dy = f64::from(y) + 0.5 - f64::from(e.mean[1]);
    let u = f64::from(e.l11) * dx + f64::from(e.l12) * dy;
    let v = f64::from(e.l22) * dy;
    f64::from(e.log2_opacity) - u * u - v * v >= -(255_f64.log2())
}

/// Tiles with a pixel that the ellipse reaches.
fn tiles_by_pixels(e: &Ellipse, size: [u32; 2]) -> Vec<u32> {
    let columns = size[0].div_ceil(TILE_SIZE);
    let mut tiles = Vec::new();
    for tile in 0..columns * size[1].div_ceil(TILE_SIZE) {
        let (x, y) = (tile % columns * TILE_SIZE, tile / columns * TILE_SIZE);
        let hit = (y..size[1].min(y + TILE_SIZE)).any(|y| (x..size[0].min(x + TILE_SIZE)).any(|x| reaches(e, x, y)));
        if hit {
            tiles.push(tile);
        }
    }
    tiles
}

fn tiles_by_rows(e: &Ellipse, size: [u32; 2]) -> Vec<u32> {
    let rows = e.tile_row_range(size);
    let mut tiles = Vec::new();
    for row in rows[0]..rows[1] {
        let columns = e.tile_columns_of_row(row, size);
        tiles.extend((columns[0]..columns[1]).map(|c| row * size[0].div_ceil(TILE_SIZE) + c));
    }
    assert_eq!(tiles.len() as u32, e.tile_count(size));
    tiles
}

/// Quadrants with a pixel that the ellipse reaches, and those in the image that the kernels find, of a tile.
fn quadrants(e: &Ellipse, size: [u32; 2], tile: u32) -> [u32; 2] {
    let columns = size[0].div_ceil(TILE_SIZE);
    let (x, y) = (tile % columns * TILE_SIZE, tile / columns * TILE_SIZE);
    let hit = |q: u32| {
        let (x, y) = (x + q % 2 * 8, y + q / 2 * 8);
        (y..size[1].min(y + 8)).any(|y| (x..size[0].min(x + 8)).any(|x| reaches(e, x, y)))
    };
    let of_tile = |has: &dyn Fn(u32) -> bool| (0..4).map(|q| u32::from(has(q)) << q).sum::<u32>();
    let inside = of_tile(&|q| x + q % 2 * 8 < size[0] && y + q / 2 * 8 < size[1]);
    let found = quadrants_of_tile(e.half_rows_of_tile_row(tile / columns), tile % columns);
    [of_tile(&hit), found & inside]
}

/// Checks cover and returns tiles counted and needed, then quadrants of these tiles found and needed.
fn check_cover(e: &Ellipse, size: [u32; 2]) -> [usize; 4] {
    let (counted, needed) = (tiles_by_rows(e, size), tiles_by_pixels(e, size));
    let mut sums = [counted.len(), needed.len(), 0, 0];
    for tile in needed {
        assert!(counted.contains(&tile), "{e:?} in {size:?}: tile {tile} is not counted");
        let [needed, found] = quadrants(e, size, tile);
        assert_eq!(found & needed, needed, "{e:?} in {size:?}: quadrants of tile {tile}");
        sums[2] += found.count_ones() as usize;
        sums[3] += needed.count_ones() as usize;
    }
    sums
}

#[test]
fn every_reached_pixel_lies_in_a_counted_tile_and_quadrant() {
    let mut rng = Rng(11);
    let mut over = |name: &str, n: usize, size: [u32; 2], range: [f64; 2], needle: bool, limit: f64| {
        let mut sums = [0; 4];
        for _ in 0..n {
            let spread = 1.4;
            let mean = [0, 1].map(|i| (rng.unit() * spread - (spread - 1.0) / 2.0) * f64::from(size[i]));
            let draw = |u: f64| range[0] * (range[1] / range[0]).powf(u);
            let long = draw(rng.unit());
            let short = if needle { 1e-3 } else { draw(rng.unit()) };
            let opacity = 10_f64.powf(-2.6 * rng.unit());
            let e = ellipse(mean, [long, short], rng.unit() * 7.0, opacity);
            sums.iter_mut().zip(check_cover(&e, size)).for_each(|(sum, n)| *sum += n);
        }
        let excess = [0, 2].map(|i| sums[i] as f64 / sums[i + 1] as f64 - 1.0);
        // Smaller squares have more of a splat's rim.
        assert!(excess[0] < limit && excess[1] < 3.0 * limit, "{name}: {excess:?} more tiles, quadrants than needed");
    };
    over("small", 3000, [200, 140], [0.01, 2.0], false, 0.03);
    over("medium", 500, [200, 140], [1.0, 40.0], false, 0.01);
    over("huge", 200, [200, 140], [40.0, 1e7], false, 0.01);
    over("needles", 500, [200, 140], [1.0, 1e5], true, 0.03);
    over("one pixel", 300, [1, 1], [0.01, 10.0], false, 0.05);
    over("narrow", 300, [3, 333], [0.1, 100.0], true, 0.05);
}

#[test]
fn alpha_at_the_threshold_is_counted() {
    for ulps in -40_i32..=40 {
        let threshold = -(255_f64.log2()) as f32;
        let log2_opacity = f32::from_bits(threshold.to_bits().wrapping_add_signed(ulps));
        let e = Ellipse { mean: [20.5, 3.5], l11: 1.0, l12: 0.3, l22: 1.1, log2_opacity, ..Ellipse::NONE };
        check_cover(&e, [64, 64]);
    }
    let faint = Ellipse { mean: [20.5, 3.5], l11: 1.0, l12: 0.3, l22: 1.1, log2_opacity: -8.1, ..Ellipse::NONE };
    assert_eq!(faint.tile_count([64, 64]), 0);
}

#[test]
fn not_finite_is_empty() {
    let good = ellipse([30.0, 30.0], [3.0, 5.0], 0.4, 0.9);
    assert!(good.tile_count([64, 64]) > 0);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for field in 0..6 {
            let mut f = [good.mean[0], good.mean[1], good.l11, good.l12, good.l22, good.log2_opacity];
            f[field] = bad;
            let e = Ellipse::of_splat([f[0], f[1], f[2], f[3]], [f[4], f[5], 0.0, 0.0]);
            assert_eq!(e.tile_count([64, 64]), 0, "field {field} = {bad}");
            let [low, high] = e.row_interval(0.5, 15.5);
            assert!(low > high, "field {field} = {bad}");
        }
    }
    for zero in [Ellipse { l11: 0.0, ..good }, Ellipse { l22: 0.0, ..good }, Ellipse { l11: -1.0, ..good }] {
        assert_eq!(zero.tile_count([64, 64]), 0);
    }
}

// ---- the chain scan -> emit -> sort, on the twins ----

struct Chain {
    size: [u32; 2],
    ellipses: Vec<Ellipse>,
    depth: Vec<f32>,
    capacity: u32,
    /// Added to the true tile counts, to emulate a count pass that disagrees with the emit pass.
    count_error: i32,
}

struct Lists {
    counters: Vec<u32>,
    /// For each tile, the Gaussians front to back.
    tiles: Vec<Vec<u32>>,
}

impl Chain {
    fn random(n: usize, size: [u32; 2], seed: u64) -> Self {
        let mut rng = Rng(seed);
        let ellipses = (0..n)
            .map(|_| {
                let mean = [0, 1].map(|i| (rng.unit() * 1.6 - 0.3) * f64::from(size[i]));
                let sigma = [10_f64.powf(rng.unit() * 2.5 - 1.0), 10_f64.powf(rng.unit() * 2.0 - 1.0)];
                ellipse(mean, sigma, rng.unit() * 7.0, rng.unit())
            })
            .collect();
        // Few depths, so that ties are common.
        let depth = (0..n).map(|_| 0.25 + (rng.next() % 97) as f32 * 0.37).collect();
        Self { size, ellipses, depth, capacity: u32::MAX, count_error: 0 }
    }

    fn tile_count(&self) -> Vec<u32> {
        let error = |c: u32| if c == 0 { 0 } else { (c as i32 + self.count_error).max(1) as u32 };
        self.ellipses.iter().map(|e| error(e.tile_count(self.size))).collect()
    }

    fn splats(&self) -> Vec<u32> {
        let mut splats = vec![0_u32; 12 * self.ellipses.len()];
        for (i, (e, z)) in self.ellipses.iter().zip(&self.depth).enumerate() {
            for (j, v) in [e.mean[0], e.mean[1], e.l11, e.l12, e.l22, e.log2_opacity, *z].into_iter().enumerate() {
                splats[12 * i + j] = v.to_bits();
            }
        }
        splats
    }

    fn tile_change(&self, tiles: [u32; 2]) -> Vec<u32> {
        let mut change = vec![0_u32; tile_change_words(tiles[0] * tiles[1]) as usize];
        for e in &self.ellipses {
            let rows = e.tile_row_range(self.size);
            for row in rows[0]..rows[1] {
                let at = |c: u32| ((row * tiles[0] + c) * TILE_PITCH) as usize;
                let [first, end] = e.tile_columns_of_row(row, self.size).map(at);
                change[first] = change[first].wrapping_add(1);
                change[end] = change[end].wrapping_sub(1);
            }
        }
        change
    }

    fn run(&self) -> Lists {
        let tiles = self.size.map(|s| s.div_ceil(TILE_SIZE));
        let tile_count = self.tile_count();
        let total: u64 = tile_count.iter().map(|c| u64::from(*c)).sum();
        let capacity = self.capacity.min(total as u32 + 100);
        let gaussians = self.ellipses.len() as u32;
        let frame = Frame {
            size: self.size,
            tiles,
            gaussians,
            instance_capacity: capacity,
            tile_count: tiles[0] * tiles[1],
            ..Frame::default()
        };
        let words: Vec<u32> = bytemuck::cast_slice(&[frame]).to_vec();
        let visible = tile_count.iter().filter(|c| **c != 0).count() as u32;
        let buffers = ScanTilesBuffers {
            frame: words.clone(),
            counters: vec![visible, total as u32, (total >> 32) as u32, 0, 0, POISON, 0, 0],
            tile_change: self.tile_change(tiles),
            tile_start: vec![POISON; frame.tile_count as usize + 1],
            indirect: None,
        };
        let scanned = SCAN_TILES.run_twin(LANES, ScanTilesConstants::default(), (), buffers, 1);
        let (blocks, block_capacity) = block_words(gaussians);
        let buffers = EmitTilesBuffers {
            frame: words.clone(),
            counters: scanned.counters,
            tile_count,
            splats: self.splats(),
            instance_block: vec![POISON; blocks as usize],
            tile_start: scanned.tile_start,
            pairs: vec![POISON; 2 * capacity as usize],
            tile_end: scanned.tile_change,
            gaussian_of_slot: None,
            first_slot: None,
        };
        let (constants, push) = (EmitTilesConstants::default(), EmitTilesPush { block_capacity });
        let EmitTilesBuffers { counters, tile_start, pairs, tile_end, .. } =
            EMIT_TILES.run_twin(LANES, constants, push, buffers, gaussians.div_ceil(256));
        let values = vec![POISON; capacity as usize];
        let ranges = vec![POISON; 2 * frame.tile_count as usize];
        let buffers = SortTilesBuffers {
            frame: words,
            tile_start: Some(tile_start),
            pairs,
            values,
            tile_end,
            ranges,
            counters: counters.clone(),
        };
        let constants = sort_tiles::dispatches(false, 128, gaussians, false)[0];
        let SortTilesBuffers { ranges, values, .. } =
            SORT_TILES.run_twin(LANES, constants, (), buffers, frame.tile_count);
        let list = |r: &[u32]| values[r[0] as usize..r[1] as usize].iter().map(|v| v & INSTANCE_GAUSSIAN).collect();
        let tiles = ranges.chunks_exact(2).map(list).collect();
        Lists { counters, tiles }
    }

    /// The lists by definition: Gaussians by (depth, index), each in the tiles it is counted in.
    fn expected(&self) -> Vec<Vec<u32>> {
        let [tiles_x, tiles_y] = self.size.map(|s| s.div_ceil(TILE_SIZE));
        let mut tiles = vec![vec![]; (tiles_x * tiles_y) as usize];
        let mut order: Vec<usize> = (0..self.ellipses.len()).collect();
        order.sort_by(|a, b| self.depth[*a].total_cmp(&self.depth[*b]).then(a.cmp(b)));
        let counts = self.tile_count();
        for i in order {
            for tile in tiles_by_rows(&self.ellipses[i], self.size).into_iter().take(counts[i] as usize) {
                tiles[tile as usize].push(i as u32);
            }
        }
        tiles
    }
}

#[test]
fn chain_gives_the_tile_lists_by_definition() {
    for (n, size) in
        [(0, [64, 64]), (1, [64, 64]), (255, [100, 90]), (257, [33, 17]), (1025, [400, 300]), (5000, [200, 200])]
    {
        let chain = Chain::random(n, size, 21 + n as u64);
        assert_eq!(chain.run().tiles, chain.expected(), "{n} Gaussians, {size:?}");
    }
}

#[test]
fn counts_that_promise_more_add_nothing_and_those_that_promise_less_cut() {
    let mut chain = Chain::random(600, [200, 200], 31);
    let right = chain.run().tiles;
    chain.count_error = 3;
    assert_eq!(chain.run().tiles, right);
    chain.count_error = -2;
    let cut = chain.run().tiles;
    assert!(cut != right);
    for (cut, right) in cut.iter().zip(right) {
        let mut right = right.iter();
        assert!(cut.iter().all(|g| right.any(|r| r == g)), "{cut:?} is no part of the list");
    }
}

#[test]
fn capacity_is_exact() {
    let mut chain = Chain::random(600, [200, 200], 41);
    let total: u32 = chain.tile_count().iter().sum();
    chain.capacity = total;
    let lists = chain.run();
    assert_eq!((lists.counters[3], lists.counters[5]), (0, total));
    assert_eq!(lists.tiles, chain.expected());
    chain.capacity = total - 1;
    let lists = chain.run();
    assert_eq!((lists.counters[3], lists.counters[5]), (FAILED_INSTANCES, 0));
    assert!(lists.tiles.iter().all(Vec::is_empty));
}

#[test]
fn one_splat_over_the_whole_screen() {
    let mut chain = Chain::random(300, [320, 200], 51);
    chain.ellipses[123] = ellipse([100.0, 100.0], [1e4, 1e4], 0.0, 1.0);
    let lists = chain.run();
    assert_eq!(lists.tiles, chain.expected());
    assert!(lists.tiles.iter().all(|list| list.contains(&123)));
}

#[test]
fn glsl_has_the_same_sizes() {
    let of = |glsl: &str, line: &str| assert!(glsl.contains(line), "{line}");
    let capacity = sort_tiles::SORT_TILES_CAPACITY;
    of(include_str!("../../../glsl/render/sort_tiles.comp"), &format!("const uint CAPACITY = {capacity}u;"));
    let of_thread = TILES_AT_ONCE / 256;
    let line = format!("const uint TILES_OF_THREAD = {of_thread}u;");
    of(include_str!("../../../glsl/render/scan_tiles.comp"), &line);
}

#[test]
fn a_cpu_device_sorts_every_length_once() {
    for gaussians in [1, 4096, 4097, u32::MAX] {
        let all = sort_tiles::dispatches(true, 8, gaussians, false);
        for n in [1, 100, 4096, 4097, 1 << 30].into_iter().filter(|n| *n <= gaussians) {
            let by = all.iter().filter(|c| (c.shortest..=c.longest).contains(&n)).count();
            assert_eq!(by, 1, "{n} of {gaussians}");
        }
    }
}
