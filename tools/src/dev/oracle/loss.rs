//! `oracle/loss_*.npz`: the image loss of the f64 reference and of the device against float64 automatic differentiation.
//!
//! Arrays: `image` and `target` `[H,W,3]`, the scalars `l1`, `ssim` and `loss` = 0.8·L1 + 0.2·(1 − SSIM), and `grad_image`
//! `[H,W,3]`, the gradient of `loss` by the image.

use std::fs::File;
use std::path::Path;

use engine::gpu::{Buffer, Gpu, Memory};
use engine::reference::gradient::loss::image_loss;
use engine::render::frame::Frame;
use engine::train::image_loss::{LOSS_WORDS, LossPass, LossPassBuffers, TargetFormat};
use engine::train::status;
use engine::train::step::Step;
use engine::{Error, Result};
use serde::Serialize;
use zip::ZipArchive;

use crate::dev::oracle::case::relative_l2;

/// Largest relative error of the device.
pub const GPU_ERROR: f64 = 1e-4;
/// Largest relative error of the f64 reference.
pub const REFERENCE_ERROR: f64 = 1e-9;
/// Weight of D-SSIM in the files.
const LAMBDA: f64 = 0.2;
/// An image edge beyond this is taken for damage.
const MAX_EDGE: u64 = 16_384;

/// ‖test − truth‖ / ‖truth‖ of each kind of result.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LossErrors {
    /// L1 and SSIM.
    pub outputs: f64,
    /// The loss.
    pub losses: f64,
    /// Gradient by the image.
    pub gradients: f64,
}

/// What was found for one file.
#[derive(Debug, Clone, Serialize)]
pub struct LossCheck {
    /// The file.
    pub file: String,
    /// The f64 reference.
    pub reference: LossErrors,
    /// The device, if one was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu: Option<LossErrors>,
}

impl LossErrors {
    fn within(&self, bound: f64) -> bool {
        [self.outputs, self.losses, self.gradients].iter().all(|e| *e <= bound)
    }
}

impl LossCheck {
    /// Whether everything is within its bound.
    pub fn passes(&self) -> bool {
        self.reference.within(REFERENCE_ERROR) && self.gpu.is_none_or(|g| g.within(GPU_ERROR))
    }

    /// One line for the terminal.
    pub fn describe(&self) -> String {
        let line =
            |e: &LossErrors| format!("outputs {:.2e}, loss {:.2e}, gradient {:.2e}", e.outputs, e.losses, e.gradients);
        let gpu = self.gpu.as_ref().map_or(String::new(), |g| format!("; gpu {}", line(g)));
        let verdict = if self.passes() { "ok" } else { "TOO FAR" };
        format!("{}: relative errors: reference {}{gpu} ({verdict})", self.file, line(&self.reference))
    }
}

/// One file.
struct LossCase {
    /// Height, width.
    size: [usize; 2],
    image: Vec<f64>,
    target: Vec<f64>,
    l1: f64,
    ssim: f64,
    loss: f64,
    gradient: Vec<f64>,
}

/// Whether the file holds an image loss.
pub fn is_loss_file(path: &Path) -> Result<bool> {
    let archive = open(path)?;
    Ok(["grad_image.npy", "target.npy"].iter().all(|name| archive.index_for_name(name).is_some()))
}

/// Checks one file. `gpu` `None`: the f64 reference only.
pub fn check(path: &Path, gpu: Option<&Gpu>) -> Result<LossCheck> {
    let case = load(path)?;
    let truth = image_loss(&case.image, &case.target, [case.size[1], case.size[0]], LAMBDA);
    let reference = case.errors(&[truth.l1, truth.ssim], truth.loss, &truth.gradient);
    let gpu = gpu.map(|gpu| on_device(gpu, &case)).transpose()?;
    Ok(LossCheck { file: path.display().to_string(), reference, gpu })
}

impl LossCase {
    fn errors(&self, outputs: &[f64], loss: f64, gradient: &[f64]) -> LossErrors {
        LossErrors {
            outputs: relative_l2(&[self.l1, self.ssim], outputs),
            losses: relative_l2(&[self.loss], &[loss]),
            gradients: relative_l2(&self.gradient, gradient),
        }
    }
}

