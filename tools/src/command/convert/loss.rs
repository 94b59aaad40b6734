//! Renders before and after.

use engine::error::Result;
use engine::file::{self, Output};
use engine::gpu::Gpu;
use engine::image::Image;
use engine::metrics::psnr::psnr_8bit;
use engine::render::{RenderOptions, Renderer};
use engine::scene::{MotionSource, Scene};
use serde::Serialize;

use super::moment::Moments;
use super::targets::Written;
use super::views;
use crate::cli::gpu_session;

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
    /// How many of them show something, before or after.
    pub visible: usize,
    /// Whether files were compared with the model at rest, because they do not hold its motion.
    pub at_rest: bool,
    /// PSNR of the mean squared error of the views that show something, dB; `null` where all are equal.
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
    /// Whether anything is drawn, before or after.
    pub is_visible: bool,
}

impl Loss {
    /// For people.
    pub fn line(&self) -> String {
        let decibels = |v: Option<f64>| v.map_or("equal".into(), |v| format!("{v:.2} dB"));
        let (all, [w, h]) = (self.views.len(), self.size);
        let mut line = if self.visible == 0 {
            format!("loss: not measured: nothing was visible in the {all} views of {w}x{h}")
        } else {
            format!(
                "loss: PSNR {} (worst view {}) over {} views of {w}x{h}, before against after",
                decibels(self.psnr),
                decibels(self.worst),
                self.visible
            )
        };
        if (1..all).contains(&self.visible) {
            line += &format!("; nothing was visible in {} more", all - self.visible);
        }
        if self.at_rest {
            line +=
                "; both at rest: the file holds the model at rest, without its motion (--time T: as it is at a time)";
        }
        line
    }
}

/// Renders `count` views of each measured file and of the model that it was made from. Without a device nothing is measured.
pub(super) fn measure(
    before: &Moments<'_>,
    kind: Output,
    outputs: &[Written],
    count: u32,
    gpu: Option<&Gpu>,
) -> Result<Option<Loss>> {
    let Some(gpu) = gpu.filter(|_| count > 0 && !before.scene().gaussians.is_empty()) else { return Ok(None) };
    let mut views = Vec::new();
    let last = outputs.len().saturating_sub(1);
    let mut measured: Vec<usize> = (0..FILES).map(|i| i * last / (FILES - 1)).collect();
    measured.dedup();
    for index in measured {
        of_file(gpu, before, kind, (index, &outputs[index]), count, &mut views)?;
    }
    gpu_session::report_validation(gpu);
    let visible = || views.iter().filter(|v| v.is_visible);
    let errors = visible().map(|v| v.psnr.map_or(0.0, |p| 10f64.powf(-p / 10.0)));
    let mean = errors.sum::<f64>() / visible().count().max(1) as f64;
    let psnr = (mean > 0.0).then(|| -10.0 * mean.log10());
    let worst = visible().filter_map(|v| v.psnr).reduce(f64::min);
    let visible = visible().count();
    let at_rest = before.scene().is_dynamic() && outputs.iter().any(|o| is_at_rest(o, kind));
    Ok(Some(Loss { views, visible, at_rest, psnr, worst, size: SIZE }))
}

/// A format without motion holds the scene at rest, and is compared with it.
fn is_at_rest(written: &Written, kind: Output) -> bool {
    written.time.is_none() && !kind.holds_motion()
}

fn of_file(
    gpu: &Gpu,
    before: &Moments<'_>,
    kind: Output,
    (index, written): (usize, &Written),
    count: u32,
    views: &mut Vec<ViewLoss>,
) -> Result<()> {
    let after = file::load(&written.file)?.scene;
    let resting =
        is_at_rest(written, kind).then(|| Scene { gaussians: before.scene().gaussians.clone(), ..Scene::default() });
    let resting = resting.as_ref().map(|scene| Moments::new(scene, MotionSource::Auto, None)).transpose()?;
    let shown = resting.as_ref().unwrap_or(before);
    let views::Around { cameras, near } = views::around(shown, SIZE, count as usize, written.time)?;
    let options = |motion| RenderOptions { motion, near, ..RenderOptions::default() };
    let mut one = Renderer::new(gpu, shown.scene(), &options(shown.source()))?;
    let first: Vec<_> = cameras.iter().map(|c| one.render(c, c.time)).collect::<Result<_>>()?;
    drop(one);
    // The same motion where the file has it, too.
    let source = after.deformation.motion_source(shown.source()).map_or(MotionSource::Auto, |_| shown.source());
    let mut two = Renderer::new(gpu, &after, &options(source))?;
    for (camera, first) in cameras.iter().zip(&first) {
        let second = two.render(camera, camera.time)?;
        let psnr = psnr_8bit(first, &second)?;
        let is_visible = shows_something(first) || shows_something(&second);
        views.push(ViewLoss { file: index, time: camera.time, psnr: (psnr < EQUAL).then_some(psnr), is_visible });
    }
    Ok(())
}

/// Whether anything is drawn.
fn shows_something(image: &Image) -> bool {
    image.rgba.chunks_exact(4).any(|pixel| pixel[3] > 0.0)
}
