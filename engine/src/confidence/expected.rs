//! The images that follow from what training views say.

use crate::error::Result;
use crate::gpu::Gpu;
use crate::render::{RenderOptions, Renderer};
use crate::scene::{Camera, Scene};
use crate::train::evidence::Evidence;

/// How far off an image may be.
#[derive(Debug, Clone, PartialEq)]
pub struct ExpectedErrors {
    /// `[H,W]` the mean of what a pixel may be off by: roots of mean squares over r, g, b; 0 to 1.
    pub error: Vec<f32>,
    /// `[H,W]` A of the image.
    pub opacity: Vec<f32>,
}

/// Draws how far off images may be.
#[derive(Debug)]
pub struct Confidence {
    renderer: Renderer,
}

impl Confidence {
    /// A renderer of [`Evidence::scene`].
    ///
    /// # Errors
    /// As [`Evidence::scene`] and [`Renderer::new`].
    pub fn new(gpu: &Gpu, scene: &Scene, options: &RenderOptions, evidence: &Evidence) -> Result<Self> {
        let (scene, options) = evidence.scene(scene, options)?;
        Ok(Self { renderer: Renderer::new(gpu, &scene, &options)? })
    }

    /// The errors to expect of a view.
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub fn render(&mut self, camera: &Camera, time: f64) -> Result<ExpectedErrors> {
        let image = self.renderer.render(camera, time)?;
        let of = |value: fn(&[f32]) -> f32| image.rgba.chunks_exact(4).map(value).collect();
        Ok(ExpectedErrors { error: of(|p| p[0].clamp(0.0, 1.0)), opacity: of(|p| p[3]) })
    }
}
