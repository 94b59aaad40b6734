//! `spgs-dev oracle-check`: the f64 reference and the GPU against images, losses, motion and gradients of an independent
//! float64 implementation.

use std::collections::BTreeMap;
use std::path::Path;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::image::{Difference, difference};
use engine::render::{RenderOptions, Renderer};
use serde::Serialize;

use crate::dev::oracle::case::{self, GradientErrors};
use crate::dev::oracle::superpoint::ArrayError;
use crate::dev::oracle::{loss, superpoint};

/// Least PSNR of the f64 reference against the file, dB.
pub const REFERENCE_PSNR: f64 = 90.0;
/// Least PSNR of the GPU against the file, dB.
pub const GPU_PSNR: f64 = 65.0;
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

/// ‖test − truth‖ / ‖truth‖ of both implementations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RelL2 {
    /// Of the f64 reference.
    pub reference: f64,
    /// Of the device; absent where no kernel of its own computes it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu: Option<f64>,
}

/// One output, loss or gradient of a file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Item {
    /// Relative errors.
    pub rel_l2: RelL2,
    /// The file keeps the array in f32: rounding alone makes 3e-8.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub stored_as_f32: bool,
    /// For a sum that cancels: ‖truth‖ / ‖gradient of its layer's weights‖. The bounds hold for the errors times this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub share_of_layer: Option<f64>,
}

impl Item {
    fn new(reference: f64, gpu: Option<f64>) -> Self {
        Self { rel_l2: RelL2 { reference, gpu }, stored_as_f32: false, share_of_layer: None }
    }

    fn of_array(e: &ArrayError) -> Self {
        let plain = Self::new(e.reference, e.gpu);
        Self { stored_as_f32: e.stored_as_f32, share_of_layer: e.share_of_layer, ..plain }
    }
}

/// Items by name.
pub type Items = BTreeMap<String, Item>;

/// What was found for one file.
#[derive(Debug, Clone, Serialize)]
pub struct Check {
    /// The file.
    pub file: String,
    /// For a file with an image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<ImageCheck>,
    /// Results of the forward pass.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub outputs: Items,
    /// Losses.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub losses: Items,
    /// Gradients.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub gradients: Items,
    /// Whether everything is within its bound.
    pub passed: bool,
    /// For the terminal.
    #[serde(skip)]
    text: String,
}

impl Check {
    /// Whether everything is within its bound.
    pub fn passes(&self) -> bool {
        self.passed
    }

    /// For the terminal: a line, or one per kind of result.
    pub fn describe(&self) -> String {
        self.text.clone()
    }
}

/// Checks one file. `None`: it holds neither an image with its Gaussians nor superpoints nor an image loss.
///
/// # Errors
/// Those of reading the file and of the device.
pub fn check(gpu: &Gpu, path: &Path) -> Result<Option<Check>> {
    if case::is_superpoint_file(path)? {
        return superpoint_check(gpu, path).map(Some);
    }
    if loss::is_loss_file(path)? {
        return loss_check(gpu, path).map(Some);
    }
    if case::is_image_file(path)? { image_check(gpu, path).map(Some) } else { Ok(None) }
}

fn superpoint_check(gpu: &Gpu, path: &Path) -> Result<Check> {
    let found = superpoint::check(path, Some(gpu))?;
    let items = |m: &BTreeMap<String, ArrayError>| m.iter().map(|(k, e)| (k.clone(), Item::of_array(e))).collect();
    Ok(Check {
        outputs: items(&found.outputs),
        losses: items(&found.losses),
        gradients: items(&found.gradients),
        passed: found.passes(),
        text: found.describe(),
        file: found.file,
        image: None,
    })
}

fn loss_check(gpu: &Gpu, path: &Path) -> Result<Check> {
    let found = loss::check(path, Some(gpu))?;
    let item = |name: &str, of: fn(&loss::LossErrors) -> f64| {
        Items::from([(name.to_owned(), Item::new(of(&found.reference), found.gpu.as_ref().map(of)))])
    };
    Ok(Check {
        outputs: item("l1_and_ssim", |e| e.outputs),
        losses: item("loss", |e| e.losses),
        gradients: item("image", |e| e.gradients),
        passed: found.passes(),
        text: found.describe(),
        file: found.file,
        image: None,
    })
}

fn image_check(gpu: &Gpu, path: &Path) -> Result<Check> {
    let file = path.display().to_string();
    let case = case::load(path)?;
    let reference = case::reference_difference(&case)?;
    let (scene, camera, background, near) = case::as_scene(&case);
    let options = RenderOptions { background, near, ..RenderOptions::default() };
    let image = Renderer::new(gpu, &scene, &options)?.render(&camera, 0.0)?;
    let rgb = image.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from);
    let device = difference(case.image.iter().copied(), rgb);
    let errors = case::gradient_errors(gpu, &case)?;
    let rows = errors.iter().flat_map(GradientErrors::rows);
    let gradients: Items = rows.map(|(name, e)| (name.to_owned(), Item::new(e.reference, Some(e.gpu)))).collect();
    let near_enough =
        |e: &RelL2| e.reference <= REFERENCE_GRADIENT_ERROR && e.gpu.is_none_or(|gpu| gpu <= GPU_GRADIENT_ERROR);
    let passed = reference.psnr >= REFERENCE_PSNR
        && device.psnr >= GPU_PSNR
        && gradients.values().all(|item| near_enough(&item.rel_l2));
    let line = |d: &Difference| format!("PSNR {:.2} dB, max {:.3e}, q999 {:.3e}", d.psnr, d.max, d.q999);
    let mut text = format!("{file}: reference {}; gpu {}", line(&reference), line(&device));
    if !gradients.is_empty() {
        text += "; relative errors of gradients, reference and gpu:";
        for (name, item) in &gradients {
            text += &format!(" {name} {:.1e} {:.1e},", item.rel_l2.reference, item.rel_l2.gpu.unwrap_or(0.0));
        }
        text.pop();
    }
    text += if passed { " (ok)" } else { " (TOO FAR)" };
    let image = Some(ImageCheck { reference, gpu: device });
    Ok(Check { file, image, outputs: Items::new(), losses: Items::new(), gradients, passed, text })
}
