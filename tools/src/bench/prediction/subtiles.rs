//! How much of a tile a splat reaches: counted on the CPU for the measured view, because no counter of a frame says it.

use engine::error::Result;
use engine::reference::gradient::image::visible_splats;
use engine::reference::{self, Blend64, DeformationAt, Gaussians64, ReferenceOptions, Splat};
use engine::render::RenderOptions;
use engine::render::ellipse::{Ellipse, pixels_of_interval};
use engine::scene::{Camera, Scene};

/// Pixels of a side of a subtile, and of a tile.
const SUBTILE: u32 = 8;
const TILE: u32 = 16;
const SUBTILES_OF_TILE: u64 = 4;

/// Of the four subtiles of each tile that a splat reaches, the share that it reaches too; 1 where nothing is visible.
pub(crate) fn share(scene: &Scene, camera: &Camera, time: f64, options: &RenderOptions) -> Result<f64> {
    let poses = reference::poses(scene, time, options.motion)?;
    let group = scene.deformation.superpoint_of_gaussian();
    let blend = Blend64::of(scene);
    let deformation = DeformationAt { group, blend: blend.as_ref(), poses: poses.as_deref(), offsets: None, time };
    let near = ReferenceOptions { near: options.near.into(), ..ReferenceOptions::default() };
    let splats = visible_splats(&Gaussians64::from(&scene.gaussians), &deformation, camera, &near)?;
    let size = [camera.width, camera.height];
    let (mut subtiles, mut tiles) = (0, 0);
    for ellipse in splats.iter().map(ellipse) {
        subtiles += reached(&ellipse, size, SUBTILE);
        tiles += reached(&ellipse, size, TILE);
    }
    Ok(if tiles == 0 { 1.0 } else { subtiles as f64 / (SUBTILES_OF_TILE * tiles) as f64 })
}

/// In the kernels' units.
fn ellipse(splat: &Splat) -> Ellipse {
    let root = (0.5 * std::f64::consts::LOG2_E).sqrt();
    let [l11, l12, l22] = splat.factor.map(|l| (l * root) as f32);
    let mean = [splat.mean.x as f32, splat.mean.y as f32];
    Ellipse { mean, l11, l12, l22, log2_opacity: splat.opacity.log2() as f32, ..Ellipse::NONE }
}

/// Squares of `side` pixels that an ellipse reaches, row by row as the kernels count tiles.
fn reached(ellipse: &Ellipse, size: [u32; 2], side: u32) -> u64 {
    let [first, end] = ellipse.tile_row_range(size);
    let rows = first * TILE / side..(end * TILE).min(size[1]).div_ceil(side);
    let of_row = |row: u32| {
        let low = (row * side) as f32 + 0.5;
        let high = ((row + 1) * side).min(size[1]) as f32 - 0.5;
        let [left, right] = ellipse.row_interval(low, high);
        let [first, end] = if left <= right { pixels_of_interval(left, right, size[0]) } else { [0, 0] };
        if first < end { u64::from((end - 1) / side - first / side + 1) } else { 0 }
    };
    rows.map(of_row).sum()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use engine::scene::synthetic::random_scene;

    use super::*;

    #[test]
    fn tiles_are_counted_as_the_kernels_count_them() {
        let ellipse = Ellipse { mean: [40.0, 30.0], l11: 0.1, l12: 0.02, l22: 0.15, ..Ellipse::NONE };
        assert_eq!(reached(&ellipse, [100, 70], TILE), u64::from(ellipse.tile_count([100, 70])));
        assert!(reached(&ellipse, [100, 70], SUBTILE) > reached(&ellipse, [100, 70], TILE));
    }

    #[test]
    fn small_splats_reach_one_subtile_and_large_ones_all() {
        let of = |log_scale: f32| {
            let mut scene = random_scene(200, 1, 0);
            scene.gaussians.log_scale.iter_mut().for_each(|s| *s = [log_scale; 3]);
            let camera = crate::cli::camera::default_camera(&scene, [128, 128]);
            share(&scene, &camera, 0.0, &RenderOptions::default()).unwrap()
        };
        let (small, large) = (of(-9.0), of(0.5));
        assert!((0.25..0.5).contains(&small), "{small}");
        assert!(large > 0.9, "{large}");
    }
}
