//! Gaussians as wide at full size as in the small photos that they are trained on.
//!
//! A splat is blurred by 0.3 px² of the image that it is drawn in. In a photo halved k times that is 0.3·4ᵏ px² of the full one: drawn
//! there, what was trained on small photos would be thinner, and leave gaps. What the two differ by is added to a Gaussian's own size.

use glam::DVec3;

use super::bake::Views;
use super::pyramid::Pyramid;
use crate::scene::{Camera, Gaussians};

/// Blur of a splat, px² (3DGS).
const BLUR: f64 = 0.3;
/// Photos in which a pixel's size is measured.
const MEASURED: usize = 16;

/// Adds to Gaussians what photos halved so often blur them by and full ones do not, as the full photo that shows each largest has it.
pub(super) fn widen(gaussians: &mut Gaussians, pyramid: &Pyramid, near: f64, halvings: u32) {
    let variance = BLUR * (4_f64.powi(halvings as i32) - 1.0);
    if variance <= 0.0 {
        return;
    }
    let photos = pyramid.full();
    let cameras = photos.iter().step_by(photos.len().div_ceil(MEASURED).max(1)).map(|v| v.camera.clone());
    let views = Views::<Camera> { cameras: cameras.collect(), near, everywhere: true };
    for (mean, log_scale) in gaussians.mean.iter().zip(&mut gaussians.log_scale) {
        let reach = views.reach(DVec3::from_array(mean.map(f64::from)));
        if reach > 0.0 {
            let gained = variance / (reach * reach);
            log_scale.iter_mut().for_each(|s| *s = (0.5 * ((2.0 * f64::from(*s)).exp() + gained).ln()) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::data::dataset::View;
    use crate::data::pixels::ImageSource;
    use crate::reference::{ReferenceOptions, render};
    use crate::scene::Scene;
    use crate::scene::synthetic::random_scene;

    /// The small photo's image, each pixel repeated, is nearly what widened Gaussians show at full size; others are thinner.
    #[test]
    fn widened_gaussians_cover_as_much_as_in_the_small_photo() {
        let camera = Camera::look_at(DVec3::new(0.0, 0.0, -5.0), DVec3::ZERO, DVec3::Y, 0.8, [96, 96]);
        let image =
            ImageSource { path: "a.png".into(), stored: [96, 96], size: [96, 96], lens: None, mask: None, used: None };
        let view = View { name: "a".into(), camera: camera.clone(), time: 0.0, image };
        let pyramid = Pyramid::new(&vec![view].into(), 100, |_| 1e3);
        let mut gaussians = random_scene(60, 3, 0).gaussians;
        gaussians.log_scale.fill([-5.0; 3]);
        let alpha = |gaussians: &Gaussians, camera: &Camera| -> f64 {
            let scene = Scene { gaussians: gaussians.clone(), ..Scene::default() };
            let image = render(&scene, camera, 0.0, &ReferenceOptions::default()).unwrap().to_image();
            let share = image.rgba.iter().skip(3).step_by(4).map(|a| f64::from(*a)).sum::<f64>();
            share / f64::from(camera.width * camera.height)
        };
        assert_eq!(pyramid.halvings(1), 2);
        let small = alpha(&gaussians, &camera.resized(24, 24));
        let before = alpha(&gaussians, &camera);
        let mut wide = gaussians.clone();
        widen(&mut wide, &pyramid, 0.2, 2);
        let after = alpha(&wide, &camera);
        assert!((after / small - 1.0).abs() < 0.1 && before < 0.3 * small, "{before} → {after}, {small} in small");
        widen(&mut gaussians, &pyramid, 0.2, 0);
        assert_eq!(gaussians.log_scale[0], [-5.0; 3]);
    }
}
