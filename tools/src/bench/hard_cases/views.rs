//! Cases 8 and 9: three times the field of view; the same view at half and double resolution.

use engine::error::Result;
use engine::image::{Image, difference};
use engine::scene::Camera;
use engine::scene::synthetic::random_scene;
use glam::DVec3;

use super::case::{Case, Check, Context, Outcome};
use super::compare::{compare, usual_options};

pub(super) fn cases() -> Vec<Case> {
    let triple = "4,000 Gaussians through three times the usual field of view (137 degrees), the camera among them.";
    let scales = "4,000 Gaussians at 64, 128 and 256 pixels: each equals its own truth, and how far scales agree.";
    vec![
        Case::new(8, "field_of_view_times_3", triple, judge_wide),
        Case::new(9, "half_and_double_resolution", scales, judge_scales),
    ]
}

/// A view of the whole of a random scene.
pub(super) fn camera(width: u32, height: u32) -> Camera {
    Camera::look_at(DVec3::new(0.3, -1.0, -4.5), DVec3::ZERO, DVec3::NEG_Y, 0.8, [width, height])
}

fn judge_wide(context: &Context<'_>) -> Result<Outcome> {
    let scene = random_scene(4000, 81, 2);
    let eye = DVec3::new(0.2, -0.3, -1.1);
    let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, 2.4, [120, 90]);
    Ok(compare(context.gpu, &scene, &camera, 0.0, &usual_options())?.outcome())
}

/// Means over 2×2 pixels, `[H/2,W/2,3]`.
fn halved(rgb: &[f64], size: [usize; 2]) -> Vec<f64> {
    let [width, height] = size;
    let at = |x: usize, y: usize, c: usize| rgb[3 * (y * width + x) + c];
    let mut out = Vec::with_capacity(rgb.len() / 4);
    for y in (0..height).step_by(2) {
        for x in (0..width).step_by(2) {
            let mean = |c| 0.25 * (at(x, y, c) + at(x + 1, y, c) + at(x, y + 1, c) + at(x + 1, y + 1, c));
            out.extend((0..3).map(mean));
        }
    }
    out
}

fn judge_scales(context: &Context<'_>) -> Result<Outcome> {
    let scene = random_scene(4000, 82, 2);
    let rgb = |image: &Image| image.rgb().collect::<Vec<f64>>();
    let mut worst = f64::INFINITY;
    let mut sides = Vec::new();
    for size in [64_u32, 128, 256] {
        let c = compare(context.gpu, &scene, &camera(size, size), 0.0, &usual_options())?;
        worst = worst.min(c.color.psnr).min(c.alpha.psnr);
        sides.push((size as usize, rgb(&c.image), c.truth.rgb));
    }
    // How far a picture is from the next larger one, averaged down: the method's own aliasing, the same on both sides.
    let mut checks = vec![Check::at_least("worst PSNR against the truth of the same size, dB", worst, 65.0)];
    let mut texts = Vec::new();
    for pair in sides.windows(2) {
        let (small, large) = (&pair[0], &pair[1]);
        let size = [large.0; 2];
        let device = difference(small.1.iter().copied(), halved(&large.1, size)).psnr;
        let truth = difference(small.2.iter().copied(), halved(&large.2, size)).psnr;
        checks.push(Check::at_most(
            format!("PSNR {}↔{}, device − truth, dB", small.0, large.0),
            (device - truth).abs(),
            0.01,
        ));
        texts.push(format!("{} and {} pixels agree to {truth:.2} dB", small.0, large.0));
    }
    Ok(Outcome { truth: format!("{} (0.3 px² are added at every scale)", texts.join(", ")), checks })
}
