//! A view on the device and in the f64 reference.

use engine::error::Result;
use engine::gpu::Gpu;
use engine::image::{Difference, Image, difference};
use engine::reference::{self, ReferenceImage, ReferenceOptions};
use engine::render::{FrameStatistics, RenderOptions, Renderer};
use engine::scene::synthetic::HardCase;
use engine::scene::{Camera, Scene};

use super::case::{Check, Outcome};

/// PSNR that every image must reach, dB.
pub(super) const MIN_PSNR: f64 = 65.0;
/// Share of values that must be within 1e-3.
pub(super) const MIN_WITHIN: f64 = 0.999;

/// Both sides of a view.
#[derive(Debug)]
pub(super) struct Comparison {
    pub(super) image: Image,
    pub(super) truth: ReferenceImage,
    pub(super) color: Difference,
    pub(super) alpha: Difference,
    pub(super) statistics: FrameStatistics,
    /// Gaussians refused on upload.
    pub(super) rejected: usize,
}

/// Options of the reference that mean what `options` mean.
pub(super) fn reference_options(options: &RenderOptions) -> ReferenceOptions {
    ReferenceOptions {
        near: f64::from(options.near),
        background: options.background.map(f64::from),
        motion: options.motion,
    }
}

/// Near plane and background of a hard case.
pub(super) fn options_of(case: &HardCase) -> RenderOptions {
    RenderOptions { near: case.near, background: case.background, ..RenderOptions::default() }
}

/// A background with three different channels.
pub(super) fn usual_options() -> RenderOptions {
    RenderOptions { background: [0.25, 0.5, 0.125], ..RenderOptions::default() }
}

/// Renders on both sides.
pub(super) fn compare(
    gpu: &Gpu,
    scene: &Scene,
    camera: &Camera,
    time: f64,
    options: &RenderOptions,
) -> Result<Comparison> {
    let options = RenderOptions { depth: true, ..options.clone() };
    let mut renderer = Renderer::new(gpu, scene, &options)?;
    let (frame, statistics) = renderer.draw(camera, time)?;
    let image = renderer.read(frame)?;
    let truth = reference::render(scene, camera, time, &reference_options(&options))?;
    let color = difference(truth.rgb.iter().copied(), image.rgb());
    let alpha = difference(truth.alpha.iter().copied(), image.rgba.iter().skip(3).step_by(4).map(|&a| f64::from(a)));
    Ok(Comparison { image, truth, color, alpha, statistics, rejected: renderer.rejected().total() })
}

impl Comparison {
    /// The checks of every image.
    pub(super) fn checks(&self) -> Vec<Check> {
        let within = self.color.within_1e3.min(self.alpha.within_1e3);
        vec![
            Check::shown("largest colour error", self.color.max),
            Check::at_least("PSNR of colour and alpha, dB", self.color.psnr.min(self.alpha.psnr), MIN_PSNR),
            Check::at_least("share of values within 1e-3", within, MIN_WITHIN),
            Check::exactly("values of image and depth that are not finite", self.not_finite(), 0),
        ]
    }

    fn not_finite(&self) -> usize {
        self.image.rgba.iter().chain(&self.image.depth).filter(|v| !v.is_finite()).count()
    }

    /// What the truth says, in words.
    pub(super) fn truth_in_words(&self) -> String {
        let pixels = self.truth.alpha.len().max(1) as f64;
        let covered = self.truth.alpha.iter().filter(|&&a| a > 0.0).count() as f64 / pixels;
        let alpha = self.truth.alpha.iter().sum::<f64>() / pixels;
        let mut text = format!(
            "{} splats in front of the near plane, {:.0} % of the pixels covered, mean alpha {alpha:.4}",
            self.truth.visible,
            100.0 * covered
        );
        if self.truth.rejected.total() > 0 {
            text += &format!(", {} Gaussians refused", self.truth.rejected.total());
        }
        text
    }

    pub(super) fn outcome(&self) -> Outcome {
        Outcome { truth: self.truth_in_words(), checks: self.checks() }
    }
}
