//! Fine-tuning of a student, and what it changed.

use std::time::Instant;

use engine::data::dataset::{self, DatasetOptions, View};
use engine::data::pixels::Pixels;
use engine::distill::{self, Displacement, Distilled, Lessons, TuneOptions};
use engine::error::{Error, Result};
use engine::gpu::Gpu;
use engine::render::{RenderOptions, Renderer};
use engine::scene::{Camera, Scene};
use serde::Serialize;

use super::compare;
use super::photos::Held;
use super::session::{Taught, step};
use crate::cli::args::{DistillArgs, TuneOn};
use crate::cli::interrupt::Interrupt;
use crate::cli::progress;

/// What fine-tuning did.
#[derive(Debug, Serialize)]
pub struct Tuning {
    /// Steps.
    pub iterations: u64,
    /// What they looked at.
    pub on: TuneOn,
    /// Of all that is random.
    pub seed: u64,
    /// Photos, and images of the teacher.
    pub images: [usize; 2],
    /// Mean loss of the first and of the last tenth of the steps.
    pub loss: [f64; 2],
    /// How far the student is from its teacher afterwards.
    pub displacement: Displacement,
    /// Whether that is within the bound.
    pub within_bound: bool,
    /// PSNR against the teacher before and after, dB; `null` where all is equal, or nothing was compared.
    pub teacher_psnr: [Option<f64>; 2],
    /// PSNR against held-out photos before and after, dB.
    pub photo_psnr: Option<[f64; 2]>,
    /// SSIM of those.
    pub photo_ssim: Option<[f64; 2]>,
    /// How long it took.
    pub seconds: f64,
}

impl Tuning {
    /// For people.
    pub(super) fn lines(&self) -> Vec<String> {
        let [photos, drawn] = self.images;
        let [from, to] = self.teacher_psnr.map(|v| v.map_or("-".into(), |v| format!("{v:.2}")));
        let against = self.photo_psnr.map_or_else(String::new, |[a, b]| format!(", photos {a:.2} → {b:.2} dB"));
        let [first, last] = self.loss;
        vec![
            format!(
                "tuned   {} steps on {photos} photos and {drawn} images of the teacher, {:.1} s: loss {first:.5} → {last:.5}",
                self.iterations, self.seconds
            ),
            format!("        PSNR against the teacher {from} → {to} dB{against}"),
            format!("        {}", self.verdict()),
        ]
    }

    /// Whether the bound still holds.
    pub(super) fn verdict(&self) -> String {
        let d = &self.displacement;
        let said = if self.within_bound {
            format!("still within the bound of {} px", d.bound_px)
        } else {
            format!(
                "the bound of {} px does not hold: {} Gaussians are above it; images are followed, not places",
                d.bound_px, d.above
            )
        };
        format!("after fine-tuning the largest displacement is {:.4} px, {said}", d.error_px.largest)
    }
}

/// The scenes and views of a session.
pub(super) struct Task<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) taught: &'a Taught<'a>,
    pub(super) held: Option<&'a Held>,
    /// In which images of teacher and student are compared.
    pub(super) compared: &'a [Camera],
    pub(super) interrupt: &'a Interrupt,
    pub(super) quiet: bool,
}

impl Task<'_> {
    /// Trains the student for `iterations` steps.
    ///
    /// # Errors
    /// Those of [`distill::tune`]; `Usage` for photos that there are none of.
    pub(super) fn tune(&self, args: &DistillArgs, fitted: &Distilled, iterations: u64) -> Result<(Scene, Tuning)> {
        let begin = Instant::now();
        let photos = photos(args)?;
        let on = chosen(args, &photos)?;
        let cameras = if on == TuneOn::Photos { Vec::new() } else { self.cameras(&photos) };
        let photos = if on == TuneOn::Teacher { Vec::new() } else { photos };
        let Taught { moments, views, options, .. } = self.taught;
        let mut renderer = Renderer::new(self.gpu, moments.scene(), options)?;
        let mut draw = |camera: &Camera| Ok(Pixels::opaque(&renderer.render(camera, camera.time)?));
        let lessons = Lessons {
            photos,
            cameras,
            times: moments.scene().time_range(),
            draw: &mut draw,
            exposures: None,
            transients: None,
        };
        let (background, near) = (options.background, options.near);
        let how = TuneOptions { iterations, seed: args.seed, background, near, rate_px: None, deterministic: true };
        let bar = progress::training(iterations, 0, self.quiet);
        let tuned = distill::tune(self.gpu, &fitted.scene, views, lessons, &how, &mut |done| {
            let text = format!("fine-tuning: loss {:.4}, PSNR {:.2} dB", done.loss, done.psnr);
            step(&bar, self.interrupt, text, done.iteration as usize);
        })?;
        bar.finish_and_clear();
        let seconds = begin.elapsed().as_secs_f64();
        let displacement = fitted.yardstick.measure(&tuned.scene, views)?;
        let [before, after] = [&fitted.scene, &tuned.scene].map(|scene| self.scores(scene));
        let ((a, before), (b, after)) = (before?, after?);
        let pair = |k: usize| Some([before?[k], after?[k]]);
        let tuning = Tuning {
            iterations,
            on,
            seed: args.seed,
            images: tuned.images,
            loss: tuned.loss,
            within_bound: displacement.is_within(),
            displacement,
            teacher_psnr: [a, b],
            photo_psnr: pair(0),
            photo_ssim: pair(1),
            seconds,
        };
        Ok((tuned.scene, tuning))
    }

    /// Against the teacher (PSNR), and against photos (PSNR, SSIM).
    fn scores(&self, student: &Scene) -> Result<(Option<f64>, Option<[f64; 2]>)> {
        let Taught { moments, options, .. } = self.taught;
        let teacher = compare::psnr(self.gpu, moments, student, self.compared, options)?;
        let auto = RenderOptions { motion: engine::scene::MotionSource::Auto, ..options.clone() };
        let photos = self.held.map(|held| held.score(self.gpu, student, &auto, &mut |_| {})).transpose()?;
        Ok((teacher, photos))
    }

    /// Those of the photos, or of the views around the scene at half their size.
    fn cameras(&self, photos: &[View]) -> Vec<Camera> {
        if photos.is_empty() {
            let half = |c: &Camera| c.resized(c.width.div_ceil(2), c.height.div_ceil(2));
            return self.taught.views.cameras.iter().map(half).collect();
        }
        photos.iter().map(|v| v.camera.clone()).collect()
    }
}

/// Photos to train on; none where `--data` are cameras alone.
fn photos(args: &DistillArgs) -> Result<Vec<View>> {
    let Some(data) = &args.data else { return Ok(Vec::new()) };
    let options = DatasetOptions { downscale: args.downscale, ..DatasetOptions::default() };
    match dataset::load(data, &options) {
        Ok(data) => Ok(data.train),
        Err(error) if matches!(args.on, Some(TuneOn::Photos | TuneOn::Both)) => Err(error),
        Err(_) => Ok(Vec::new()),
    }
}

fn chosen(args: &DistillArgs, photos: &[View]) -> Result<TuneOn> {
    let usual = if photos.is_empty() { TuneOn::Teacher } else { TuneOn::Both };
    match args.on.unwrap_or(usual) {
        TuneOn::Photos | TuneOn::Both if photos.is_empty() => {
            Err(Error::usage("--on", "no photos to train on", "--data with photos, or --on teacher"))
        }
        on => Ok(on),
    }
}
