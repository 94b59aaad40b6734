//! Building blocks of the hard cases.

use glam::DVec3;

use super::HardCase;
use crate::scene::synthetic::random_gaussians;
use crate::scene::{Camera, Gaussians, Scene};

/// A case with the usual near plane and background, standing still.
pub(super) fn case(name: &'static str, doc: &'static str, gaussians: Gaussians, camera: Camera) -> HardCase {
    HardCase {
        name,
        doc,
        scene: Scene { gaussians, ..Scene::default() },
        camera,
        time: 0.0,
        near: 0.2,
        background: [0.1, 0.2, 0.3],
        rejected: 0,
        empty: false,
    }
}

/// `n` random Gaussians of SH degree 1 around the origin.
pub(super) fn cloud(n: usize, seed: u64) -> Gaussians {
    random_gaussians(n, seed, 1)
}

/// The same Gaussians, all balls of standard deviation `size`.
pub(super) fn sized(mut gaussians: Gaussians, size: f64) -> Gaussians {
    gaussians.log_scale.fill([size.ln() as f32; 3]);
    gaussians
}

/// A camera 4 units before the origin that sees the whole of a [`cloud`].
pub(super) fn look(width: u32, height: u32) -> Camera {
    let focal = 1.3 * f64::from(width.max(height));
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 1.0, [width, height]);
    Camera { fx: focal, fy: focal, ..camera }
}

/// A camera at the origin that looks along z.
pub(super) fn ahead(width: u32, height: u32) -> Camera {
    Camera { position: DVec3::ZERO, ..look(width, height) }
}

/// Balls one behind the other on the z axis, in many colours.
pub(super) fn stack(depths: &[f32], opacity: f64, size: f64) -> Gaussians {
    let n = depths.len();
    let color = |i: usize, c: usize| (1.6 * ((i * (c + 3)) as f32 * 0.7).sin()).clamp(-1.7, 1.7);
    Gaussians {
        mean: depths.iter().map(|&z| [0.0, 0.0, z]).collect(),
        log_scale: vec![[size.ln() as f32; 3]; n],
        rotation: vec![[1.0, 0.0, 0.0, 0.0]; n],
        // For opacity 1 this is the infinite logit, which is legal.
        opacity_logit: vec![(opacity / (1.0 - opacity)).ln() as f32; n],
        sh_degree: 0,
        sh: (0..n).flat_map(|i| (0..3).map(move |c| color(i, c))).collect(),
        ..Gaussians::default()
    }
}

/// Gives all Gaussians one colour, so that which of them are visible shows, but not their order.
pub(super) fn constant_color(gaussians: &mut Gaussians) {
    gaussians.sh.fill(1.0);
}
