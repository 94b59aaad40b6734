//! What blending does with a tile's list: counted on the CPU for the measured view, because no counter of a frame says it.

use engine::error::Result;
use engine::reference::gradient::image::visible_splats;
use engine::reference::{self, ALPHA_MIN, Blend64, DeformationAt, Gaussians64, ReferenceOptions, Splat};
use engine::render::RenderOptions;
use engine::render::blend::MIN_TRANSMITTANCE;
use engine::render::ellipse::{Ellipse, pixels_of_interval};
use engine::scene::{Camera, Scene};
use glam::DVec2;
use rayon::prelude::*;
use serde::Serialize;

/// Pixels of a side of a subtile, and of a tile.
const SUBTILE: u32 = 8;
const TILE: u32 = 16;
const SUBTILES_OF_TILE: usize = 4;
/// Splats of a list that a subgroup of 32 lanes takes at once; whether its pixels are opaque is asked after each batch.
const BATCH: usize = 32;

/// What was counted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Subtiles {
    /// Of the four subtiles of each tile that a splat reaches, the share that it reaches too.
    pub(crate) reached: f64,
    /// Of these pairs of splat and subtile, the share that is blended before all pixels of the subtile are opaque.
    pub(crate) blended: f64,
    /// Splats of the longest list of a tile, as a multiple of the mean one.
    pub(crate) longest: f64,
    /// Splats blended into the subtile that has most, as a multiple of the mean length of a tile's list.
    pub(crate) most: f64,
}

impl Subtiles {
    /// Where nothing is visible or could be counted.
    pub(crate) const ALL: Self = Self { reached: 1.0, blended: 1.0, longest: 3.0, most: 3.0 };

    /// Counts a view.
    pub(crate) fn count(scene: &Scene, camera: &Camera, time: f64, options: &RenderOptions) -> Result<Self> {
        let poses = reference::poses(scene, time, options.motion)?;
        let group = scene.deformation.superpoint_of_gaussian();
        let blend = Blend64::of(scene);
        let deformation = DeformationAt { group, blend: blend.as_ref(), poses: poses.as_deref(), offsets: None, time };
        let near = ReferenceOptions { near: options.near.into(), ..ReferenceOptions::default() };
        let splats = visible_splats(&Gaussians64::from(&scene.gaussians), &deformation, camera, &near)?;
        let size = [camera.width, camera.height];
        let lists = lists(&splats, size);
        let across = size[0].div_ceil(TILE) as usize;
        let found: Vec<_> = lists
            .par_iter()
            .enumerate()
            .flat_map_iter(|(tile, list)| {
                let corner = [(tile % across) as u32 * TILE, (tile / across) as u32 * TILE];
                (0..SUBTILES_OF_TILE).map(move |quadrant| (corner, list, quadrant))
            })
            .map(|(corner, list, quadrant)| walk(&splats, list, quadrant, corner, size))
            .collect();
        let instances: usize = lists.iter().map(Vec::len).sum();
        let [reached, blended] = found.iter().fold([0, 0], |sum, [r, b]| [sum[0] + r, sum[1] + b]);
        if reached == 0 {
            return Ok(Self::ALL);
        }
        let most = found.iter().map(|[_, blended]| *blended).max().unwrap_or(0);
        let longest = lists.iter().map(Vec::len).max().unwrap_or(0);
        let of_mean = |splats: usize| (splats * lists.len()) as f64 / instances as f64;
        Ok(Self {
            reached: reached as f64 / (SUBTILES_OF_TILE * instances) as f64,
            blended: blended as f64 / reached as f64,
            longest: of_mean(longest),
            most: of_mean(most),
        })
    }
}

/// A splat of a tile's list, and which quadrants of the tile it reaches.
struct Entry {
    splat: usize,
    quadrants: [bool; SUBTILES_OF_TILE],
}

/// The list of each tile, row by row, nearest splat first.
fn lists(splats: &[Splat], size: [u32; 2]) -> Vec<Vec<Entry>> {
    let across = size[0].div_ceil(TILE);
    let mut lists: Vec<Vec<Entry>> = Vec::new();
    lists.resize_with((across * size[1].div_ceil(TILE)) as usize, Vec::new);
    for (splat, one) in splats.iter().enumerate() {
        let ellipse = ellipse(one);
        squares(&ellipse, size, TILE, |column, row| {
            lists[(row * across + column) as usize].push(Entry { splat, quadrants: [false; SUBTILES_OF_TILE] });
        });
        squares(&ellipse, size, SUBTILE, |column, row| {
            let last = lists[(row / 2 * across + column / 2) as usize].last_mut();
            if let Some(entry) = last.filter(|e| e.splat == splat) {
                entry.quadrants[(row % 2 * 2 + column % 2) as usize] = true;
            }
        });
    }
    lists
}

