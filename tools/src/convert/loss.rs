//! Renders before and after.

use engine::error::{Error, Result};
use engine::file::{self, Output};
use engine::gpu::Gpu;
use engine::metrics::psnr::psnr_8bit;
use engine::render::{RenderOptions, Renderer};
use engine::scene::{MotionSource, Scene};
use serde::Serialize;

use super::{Written, cameras};
use crate::args::Global;
use crate::gpu_session;

/// Size of the views, pixels.
const SIZE: [u32; 2] = [400, 400];
/// Files of a sequence that are measured: the first, the last and one between.
const FILES: usize = 3;

/// PSNR of equal pictures, dB.
const EQUAL: f64 = 300.0;

/// How far renders of what was written are from renders of what was read.
#[derive(Debug, Serialize)]
pub struct Loss {
    /// One for each view, 8-bit values; `null` where the pictures are equal.
    pub views: Vec<ViewLoss>,
    /// PSNR of the mean squared error of all views, dB; `null` where all are equal.
    pub psnr: Option<f64>,
    /// The lowest of them, dB.
    pub worst: Option<f64>,
    /// Width and height of the views.
    pub size: [u32; 2],
}

/// Loss of a view.
#[derive(Debug, Serialize)]
pub struct ViewLoss {
    /// Index of the file.
    pub file: usize,
    /// Time of the view.
    pub time: f64,
    /// dB.
    pub psnr: Option<f64>,
}

impl Loss {
    /// For people.
    pub fn line(&self) -> String {
        let decibels = |v: Option<f64>| v.map_or("equal".into(), |v| format!("{v:.2} dB"));
        let [w, h] = self.size;
        format!(
            "loss: PSNR {} (worst view {}) over {} views of {w}x{h}, before against after",
            decibels(self.psnr),
            decibels(self.worst),
            self.views.len()
        )
    }
}

/// Renders `count` views of each measured file and of the model that it was made from. Without a device nothing is measured,
/// with a warning: the files are written.
pub(super) fn measure(
    before: &Scene,
    kind: Output,
    outputs: &[Written],
    source: MotionSource,
    count: u32,
    global: &Global,
) -> Result<Option<Loss>> {
    if count == 0 || before.gaussians.is_empty() {
        return Ok(None);
    }
    let gpu = match gpu_session::open(global) {
        Ok(gpu) => gpu,
        Err(error @ Error::NoDevice { .. }) => {
            log::warn!("the loss is not measured: {error}");
            return Ok(None);
        }
        Err(error) => return Err(error),
    };
    let mut views = Vec::new();
    let last = outputs.len().saturating_sub(1);
    let mut measured: Vec<usize> = (0..FILES).map(|i| i * last / (FILES - 1)).collect();
    measured.dedup();
    for index in measured {
        of_file(&gpu, before, kind, (index, &outputs[index]), source, count, &mut views)?;
    }
    gpu_session::report_validation(&gpu);
    let errors = views.iter().map(|v| v.psnr.map_or(0.0, |p| 10f64.powf(-p / 10.0)));
    let mean = errors.sum::<f64>() / views.len().max(1) as f64;
    let psnr = (mean > 0.0).then(|| -10.0 * mean.log10());
    let worst = views.iter().filter_map(|v| v.psnr).reduce(f64::min);
    Ok(Some(Loss { views, psnr, worst, size: SIZE }))
}

fn of_file(
    gpu: &Gpu,
    before: &Scene,
    kind: Output,
    (index, written): (usize, &Written),
    source: MotionSource,
    count: u32,
    views: &mut Vec<ViewLoss>,
) -> Result<()> {
    let after = file::load(&written.file)?.scene;
    // A format without motion holds the scene at rest, and is compared with it.
    let resting = Scene { gaussians: before.gaussians.clone(), ..Scene::default() };
    let is_still = written.time.is_none() && !kind.holds_motion();
    let (shown, source) = if is_still { (&resting, MotionSource::Auto) } else { (before, source) };
    let options = |motion| RenderOptions { motion, ..RenderOptions::default() };
    let mut one = Renderer::new(gpu, shown, &options(source))?;
    let cameras = cameras(shown, SIZE, count as usize, written.time);
    let first: Vec<_> = cameras.iter().map(|c| one.render(c, c.time)).collect::<Result<_>>()?;
    drop(one);
    let mut two = Renderer::new(gpu, &after, &options(MotionSource::Auto))?;
    for (camera, first) in cameras.iter().zip(&first) {
        let psnr = psnr_8bit(first, &two.render(camera, camera.time)?)?;
        views.push(ViewLoss { file: index, time: camera.time, psnr: (psnr < EQUAL).then_some(psnr) });
    }
    Ok(())
}
