//! What training views say of each Gaussian.

use crate::data::loader::ImageLoader;
use crate::error::{Error, Result};
use crate::file::codec::SH_C0;
use crate::gpu::Gpu;
use crate::image::Image;
use crate::render::{RenderOptions, Renderer};
use crate::scene::{Camera, Gaussians, Scene};

use super::contribution::Contributions;

/// Pixels that count as much as what is thought of a Gaussian that nobody saw.
pub const PRIOR_PIXELS: f64 = 4.0;
/// Error of a colour that nobody checked: the mean distance of two values between 0 and 1.
pub const PRIOR_ERROR: f64 = 1.0 / 3.0;

/// Sums over training views.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// `[N]` Σ αT: pixels that each Gaussian makes up.
    pub visibility: Vec<f64>,
    /// `[N]` Σ αT e.
    pub error: Vec<f64>,
    /// The same two of what is behind everything: Σ T and Σ T e.
    pub background: [f64; 2],
}

impl Evidence {
    /// Nothing was seen of `n` Gaussians.
    pub fn new(n: usize) -> Self {
        Self { visibility: vec![0.0; n], error: vec![0.0; n], background: [0.0; 2] }
    }

    /// What all views of a loader say, rendered with `options`; `each` hears of each.
    ///
    /// # Errors
    /// Those of rendering and decoding.
    pub fn of_views(
        gpu: &Gpu,
        scene: &Scene,
        loader: &ImageLoader,
        options: &RenderOptions,
        mut each: impl FnMut(),
    ) -> Result<Self> {
        let mut evidence = Self::new(scene.gaussians.len());
        let mut contributions = Contributions::new(gpu, scene, options)?;
        let mut renderer = Renderer::new(gpu, scene, options)?;
        let order: Vec<usize> = (0..loader.views().len()).collect();
        loader.prefetch(&order);
        for index in order {
            let view = &loader.views()[index];
            let photo = loader.get(index)?.over(options.background);
            let rendered = renderer.render(&view.camera, view.time)?;
            evidence.add(&mut contributions, &view.camera, view.time, [&rendered, &photo])?;
            each();
        }
        Ok(evidence)
    }

    /// Adds a view: what was rendered of it, with A, and the photo over the same background.
    ///
    /// # Errors
    /// `Usage` for images of other sizes than the camera's; those of [`Contributions::of_view`].
    pub fn add(&mut self, of: &mut Contributions, camera: &Camera, time: f64, images: [&Image; 2]) -> Result<()> {
        let [rendered, photo] = images;
        for image in images {
            if [image.width, image.height] != [camera.width, camera.height] {
                let found = format!("{}×{} pixels", image.width, image.height);
                return Err(Error::usage(format!("image of {}", camera.name), found, "the camera's size"));
            }
        }
        let errors: Vec<Option<f32>> = errors(rendered, photo).into_iter().map(Some).collect();
        self.add_errors(of, camera, time, rendered, &errors)
    }

    /// Adds a view of which the errors are known, `[H,W]`; pixels without one say nothing.
    ///
    /// # Errors
    /// As [`Evidence::add`].
    pub fn add_errors(
        &mut self,
        of: &mut Contributions,
        camera: &Camera,
        time: f64,
        rendered: &Image,
        errors: &[Option<f32>],
    ) -> Result<()> {
        let weight: Vec<[f32; 3]> = errors.iter().map(|e| e.map_or([0.0; 3], |e| [1.0, e, 0.0])).collect();
        for (i, [seen, error, _]) in of.of_view(camera, time, &weight)?.into_iter().enumerate() {
            self.visibility[i] += f64::from(seen);
            self.error[i] += f64::from(error);
        }
        for (pixel, [seen, error, _]) in rendered.rgba.chunks_exact(4).zip(weight) {
            let behind = f64::from((1.0 - pixel[3]).max(0.0));
            self.background[0] += behind * f64::from(seen);
            self.background[1] += behind * f64::from(error);
        }
        Ok(())
    }

    /// `Usage` unless it is about as many Gaussians as the scene has.
    pub(crate) fn check(&self, scene: &Scene) -> Result<()> {
        let [n, own] = [scene.gaussians.len(), self.visibility.len()];
        if own != n || self.error.len() != n {
            return Err(Error::usage("evidence", format!("of {own} Gaussians"), format!("{n} Gaussians")));
        }
        Ok(())
    }

    /// `[N]` the error to expect of each Gaussian, and of what is behind all.
    pub fn expected(&self) -> (Vec<f64>, f64) {
        let of = |seen: f64, error: f64| (error + PRIOR_PIXELS * PRIOR_ERROR) / (seen + PRIOR_PIXELS);
        let each = self.visibility.iter().zip(&self.error).map(|(v, e)| of(*v, *e));
        (each.collect(), of(self.background[0], self.background[1]))
    }

    /// The scene with the error to expect for r, g and b, and the options with the background's: what it renders to is the
    /// expected error of each pixel.
    ///
    /// # Errors
    /// `Usage` for evidence of another number of Gaussians.
    pub fn scene(&self, scene: &Scene, options: &RenderOptions) -> Result<(Scene, RenderOptions)> {
        self.check(scene)?;
        let (each, behind) = self.expected();
        let color = |error: f64| ((error - 0.5) / SH_C0) as f32;
        let sh = each.iter().flat_map(|s| [color(*s); 3]).collect();
        let gaussians = Gaussians { sh, sh_degree: 0, ..scene.gaussians.clone() };
        let options = RenderOptions { background: [behind as f32; 3], ..options.clone() };
        Ok((Scene { gaussians, ..scene.clone() }, options))
    }
}

/// Root of the mean square of r, g and b's differences, per pixel.
pub(crate) fn errors(a: &Image, b: &Image) -> Vec<f32> {
    let of_pixel = |(a, b): (&[f32], &[f32])| {
        let sum: f32 = a[..3].iter().zip(&b[..3]).map(|(a, b)| (a.clamp(0.0, 1.0) - b).powi(2)).sum();
        // Nothing that is not a number may reach the sums.
        if sum.is_finite() { (sum / 3.0).sqrt() } else { 1.0 }
    };
    a.rgba.chunks_exact(4).zip(b.rgba.chunks_exact(4)).map(of_pixel).collect()
}
