//! Images of teacher and student beside each other, and how long they take.

use std::time::Instant;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::image::Image;
use engine::metrics::psnr::psnr_8bit;
use engine::render::{RenderOptions, Renderer};
use engine::scene::{Camera, MotionSource, Scene};
use serde::Serialize;

use crate::command::convert::moment::Moments;
use crate::report::measure::Quantiles;

/// PSNR of equal images, dB.
const EQUAL: f64 = 300.0;
/// Timed frames after as many that are not: on a GPU, and on a CPU.
const TIMED: [usize; 2] = [200, 5];

/// Images of both.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    /// One for each view.
    pub views: Vec<View>,
    /// Width and height of the first view.
    pub size: [u32; 2],
    /// PSNR of the mean squared error of all views, dB; `null` where all are equal.
    pub psnr: Option<f64>,
    /// The lowest of a view, dB.
    pub worst: Option<f64>,
    /// Median time of a frame, one at a time, of the teacher and of the student, ms.
    pub frame_ms: [f64; 2],
}

/// A view of both.
#[derive(Debug, Clone, Serialize)]
pub struct View {
    /// Its name.
    pub name: String,
    /// Its time.
    pub time: f64,
    /// Student against teacher, 8-bit values, dB; `null` where they are equal.
    pub psnr: Option<f64>,
}

/// Images for the page.
#[derive(Debug)]
pub(super) struct Shown {
    pub(super) caption: String,
    pub(super) teacher: Image,
    pub(super) student: Image,
}

impl Comparison {
    /// Frames per second of the teacher and of the student.
    pub fn fps(&self) -> [f64; 2] {
        self.frame_ms.map(|ms| 1e3 / ms)
    }

    /// For people.
    pub(super) fn line(&self) -> String {
        let decibels = |v: Option<f64>| v.map_or("equal".into(), |v| format!("{v:.2} dB"));
        let ([w, h], [t, s], [tf, sf]) = (self.size, self.frame_ms, self.fps());
        format!(
            "PSNR {} (worst view {}) over {} views of {w}x{h}, student against teacher; {t:.2} ms ({tf:.1} FPS) → {s:.2} ms ({sf:.1} FPS)",
            decibels(self.psnr),
            decibels(self.worst),
            self.views.len()
        )
    }
}

/// Draws both from all cameras; keeps the images of the worst, the median and the best.
pub(super) fn compare(
    gpu: &Gpu,
    teacher: &Moments<'_>,
    student: &Scene,
    cameras: &[Camera],
    options: &RenderOptions,
    shown: &mut Vec<Shown>,
    tick: &mut dyn FnMut(usize),
) -> Result<Option<Comparison>> {
    let Some(first) = cameras.first() else { return Ok(None) };
    let mut one = Renderer::new(gpu, teacher.scene(), &RenderOptions { motion: teacher.source(), ..options.clone() })?;
    let mut two = Renderer::new(gpu, student, &RenderOptions { motion: MotionSource::Auto, ..options.clone() })?;
    let views = seen([&mut one, &mut two], cameras, tick)?;
    let mut order: Vec<usize> = (0..views.len()).collect();
    let value = |k: usize| views[k].psnr.unwrap_or(f64::INFINITY);
    order.sort_by(|&a, &b| value(a).total_cmp(&value(b)));
    let mut picks = vec![("worst", 0), ("median", order.len() / 2), ("best", order.len() - 1)];
    picks.dedup_by_key(|(_, at)| *at);
    for (what, at) in picks {
        let (camera, view) = (&cameras[order[at]], &views[order[at]]);
        let psnr = view.psnr.map_or("equal".into(), |p| format!("PSNR {p:.2} dB"));
        shown.push(Shown {
            caption: format!("{what}: {}, t = {:.4}, {psnr}", view.name, view.time),
            teacher: one.render(camera, camera.time)?,
            student: two.render(camera, camera.time)?,
        });
    }
    let timed = TIMED[usize::from(gpu.info().is_cpu())];
    let frame_ms = [frame_ms(&mut one, cameras, timed, tick)?, frame_ms(&mut two, cameras, timed, tick)?];
    Ok(Some(Comparison {
        psnr: total(&views),
        worst: views.iter().filter_map(|v| v.psnr).reduce(f64::min),
        size: [first.width, first.height],
        views,
        frame_ms,
    }))
}

/// PSNR of the student against the teacher over all cameras, dB; `None` where all is equal or there are no cameras.
pub(super) fn psnr(
    gpu: &Gpu,
    teacher: &Moments<'_>,
    student: &Scene,
    cameras: &[Camera],
    options: &RenderOptions,
) -> Result<Option<f64>> {
    if cameras.is_empty() {
        return Ok(None);
    }
    let mut one = Renderer::new(gpu, teacher.scene(), &RenderOptions { motion: teacher.source(), ..options.clone() })?;
    let mut two = Renderer::new(gpu, student, &RenderOptions { motion: MotionSource::Auto, ..options.clone() })?;
    Ok(total(&seen([&mut one, &mut two], cameras, &mut |_| {})?))
}

/// Every view, drawn by both.
fn seen([one, two]: [&mut Renderer; 2], cameras: &[Camera], tick: &mut dyn FnMut(usize)) -> Result<Vec<View>> {
    let view = |(k, camera): (usize, &Camera)| {
        tick(k);
        let psnr = psnr_8bit(&one.render(camera, camera.time)?, &two.render(camera, camera.time)?)?;
        Ok(View { name: camera.name.clone(), time: camera.time, psnr: (psnr < EQUAL).then_some(psnr) })
    };
    cameras.iter().enumerate().map(view).collect()
}

/// PSNR of the mean squared error of all.
fn total(views: &[View]) -> Option<f64> {
    let mean = views.iter().map(|v| v.psnr.map_or(0.0, |p| 10f64.powf(-p / 10.0))).sum::<f64>() / views.len() as f64;
    (mean > 0.0).then(|| -10.0 * mean.log10())
}

/// Median time of a frame, without the copy of the image to the host, ms.
fn frame_ms(renderer: &mut Renderer, cameras: &[Camera], count: usize, tick: &mut dyn FnMut(usize)) -> Result<f64> {
    let mut times = Vec::with_capacity(count);
    for k in 0..2 * count {
        tick(cameras.len());
        let camera = &cameras[k % count % cameras.len()];
        let begin = Instant::now();
        renderer.draw(camera, camera.time)?;
        if k >= count {
            times.push(begin.elapsed().as_secs_f64() * 1e3);
        }
    }
    Ok(Quantiles::of(times).median)
}
