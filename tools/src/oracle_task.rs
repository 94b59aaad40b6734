//! `spgs-dev oracle-check`: the f64 reference and the GPU against images of an independent float64 implementation.

use std::path::Path;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::image::{Difference, difference};
use engine::render::{RenderOptions, Renderer};
use serde::Serialize;

use crate::oracle::{self, GradientErrors, SuperpointDifference};

/// Least PSNR of the f64 reference against the file, dB.
pub const REFERENCE_PSNR: f64 = 90.0;
/// Least PSNR of the GPU against the file, dB.
pub const GPU_PSNR: f64 = 65.0;
/// Largest relative error of motion in f64 against the file.
pub const MOTION_ERROR: f64 = 1e-5;

/// Largest relative error of the f64 reference's gradients against the file.
pub const REFERENCE_GRADIENT_ERROR: f64 = 1e-9;
/// Largest relative error of the GPU's gradients against the file.
pub const GPU_GRADIENT_ERROR: f64 = 1e-4;

/// Both implementations against one image.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ImageCheck {
    /// The f64 reference.
    pub reference: Difference,
    /// The renderer.
    pub gpu: Difference,
}

/// What was found for one file.
#[derive(Debug, Clone, Serialize)]
pub struct Check {
    /// The file.
    pub file: String,
    /// For a file with an image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<ImageCheck>,
    /// For a file with an image's gradients: relative L2 errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gradients: Option<GradientErrors>,
    /// For a file with superpoint motion: relative errors of the f64 reference.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<SuperpointDifference>,
}

impl Check {
    /// Whether everything is within its bound.
    pub fn passes(&self) -> bool {
        let image = self.image.is_none_or(|i| i.reference.psnr >= REFERENCE_PSNR && i.gpu.psnr >= GPU_PSNR);
        let motion = self.motion.is_none_or(|m| {
            [m.pose_rotation, m.pose_translation, m.mean, m.rotation].iter().all(|e| *e <= MOTION_ERROR)
        });
        let gradients = self.gradients.is_none_or(|g| {
            g.rows().iter().all(|(_, e)| e.reference <= REFERENCE_GRADIENT_ERROR && e.gpu <= GPU_GRADIENT_ERROR)
        });
        image && motion && gradients
    }

    /// One line for the terminal.
    pub fn describe(&self) -> String {
        let mut text = self.file.clone();
        let line = |d: &Difference| format!("PSNR {:.2} dB, max {:.3e}, q999 {:.3e}", d.psnr, d.max, d.q999);
        if let Some(i) = &self.image {
            text += &format!(": reference {}; gpu {}", line(&i.reference), line(&i.gpu));
        }
        if let Some(g) = &self.gradients {
            text += "; relative errors of gradients, reference and gpu:";
            for (name, error) in g.rows() {
                text += &format!(" {name} {:.1e} {:.1e},", error.reference, error.gpu);
            }
            text.pop();
        }
        if let Some(m) = &self.motion {
            text += &format!(
                ": f64 motion, relative errors: pose rotation {:.2e}, pose translation {:.2e}, mean {:.2e}, rotation {:.2e}",
                m.pose_rotation, m.pose_translation, m.mean, m.rotation
            );
        }
        text + if self.passes() { " (ok)" } else { " (TOO FAR)" }
    }
}

/// Checks one file. `None`: it holds neither an image with its Gaussians nor superpoint motion.
pub fn check(gpu: &Gpu, path: &Path) -> Result<Option<Check>> {
    let file = path.display().to_string();
    if oracle::is_superpoint_file(path)? {
        let motion = oracle::superpoint_difference(&oracle::load_superpoint(path)?)?;
        return Ok(Some(Check { file, image: None, gradients: None, motion: Some(motion) }));
    }
    if !oracle::is_image_file(path)? {
        return Ok(None);
    }
    let case = oracle::load(path)?;
    let reference = oracle::reference_difference(&case)?;
    let (scene, camera, background, near) = oracle::as_scene(&case);
    let options = RenderOptions { background, near, ..RenderOptions::default() };
    let image = Renderer::new(gpu, &scene, &options)?.render(&camera, 0.0)?;
    let rgb = image.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from);
    let difference = difference(case.image.iter().copied(), rgb);
    let gradients = oracle::gradient_errors(gpu, &case)?;
    let image = Some(ImageCheck { reference, gpu: difference });
    Ok(Some(Check { file, image, gradients, motion: None }))
}
