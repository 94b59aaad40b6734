//! How well a scene shows held-out views.

use crate::data::loader::ImageLoader;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::image::Image;
use crate::metrics::{self, Planes};
use crate::render::{RenderOptions, Renderer};
use crate::scene::Scene;

/// Scores of one view.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ViewScore {
    /// Index in the list of views.
    pub index: usize,
    /// Name of the frame.
    pub name: String,
    /// Time.
    pub time: f64,
    /// PSNR of the clamped float image, dB.
    pub psnr: f64,
    /// SSIM (11×11 Gaussian window, zero padding), mean over pixels and channels.
    pub ssim: f64,
}

/// Mean PSNR and SSIM.
pub fn mean(scores: &[ViewScore]) -> [f64; 2] {
    let n = scores.len().max(1) as f64;
    [scores.iter().map(|s| s.psnr).sum::<f64>() / n, scores.iter().map(|s| s.ssim).sum::<f64>() / n]
}

/// Renders the views `indices` of a loader and scores them; `each` gets every rendered image and its photo as `[H·W·3]`.
///
/// # Errors
/// Those of rendering and decoding; of `each`.
pub fn evaluate(
    gpu: &Gpu,
    scene: &Scene,
    loader: &ImageLoader,
    indices: &[usize],
    options: &RenderOptions,
    mut each: impl FnMut(&ViewScore, &Image, &Image) -> Result<()>,
) -> Result<Vec<ViewScore>> {
    let mut renderer = Renderer::new(gpu, scene, options)?;
    let mut scores = Vec::with_capacity(indices.len());
    loader.prefetch(indices);
    for &index in indices {
        let view = &loader.views()[index];
        let photo = loader.get(index)?;
        let rendered = renderer.render(&view.camera, view.time)?;
        let truth = composite(&photo, options.background);
        let (ours, photo) = (Planes::clamped(&rendered)?, Planes::clamped(&truth)?);
        let psnr = metrics::psnr(&photo, &ours, None)?;
        let ssim = metrics::ssim(&photo, &ours, None)?.zero_padded;
        let score = ViewScore { index, name: view.name.clone(), time: view.time, psnr, ssim };
        each(&score, &rendered, &truth)?;
        scores.push(score);
    }
    Ok(scores)
}

/// A photo over a background.
fn composite(photo: &crate::data::pixels::Pixels, background: [f32; 3]) -> Image {
    let pixel = |p: &u32| {
        let [r, g, b, a] = p.to_le_bytes().map(|c| f32::from(c) / 255.0);
        let over = |c: f32, i: usize| c + (1.0 - a) * background[i];
        [over(r, 0), over(g, 1), over(b, 2), a]
    };
    let rgba = photo.rgba.iter().flat_map(pixel).collect();
    Image { width: photo.width, height: photo.height, rgba, depth: Vec::new() }
}
