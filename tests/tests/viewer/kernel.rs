//! Kernel `display` on the device against its twin.

use engine::render::display::{DISPLAY, Display, palette};
use tests_harness::KernelCase;

struct Rng(u64);

impl Rng {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / 16_777_216.0
    }
}

/// Colours a little outside 0 to 1, depths, tile ranges.
fn case(source: [u32; 2], target: [u32; 2], mode: u32, failed: u32, seed: u64) -> KernelCase {
    let mut rng = Rng(seed);
    let pixels = (source[0] * source[1]) as usize;
    let tiles = source.map(|s| s.div_ceil(16));
    let display = Display {
        source: [source[0], source[1], tiles[0], mode],
        target: [target[0], target[1], (seed % 2) as u32, 0],
        range: [1.0, 0.25, 0.001, 0.0],
    };
    let mut color: Vec<u32> = (0..4 * pixels).map(|i| {
        let v = if i % 4 == 3 { rng.unit() } else { 1.4 * rng.unit() - 0.2 };
        v.to_bits()
    }).collect();
    if pixels > 3 {
        color[8] = f32::NAN.to_bits();
        color[9] = f32::INFINITY.to_bits();
    }
    let depth = (0..pixels).map(|_| (6.0 * rng.unit()).to_bits()).collect();
    let ranges = (0..tiles[0] * tiles[1]).flat_map(|_| [10, 10 + (3000.0 * rng.unit() * rng.unit()) as u32]).collect();
    let mut counters = vec![0; 8];
    counters[engine::render::limits::COUNT_FAILED as usize] = failed;
    let palette = palette().into_iter().flatten().map(f32::to_bits).collect();
    let pixels = (target[0] * target[1]) as usize;
    let words = bytemuck::cast_slice(bytemuck::bytes_of(&display)).to_vec();
    KernelCase {
        kernel: &DISPLAY,
        spec: vec![],
        push: vec![],
        buffers: vec![words, color, depth, ranges, counters, palette, vec![0; pixels]],
        groups: pixels.div_ceil(256) as u32,
    }
}

#[test]
fn every_mode_agrees_with_the_twin() {
    let gpu = tests_harness::gpu();
    let sizes = [([64, 48], [64, 48]), ([33, 17], [33, 17]), ([40, 30], [81, 61]), ([1, 1], [1, 1]), ([1, 1], [7, 300])];
    for (i, (source, target)) in (1..).zip(sizes) {
        for mode in 0..4 {
            let result = case(source, target, mode, 0, i).run(&gpu);
            let (g, t) = (&result.gpu[6], &result.twin[6]);
            assert_eq!(g.len(), t.len());
            let bytes = |w: &[u32]| w.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
            let (g, t) = (bytes(g), bytes(t));
            // Rounding to a level, or to a colour of the palette, may fall to either side.
            let off = g.iter().zip(&t).filter(|(a, b)| a.abs_diff(**b) > 1).count();
            assert!(off * 500 <= g.len(), "{source:?} → {target:?} mode {mode}: {off} of {} bytes differ", g.len());
            assert!(g.iter().zip(&t).all(|(a, b)| a.abs_diff(*b) <= 12), "{source:?} → {target:?} mode {mode}");
            assert!(g.iter().skip(3).step_by(4).all(|a| *a == 255), "opaque");
        }
    }
}

#[test]
fn a_frame_that_failed_leaves_the_picture() {
    let gpu = tests_harness::gpu();
    let result = case([20, 20], [20, 20], 0, 1, 5).run(&gpu);
    assert!(result.gpu[6].iter().all(|w| *w == tests_harness::kernel_case::POISON), "something was written");
    assert_eq!(result.gpu[6], result.twin[6]);
}
