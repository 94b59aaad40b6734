//! Where a measured training run starts: a disturbed copy of known Gaussians, and photos of a synthetic scene.

use std::f64::consts::TAU;

use engine::data::dataset::View;
use engine::data::pixels::ImageSource;
use engine::error::{Error, Result};
use engine::file::picture::{Alpha, write_png};
use engine::gpu::Gpu;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::Random;
use engine::scene::{Camera, Gaussians, Scene};
use engine::train::trainer::TrainingData;
use glam::DVec3;

use crate::cli::camera;

/// Deviation of the centres, world units, and of the log scales.
const MEAN_NOISE: f64 = 0.01;
const LOG_SCALE_NOISE: f64 = 0.1;
/// What is left of the SH coefficients of degree 0.
const SH_0_KEPT: f32 = 0.3;
/// Photos of a synthetic scene: around it, at as many times.
const PHOTOS: usize = 6;

/// Gaussians that a training run finds back from: centres + N(0, 0.01), degree 0 of SH × 0.3 and the rest 0, opacity ½,
/// the mean of the three log scales + N(0, 0.1) for all three, random rotations. Same arguments, same result.
pub(super) fn disturbed(gaussians: &Gaussians, seed: u64) -> Gaussians {
    let mut random = Random::new(seed ^ 0xd15);
    let mut g = gaussians.clone();
    let row = 3 * g.sh_coefficients();
    for i in 0..g.len() {
        let shift = MEAN_NOISE * random.normal3();
        let moved = DVec3::from_array(g.mean[i].map(f64::from)) + shift;
        g.mean[i] = moved.as_vec3().to_array();
        let mean = g.log_scale[i].iter().map(|&s| f64::from(s)).sum::<f64>() / 3.0;
        g.log_scale[i] = [(mean + LOG_SCALE_NOISE * random.normal()) as f32; 3];
        // Four normals are a uniformly distributed rotation once they are divided by their length.
        g.rotation[i] = [random.normal(), random.normal(), random.normal(), random.normal()].map(|q| q as f32);
        g.opacity_logit[i] = 0.0;
        let sh = &mut g.sh[i * row..(i + 1) * row];
        sh[..3].iter_mut().for_each(|c| *c *= SH_0_KEPT);
        sh[3..].fill(0.0);
    }
    g
}

/// Photos of a scene from all sides and over its time, in a folder that lives as long as the first result.
pub(super) fn photos(
    gpu: &Gpu,
    scene: &Scene,
    size: [u32; 2],
    background: [f32; 3],
) -> Result<(tempfile::TempDir, TrainingData)> {
    let temp = std::env::temp_dir();
    let folder = tempfile::tempdir().map_err(|e| Error::io(&temp, "create a folder in", e))?;
    let mut renderer = Renderer::new(gpu, scene, &RenderOptions { background, ..RenderOptions::default() })?;
    let first = camera::default_camera(scene, size);
    let [begin, end] = scene.time_range();
    let radius = first.position.length();
    let mut views = Vec::with_capacity(PHOTOS);
    for i in 0..PHOTOS {
        let angle = TAU * i as f64 / PHOTOS as f64;
        let eye = radius * DVec3::new(angle.cos(), -0.3, angle.sin()).normalize();
        let fov_x = 2.0 * (0.5 * f64::from(size[0]) / first.fx).atan();
        let time = begin + (end - begin) * i as f64 / PHOTOS as f64;
        let camera = Camera { time, ..Camera::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, fov_x, size) };
        let path = folder.path().join(format!("{i:05}.png"));
        write_png(&path, &renderer.render(&camera, time)?, Alpha::Drop)?;
        let image = ImageSource { path, stored: size, size, lens: None, mask: None, used: None };
        views.push(View { name: format!("{i:05}"), camera, time, image });
    }
    let data = TrainingData { views: views.into(), extent: 1.1 * radius, is_static: !scene.is_dynamic() };
    Ok((folder, data))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use engine::scene::synthetic::random_gaussians;

    use super::*;

    #[test]
    fn disturbed_gaussians_are_what_peers_start_from() {
        let g = random_gaussians(4000, 3, 3);
        let d = disturbed(&g, 1);
        assert_eq!(d, disturbed(&g, 1));
        assert_ne!(d, disturbed(&g, 2));
        let shift = (0..4000).map(|i| f64::from(d.mean[i][0] - g.mean[i][0]).powi(2)).sum::<f64>() / 4000.0;
        assert!((shift.sqrt() - 0.01).abs() < 5e-4, "{shift}");
        assert!(d.log_scale.iter().all(|s| s[0] == s[1] && s[1] == s[2]));
        assert!(d.opacity_logit.iter().all(|o| *o == 0.0));
        for (was, is) in g.sh.chunks_exact(48).zip(d.sh.chunks_exact(48)) {
            assert!((0..3).all(|c| is[c] == 0.3 * was[c]) && is[3..].iter().all(|c| *c == 0.0));
        }
    }
}