/// Splats of a list that reach a quadrant, and those that are blended before its pixels are opaque.
fn walk(splats: &[Splat], list: &[Entry], quadrant: usize, corner: [u32; 2], size: [u32; 2]) -> [usize; 2] {
    let reached = list.iter().filter(|e| e.quadrants[quadrant]).count();
    let start = [corner[0] + quadrant as u32 % 2 * SUBTILE, corner[1] + quadrant as u32 / 2 * SUBTILE];
    let end = [(start[0] + SUBTILE).min(size[0]), (start[1] + SUBTILE).min(size[1])];
    let centre = |x: u32, y: u32| DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    let mut open: Vec<(DVec2, f64)> =
        (start[1]..end[1]).flat_map(|y| (start[0]..end[0]).map(move |x| (centre(x, y), 1.0))).collect();
    let mut blended = 0;
    for batch in list.chunks(BATCH) {
        if open.is_empty() {
            break;
        }
        for entry in batch.iter().filter(|e| e.quadrants[quadrant]) {
            blended += 1;
            let splat = &splats[entry.splat];
            open.retain_mut(|(pixel, transmittance)| {
                let alpha = splat.alpha(*pixel);
                *transmittance *= if alpha < ALPHA_MIN { 1.0 } else { 1.0 - alpha };
                *transmittance >= f64::from(MIN_TRANSMITTANCE)
            });
        }
    }
    [reached, blended]
}

/// In the kernels' units.
fn ellipse(splat: &Splat) -> Ellipse {
    let root = (0.5 * std::f64::consts::LOG2_E).sqrt();
    let [l11, l12, l22] = splat.factor.map(|l| (l * root) as f32);
    let mean = [splat.mean.x as f32, splat.mean.y as f32];
    Ellipse { mean, l11, l12, l22, log2_opacity: splat.opacity.log2() as f32, ..Ellipse::NONE }
}

/// Visits the squares of `side` pixels that an ellipse reaches (column, row), row by row as the kernels count tiles.
fn squares(ellipse: &Ellipse, size: [u32; 2], side: u32, mut visit: impl FnMut(u32, u32)) {
    let [first, end] = ellipse.tile_row_range(size);
    for row in first * TILE / side..(end * TILE).min(size[1]).div_ceil(side) {
        let low = (row * side) as f32 + 0.5;
        let high = ((row + 1) * side).min(size[1]) as f32 - 0.5;
        let [left, right] = ellipse.row_interval(low, high);
        let [first, end] = if left <= right { pixels_of_interval(left, right, size[0]) } else { [0, 0] };
        if first < end {
            (first / side..=(end - 1) / side).for_each(|column| visit(column, row));
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use engine::scene::synthetic::random_scene;

    use super::*;

    fn number(ellipse: &Ellipse, size: [u32; 2], side: u32) -> u64 {
        let mut number = 0;
        squares(ellipse, size, side, |_, _| number += 1);
        number
    }

    #[test]
    fn tiles_are_counted_as_the_kernels_count_them() {
        let ellipse = Ellipse { mean: [40.0, 30.0], l11: 0.1, l12: 0.02, l22: 0.15, ..Ellipse::NONE };
        assert_eq!(number(&ellipse, [100, 70], TILE), u64::from(ellipse.tile_count([100, 70])));
        assert!(number(&ellipse, [100, 70], SUBTILE) > number(&ellipse, [100, 70], TILE));
    }

    /// Of random Gaussians of one size and opacity.
    fn of(number: usize, log_scale: f32, opacity_logit: f32) -> Subtiles {
        let mut scene = random_scene(number, 1, 0);
        scene.gaussians.log_scale.iter_mut().for_each(|s| *s = [log_scale; 3]);
        scene.gaussians.opacity_logit.iter_mut().for_each(|o| *o = opacity_logit);
        let camera = crate::cli::camera::default_camera(&scene, [128, 128]);
        Subtiles::count(&scene, &camera, 0.0, &RenderOptions::default()).unwrap()
    }

    #[test]
    fn small_splats_reach_one_subtile_and_large_ones_all() {
        let [small, large] = [of(200, -9.0, 0.0).reached, of(200, 0.5, 0.0).reached];
        assert!((0.25..0.5).contains(&small), "{small}");
        assert!(large > 0.9, "{large}");
    }

    #[test]
    fn what_lies_behind_opaque_splats_is_not_blended() {
        // Each covers the image: the second at the largest alpha leaves 1e-4 at most, which ends a pixel at the third.
        let opaque = of(3000, 1.5, 12.0);
        assert!(opaque.blended < 0.05, "{opaque:?}");
        let thin = of(300, 1.5, -5.3);
        assert!(thin.blended == 1.0 && thin.most <= 1.0 + 1e-9, "{thin:?}");
    }
}
