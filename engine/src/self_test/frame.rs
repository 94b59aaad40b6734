//! Exact frames of a table of poses, kernel by kernel against the twins and whole against the f64 reference.

use glam::DVec3;

use super::check;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::gpu::interface::of_words;
use crate::gpu::proof::KernelCase;
use crate::image::{Image, difference};
use crate::reference::{self, ReferenceOptions};
use crate::render::frame::Frame;
use crate::render::limits::TILE_PITCH;
use crate::render::sort_tiles::{self, SORT_TILES, SORT_TILES_CAPACITY, SortTiles, SortTilesBuffers};
use crate::render::work_buffers::COUNTER_WORDS;
use crate::render::{RenderOptions, Renderer};
use crate::scene::synthetic::{Random, moving_scene};
use crate::scene::{Camera, Scene};

/// Gaussians and superpoints of the test's scene.
const GAUSSIANS: usize = 200;
const SUPERPOINTS: usize = 5;
/// Key times of its motion.
const KEYS: usize = 3;
pub(super) const SEED: u64 = 11;
/// Pixels: the last column and the last row of tiles are partial.
pub(super) const SIZE: [u32; 2] = [45, 29];
/// The times that are drawn.
pub(super) const TIMES: [f64; 2] = [0.3, 0.85];
pub(super) const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.125];
/// Tile instances for which there is no room of one size for each list: they lie one behind the other, as in large images.
const PACKED: u64 = 6 * GAUSSIANS as u64;
/// Pairs of a list at one depth: more than a bucket of `sort_tiles` is to have.
const ALIKE: u32 = 300;
/// Bounds against the f64 reference, as the tests have them.
const MIN_PSNR: f64 = 65.0;
const MAX_DIFFERENCE: f64 = 0.02;

/// Tests the kernels of a frame, then a frame without anybody watching.
pub(super) fn test(gpu: &Gpu) -> Result<()> {
    let (scene, options) = (scene(), RenderOptions { background: BACKGROUND, ..RenderOptions::default() });
    watched_frames(gpu, &scene, &options)?;
    let packed = RenderOptions { max_instances: Some(PACKED), ..options.clone() };
    watched_frames(gpu, &scene, &packed)?;
    long_lists(gpu)?;
    whole_frame(gpu, &scene, &options)
}

/// What the lists of so small a scene do not show of `sort_tiles`: many pairs at one depth, and more than are sorted at once.
fn long_lists(gpu: &Gpu) -> Result<()> {
    let mut random = Random::new(SEED);
    let (mut tile_start, mut tile_end, mut pairs) = (vec![0], Vec::new(), Vec::new());
    for (count, depths) in [(ALIKE, 1), (SORT_TILES_CAPACITY + 500, 1 << 20)] {
        let pair = |g: u32| [random.bits() as u32 % depths + 1, count - g];
        pairs.extend((0..count).flat_map(pair));
        let end = pairs.len() as u32 / 2;
        tile_start.push(end);
        tile_end.push(end);
        tile_end.resize(tile_start.len().saturating_sub(1) * TILE_PITCH as usize, 0);
    }
    let tiles = tile_start.len() as u32 - 1;
    let frame = bytemuck::cast_slice(&[Frame { tile_count: tiles, ..Frame::default() }]).to_vec();
    let (values, ranges) = (vec![0; pairs.len() / 2], vec![0; 2 * tiles as usize]);
    let (tile_start, counters) = (Some(tile_start), vec![0; COUNTER_WORDS as usize]);
    let mut buffers = SortTilesBuffers { frame, tile_start, pairs, values, tile_end, ranges, counters };
    let threads = sort_tiles::threads(gpu.info(), gpu.subgroup_size_of(&SORT_TILES));
    for constants in sort_tiles::dispatches(gpu.info().is_cpu(), threads, u32::MAX, false) {
        let result = KernelCase::new(&SORT_TILES, constants, (), buffers, tiles).run(gpu)?;
        if let Some(mismatch) = result.mismatch() {
            return Err(mismatch.into_error());
        }
        buffers = of_words::<SortTiles>(result.gpu);
    }
    Ok(())
}

/// What is drawn.
pub(super) fn scene() -> Scene {
    moving_scene(GAUSSIANS, SUPERPOINTS, KEYS, SEED, false)
}

/// Close to the scene, which is about two units across; elsewhere at each time.
pub(super) fn camera(time: f64) -> Camera {
    let eye = DVec3::new(3.2 * time.cos(), 0.9, 3.2 * time.sin());
    Camera::look_at(eye, DVec3::ZERO, DVec3::Y, 0.8, SIZE)
}

/// A frame in each of the renderer's slots.
pub(super) fn watched_frames(gpu: &Gpu, scene: &Scene, options: &RenderOptions) -> Result<()> {
    let (watched, watch) = gpu.watched();
    let mut renderer = Renderer::new(&watched, scene, options)?;
    let frames = TIMES.map(|time| renderer.submit(&camera(time), time));
    for frame in frames {
        let frame = frame?;
        if renderer.finish(frame)?.is_none() {
            check(&watch)?;
            return Err(Error::Kernel {
                kernel: "deform_project".into(),
                why: "it counts more tile instances than there are".into(),
            });
        }
    }
    check(&watch)
}

/// A frame as users get it, without copies between its kernels, against the f64 reference.
fn whole_frame(gpu: &Gpu, scene: &Scene, options: &RenderOptions) -> Result<()> {
    let [_, time] = TIMES;
    let image = Renderer::new(gpu, scene, options)?.render(&camera(time), time)?;
    let options = ReferenceOptions { background: BACKGROUND.map(f64::from), ..ReferenceOptions::default() };
    check_image(&image, &reference::render(scene, &camera(time), time, &options)?)
}

fn check_image(image: &Image, truth: &reference::ReferenceImage) -> Result<()> {
    let found = difference(truth.rgb.iter().copied(), image.rgb());
    if found.psnr >= MIN_PSNR && found.max <= MAX_DIFFERENCE {
        return Ok(());
    }
    let why = format!(
        "{:.1} dB from the f64 reference, largest difference {:.2e}; expected at least {MIN_PSNR} dB and at most {MAX_DIFFERENCE}",
        found.psnr, found.max
    );
    Err(Error::Kernel { kernel: "a whole frame".into(), why })
}