fn on_device(gpu: &Gpu, case: &LossCase) -> Result<LossErrors> {
    let [height, width] = case.size.map(|s| s as u32);
    let four = |values: &[f64]| -> Vec<f32> {
        values.chunks_exact(3).flat_map(|p| [p[0] as f32, p[1] as f32, p[2] as f32, 0.0]).collect()
    };
    let frame = Frame { size: [width, height], ..Frame::default() };
    let step = Step { weight_dssim: LAMBDA as f32, ..Step::default() };
    let upload = |name: &str, bytes: &[u8]| gpu.buffer_with(name, bytes);
    let frame = upload("frame", bytemuck::bytes_of(&frame))?;
    let step = upload("step", bytemuck::bytes_of(&step))?;
    let color = upload("color", bytemuck::cast_slice(&four(&case.image)))?;
    let target = upload("target", bytemuck::cast_slice(&four(&case.target)))?;
    let status = upload("status", bytemuck::cast_slice(&status::clear()))?;
    let image_gradient = gpu.buffer("image_gradient", color.bytes(), Memory::Device)?;
    let loss = gpu.buffer("loss", 4 * LOSS_WORDS as u64, Memory::Device)?;
    let image_loss = LossPass::new(gpu, width, height, true)?;
    let buffers = LossPassBuffers {
        frame: &frame,
        step: &step,
        color: &color,
        target: &target,
        image_gradient: &image_gradient,
        loss: &loss,
        status: &status,
    };
    let mut recorder = gpu.recorder("image loss");
    image_loss.record(&mut recorder, &buffers, TargetFormat::Float)?;
    gpu.run(recorder)?;
    let floats = |buffer: &Buffer| -> Result<Vec<f64>> {
        let bytes = gpu.download(buffer)?;
        Ok(bytemuck::pod_collect_to_vec::<u8, f32>(&bytes).into_iter().map(f64::from).collect())
    };
    let [loss, l1, ssim] = {
        let all = floats(&loss)?;
        [all[0], all[1], all[2]]
    };
    let gradient = floats(&image_gradient)?;
    let rgb: Vec<f64> = gradient.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    Ok(case.errors(&[l1, ssim], loss, &rgb[..case.gradient.len().min(rgb.len())]))
}

fn open(path: &Path) -> Result<ZipArchive<File>> {
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    ZipArchive::new(file).map_err(|e| Error::corrupt(path, "zip directory", e.to_string(), "an .npz file"))
}

fn load(path: &Path) -> Result<LossCase> {
    let mut archive = open(path)?;
    let (image, shape) = floats(&mut archive, path, "image")?;
    let &[height, width, 3] = shape.as_slice() else {
        return Err(Error::corrupt(path, "image", format!("shape {shape:?}"), "[H, W, 3]"));
    };
    if !(1..=MAX_EDGE).contains(&height) || !(1..=MAX_EDGE).contains(&width) {
        return Err(Error::corrupt(path, "image", format!("shape {shape:?}"), "edges of 1 to 16384"));
    }
    let mut same_shape = |name: &str| {
        let (values, found) = floats(&mut archive, path, name)?;
        if found == shape {
            return Ok(values);
        }
        Err(Error::corrupt(path, name, format!("shape {found:?}"), format!("{shape:?}")))
    };
    let (target, gradient) = (same_shape("target")?, same_shape("grad_image")?);
    let mut scalar = |name: &str| match floats(&mut archive, path, name)?.0.as_slice() {
        &[value] => Ok(value),
        other => Err(Error::corrupt(path, name, format!("{} values", other.len()), "one")),
    };
    let [l1, ssim, loss] = [scalar("l1")?, scalar("ssim")?, scalar("loss")?];
    Ok(LossCase { size: [height as usize, width as usize], image, target, l1, ssim, loss, gradient })
}

/// A float64 array in C order, and its shape.
fn floats(archive: &mut ZipArchive<File>, path: &Path, name: &str) -> Result<(Vec<f64>, Vec<u64>)> {
    let broken = |e: std::io::Error| Error::corrupt(path, name, e.to_string(), "a float64 array");
    let entry = archive.by_name(&format!("{name}.npy")).map_err(|e| broken(e.into()))?;
    let npy = npyz::NpyFile::new(entry).map_err(broken)?;
    let shape = npy.shape().to_vec();
    if npy.order() != npyz::Order::C || shape.iter().any(|s| *s > MAX_EDGE) {
        return Err(Error::corrupt(path, name, format!("shape {shape:?}, {:?} order", npy.order()), "C order"));
    }
    Ok((npy.into_vec().map_err(broken)?, shape))
}
