//! How well a scene shows held-out views.

use std::sync::Arc;

use crate::data::loader::ImageLoader;
use crate::data::pixels::Pixels;
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

/// A held-out view beside its rendering.
#[derive(Debug, Clone)]
pub struct RenderedView {
    index: usize,
    name: String,
    time: f64,
    rendered: Image,
    photo: Arc<Pixels>,
    background: [f32; 3],
}

impl RenderedView {
    /// The view's scores, and its photo as `[H·W·3]`.
    ///
    /// # Errors
    /// `Usage` when sizes differ.
    pub fn score(&self) -> Result<(ViewScore, Image)> {
        let truth = self.photo.over(self.background);
        let (ours, photo) = (Planes::clamped(&self.rendered)?, Planes::clamped(&truth)?);
        let psnr = metrics::psnr(&photo, &ours, None)?;
        let ssim = metrics::ssim(&photo, &ours, None)?.zero_padded;
        Ok((ViewScore { index: self.index, name: self.name.clone(), time: self.time, psnr, ssim }, truth))
    }
}

/// Renders the views `indices` of a loader.
///
/// # Errors
/// Those of rendering and decoding.
pub fn render_views(
    gpu: &Gpu,
    scene: &Scene,
    loader: &ImageLoader,
    indices: &[usize],
    options: &RenderOptions,
) -> Result<Vec<RenderedView>> {
    let mut views = Vec::with_capacity(indices.len());
    each_view(gpu, scene, loader, indices, options, |view| {
        views.push(view);
        Ok(())
    })?;
    Ok(views)
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
    let mut scores = Vec::with_capacity(indices.len());
    each_view(gpu, scene, loader, indices, options, |view| {
        let (score, truth) = view.score()?;
        each(&score, &view.rendered, &truth)?;
        scores.push(score);
        Ok(())
    })?;
    Ok(scores)
}

fn each_view(
    gpu: &Gpu,
    scene: &Scene,
    loader: &ImageLoader,
    indices: &[usize],
    options: &RenderOptions,
    mut each: impl FnMut(RenderedView) -> Result<()>,
) -> Result<()> {
    let mut renderer = Renderer::new(gpu, scene, options)?;
    loader.prefetch(indices);
    for &index in indices {
        let view = &loader.views()[index];
        let photo = loader.get(index)?;
        let rendered = renderer.render(&view.camera, view.time)?;
        let (name, time, background) = (view.name.clone(), view.time, options.background);
        each(RenderedView { index, name, time, rendered, photo, background })?;
    }
    Ok(())
}

/// How much of what cut-out photos show a model leaves empty.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Coverage {
    /// Pixels whose photo is opaque (alpha at least 0.9).
    pub opaque: u64,
    /// Of these, pixels that the model covers to less than a half.
    pub empty: u64,
    /// Pixels whose photo is transparent (alpha below a half); 0 for photos that are not cut out.
    pub transparent: u64,
}

impl Coverage {
    /// Adds a view: the rendered image with its alpha, and the photo with its own, as [`evaluate`] gives them.
    pub fn add(&mut self, rendered: &Image, photo: &Image) {
        for (ours, photo) in rendered.rgba.as_chunks::<4>().0.iter().zip(photo.rgba.as_chunks::<4>().0) {
            let opaque = photo[3] >= 0.9;
            self.opaque += u64::from(opaque);
            self.empty += u64::from(opaque && ours[3] < 0.5);
            self.transparent += u64::from(photo[3] < 0.5);
        }
    }

    /// Share of the opaque pixels that is empty; `None` where the photos are not cut out.
    pub fn empty_share(&self) -> Option<f64> {
        (self.transparent > 0 && self.opaque > 0).then(|| self.empty as f64 / self.opaque as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(alpha: [f32; 4]) -> Image {
        Image {
            width: 4,
            height: 1,
            rgba: alpha.map(|a| [0.0, 0.0, 0.0, a]).as_flattened().to_vec(),
            depth: Vec::new(),
        }
    }

    #[test]
    fn what_is_left_empty_is_counted_where_photos_are_opaque() {
        let mut coverage = Coverage::default();
        coverage.add(&image([0.2, 0.9, 0.0, 0.1]), &image([1.0, 1.0, 0.0, 0.7]));
        assert_eq!(coverage, Coverage { opaque: 2, empty: 1, transparent: 1 });
        assert_eq!(coverage.empty_share(), Some(0.5));
        let mut captured = Coverage::default();
        captured.add(&image([0.0; 4]), &image([1.0; 4]));
        assert_eq!(captured.empty_share(), None, "captures are opaque everywhere: nothing says what is background");
    }
}
