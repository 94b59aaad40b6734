//! Case 20: the same Gaussians under the rules of the original CUDA rasteriser.

use engine::error::Result;
use engine::image::difference;
use engine::reference::gradient::image::visible_splats;
use engine::reference::{DeformationAt, Gaussians64, Splat};
use engine::render::{RenderOptions, Renderer};
use engine::scene::Camera;
use engine::scene::synthetic::random_scene;

use super::blend::{Rules, blend};
use super::case::{Case, Check, Context, Outcome};
use super::compare::reference_options;
use super::views;

/// Edge of the original's tiles, pixels.
const TILE: f64 = 16.0;

pub(super) fn cases() -> Vec<Case> {
    let input = "5,000 Gaussians under the rules of diff-gaussian-rasterization: whole tiles within 3 sigma of the larger axis.";
    vec![Case::new(20, "original_rasteriser", input, judge)]
}

/// The original's test: the pixel's tile meets the square of half-edge ⌈3·√λ⌉ about the centre, λ the larger eigenvalue
/// of Σ₂, whose discriminant is at least 0.1.
fn within_3_sigma(splat: &Splat, pixel: [u32; 2], _: &Camera) -> bool {
    let [a, b, c] = splat.covariance;
    let middle = 0.5 * (a + c);
    let root = (middle * middle - (a * c - b * b)).max(0.1).sqrt();
    let radius = (3.0 * (middle + root).sqrt()).ceil();
    // It works with pixel centres at integers: its centre is half a pixel less than ours.
    let center = [splat.mean.x - 0.5, splat.mean.y - 0.5];
    (0..2).all(|k| {
        let tile = (f64::from(pixel[k]) / TILE).floor();
        let first = ((center[k] - radius) / TILE).floor();
        let last = ((center[k] + radius + TILE - 1.0) / TILE).floor();
        (first..last).contains(&tile)
    })
}

fn judge(context: &Context<'_>) -> Result<Outcome> {
    let scene = random_scene(5000, 201, 3);
    let camera = views::camera(160, 120);
    let options = RenderOptions::default();
    let truth = reference_options(&options);
    let splats = visible_splats(&Gaussians64::from(&scene.gaussians), &DeformationAt::default(), &camera, &truth)?;
    let ours = blend(splats.iter(), &camera, truth.background, Rules::default());
    let original =
        blend(splats.iter(), &camera, truth.background, Rules { reaches: within_3_sigma, ..Rules::default() });
    let image: Vec<f64> = Renderer::new(context.gpu, &scene, &options)?.render(&camera, 0.0)?.rgb().collect();
    let same = difference(ours.iter().copied(), image.iter().copied());
    let other = difference(original.iter().copied(), image.iter().copied());
    let rules = difference(original, ours);
    Ok(Outcome {
        truth: format!(
            "the rules differ only in what lies beyond 3 sigma: {:.1} dB, {:.1e} at most, whoever computes it",
            rules.psnr, rules.max
        ),
        checks: vec![
            Check::at_least("PSNR against the original's rules, dB", other.psnr, 60.0),
            Check::shown("largest difference from the original's rules", other.max),
            Check::at_least("PSNR against our rules by brute force, dB", same.psnr, 65.0),
        ],
    })
}
