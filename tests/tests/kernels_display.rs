//! What a window needs of the renderer: kernel `display` against its twin, picking, other colours.
#![allow(clippy::unwrap_used, reason = "tests")]

use engine::render::display::{DISPLAY, Display, DisplayBuffers, DisplayConstants, DisplayKernel, palette};
use engine::render::{Quality, RenderOptions, Renderer};
use engine::scene::{Camera, Gaussians, Scene};
use glam::DVec3;
use tests_harness::KernelCase;

struct Rng(u64);

impl Rng {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / 16_777_216.0
    }
}

/// Colours a little outside 0 to 1, depths, tile ranges.
fn case(source: [u32; 2], target: [u32; 2], mode: u32, failed: u32, seed: u64) -> KernelCase<DisplayKernel> {
    let mut rng = Rng(seed);
    let pixels = (source[0] * source[1]) as usize;
    let tiles = source.map(|s| s.div_ceil(16));
    let display = Display {
        source: [source[0], source[1], tiles[0], 0],
        target: [target[0], target[1], (seed % 2) as u32, 0],
        range: [1.0, 0.25, 0.001, 0.0],
    };
    let mut color: Vec<u32> = (0..4 * pixels)
        .map(|i| {
            let v = if i % 4 == 3 { rng.unit() } else { 1.4 * rng.unit() - 0.2 };
            v.to_bits()
        })
        .collect();
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
    let buffers = DisplayBuffers {
        display: bytemuck::cast_slice(bytemuck::bytes_of(&display)).to_vec(),
        color,
        depth: Some(depth),
        ranges,
        counters,
        palette,
        screen: vec![0; pixels],
    };
    let constants = DisplayConstants { mode, enlarged: u32::from(source != target) };
    KernelCase { kernel: &DISPLAY, constants, push: (), buffers, groups: pixels.div_ceil(256) as u32 }
}

#[test]
fn every_mode_agrees_with_the_twin() {
    let gpu = tests_harness::shared_gpu();
    let sizes =
        [([64, 48], [64, 48]), ([33, 17], [33, 17]), ([40, 30], [81, 61]), ([1, 1], [1, 1]), ([1, 1], [7, 300])];
    for (i, (source, target)) in (1..).zip(sizes) {
        for mode in 0..4 {
            let result = case(source, target, mode, 0, i).run(&gpu);
            let (g, t) = (&result.gpu.screen, &result.twin.screen);
            assert_eq!(g.len(), t.len());
            let bytes = |w: &[u32]| w.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
            let (g, t) = (bytes(g), bytes(t));
            // Rounding to a level, or to a colour of the palette, may fall to either side.
            let off = g.iter().zip(&t).filter(|(a, b)| a.abs_diff(**b) > 1).count();
            assert!(off * 500 <= g.len(), "{source:?} → {target:?} mode {mode}: {off} of {} bytes differ", g.len());
            let far = (0..g.len()).filter(|&i| g[i].abs_diff(t[i]) > 12).map(|i| (i / 4, i % 4, g[i], t[i]));
            let far: Vec<_> = far.collect();
            assert!(far.is_empty(), "{source:?} → {target:?} mode {mode}: {far:?}");
            assert!(g.iter().skip(3).step_by(4).all(|a| *a == 255), "opaque");
        }
    }
}

#[test]
fn a_frame_that_failed_leaves_the_picture() {
    let gpu = tests_harness::shared_gpu();
    let result = case([20, 20], [20, 20], 0, 1, 5).run(&gpu);
    assert!(result.gpu.screen.iter().all(|w| *w == tests_harness::kernel_case::POISON), "something was written");
    assert_eq!(result.gpu.screen, result.twin.screen);
}

/// Two round Gaussians beside each other and one behind the first.
fn three() -> Scene {
    let gaussians = Gaussians {
        mean: vec![[0.0, 0.0, 1.0], [-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [-0.5, 0.0, 0.8]],
        log_scale: vec![[-9.0; 3], [-2.0; 3], [-2.0; 3], [-2.0; 3]],
        rotation: vec![[1.0, 0.0, 0.0, 0.0]; 4],
        opacity_logit: vec![-9.0, 4.0, 4.0, 4.0],
        sh_degree: 0,
        sh: vec![0.5; 12],
        ..Gaussians::default()
    };
    Scene { gaussians, ..Scene::default() }
}

/// Each has pipelines of its own, which take seconds to compile: in small, one.
fn qualities() -> impl Iterator<Item = Quality> {
    [Quality::EXACT, Quality::HIGH].into_iter().take(if tests_harness::small() { 1 } else { 2 })
}

#[test]
fn a_click_finds_what_is_seen_there() {
    let gpu = tests_harness::shared_gpu();
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.6, [200, 100]);
    for quality in qualities() {
        let options = RenderOptions { quality, ..RenderOptions::default() };
        let mut renderer = Renderer::new(&gpu, &three(), &options).unwrap();
        assert_eq!(renderer.pick([1, 1]).unwrap(), None, "before the first frame");
        renderer.draw(&camera, 0.0).unwrap();
        let pixel = |x: f64| [(camera.cx + camera.fx * x / 4.0) as u32, 50];
        let [left, right] = [-0.5, 0.5].map(|x| renderer.pick(pixel(x)).unwrap().unwrap());
        assert_eq!((left.gaussian, right.gaussian), (1, 2));
        assert!((left.depth - 4.0).abs() < 1e-3 && left.weight > 0.9, "{left:?}");
        assert!(left.blended >= right.blended);
        for outside in [[0, 0], [199, 99], [500, 50]] {
            assert_eq!(renderer.pick(outside).unwrap(), None, "{outside:?}");
        }
    }
}

#[test]
fn base_colours_replace_those_of_the_scene() {
    let gpu = tests_harness::shared_gpu();
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.6, [64, 32]);
    for quality in qualities() {
        let options = RenderOptions { quality, ..RenderOptions::default() };
        let mut renderer = Renderer::new(&gpu, &three(), &options).unwrap();
        renderer.set_base_colors(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3]]).unwrap();
        let image = renderer.render(&camera, 0.0).unwrap();
        let at = |x: usize| &image.rgba[4 * (16 * 64 + x)..][..3];
        let column = |x: f64| (camera.cx + camera.fx * x / 4.0) as usize;
        assert!(at(column(-0.5))[0] > 0.9 && at(column(-0.5))[1] < 0.05, "{:?}", at(column(-0.5)));
        assert!(at(column(0.5))[1] > 0.9 && at(column(0.5))[0] < 0.05, "{:?}", at(column(0.5)));
        assert!(renderer.set_base_colors(&[[0.0; 3]]).is_err());
    }
}
