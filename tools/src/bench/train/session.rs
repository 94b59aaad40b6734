//! A real training run on a data set, timed: how many iterations per second, and how long until a PSNR is reached on held-out
//! views. Evaluation does not count as training time.

use std::path::Path;
use std::time::Instant;

use engine::data::dataset::{self, Dataset, DatasetOptions};
use engine::data::loader::ImageLoader;
use engine::error::Result;
use engine::gpu::Gpu;
use engine::render::RenderOptions;
use engine::scene::{MotionSource, Scene};
use engine::train::config::Config;
use engine::train::evaluate;
use engine::train::start;
use engine::train::trainer::{StepReport, Trainer, TrainingData};
use serde::Serialize;

use crate::report::benchmark::Benchmark;
use crate::report::measure::Quantiles;

/// Most held-out views that are evaluated.
const VIEWS: usize = 20;
/// Evaluations of a run, at most.
const EVALUATIONS: u64 = 40;

/// A data set and what is needed to train on it again and again.
pub(crate) struct Session<'a> {
    gpu: &'a Gpu,
    data: Dataset,
    training: TrainingData,
    held_out: ImageLoader,
    /// Which held-out views are evaluated.
    views: Vec<usize>,
}

/// What ends a run before its last iteration.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Until {
    /// So many dB on the held-out views.
    pub(crate) psnr: Option<f64>,
    /// This time of the clock; what is there then is evaluated.
    pub(crate) end: Option<Instant>,
}

/// State of a run at an evaluation.
#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) struct Milestone {
    /// Iterations done.
    pub(crate) iteration: u64,
    /// Training time so far, seconds.
    pub(crate) seconds: f64,
    /// Mean over the held-out views, dB.
    pub(crate) psnr: f64,
    /// Mean over the held-out views.
    pub(crate) ssim: f64,
    /// N.
    pub(crate) gaussians: u32,
}

/// A timed run.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Timed {
    /// Evaluations, the last one at the end.
    pub(crate) milestones: Vec<Milestone>,
    /// Time from step to step with several in flight, density control included, milliseconds.
    pub(crate) step_ms: Quantiles,
    /// Training time, seconds.
    pub(crate) seconds: f64,
    /// Iterations per second.
    pub(crate) iterations_per_second: f64,
    /// M; 0 when nothing moves.
    pub(crate) superpoints: u32,
    /// The last step.
    #[serde(skip)]
    pub(crate) last_step: Option<StepReport>,
    /// Training time at which the asked-for PSNR was reached, between two evaluations by interpolation.
    pub(crate) seconds_to_psnr: Option<f64>,
}

impl Timed {
    /// The last evaluation.
    pub(crate) fn last(&self) -> Option<&Milestone> {
        self.milestones.last()
    }
}

impl<'a> Session<'a> {
    /// Loads a data set.
    ///
    /// # Errors
    /// Those of the data set.
    pub(crate) fn new(gpu: &'a Gpu, path: &Path, downscale: Option<u32>) -> Result<Self> {
        let data = dataset::load(path, &DatasetOptions { downscale, ..DatasetOptions::default() })?;
        let training =
            TrainingData { views: data.train.clone().into(), extent: data.extent, is_static: data.is_static };
        let held_out = if data.test.is_empty() { data.train.clone() } else { data.test.clone() };
        let step = held_out.len().div_ceil(VIEWS).max(1);
        let views = (0..held_out.len()).step_by(step).collect();
        let held_out = ImageLoader::new(held_out.into(), Config::default().budget.image_bytes, 1)?;
        Ok(Self { gpu, data, training, held_out, views })
    }

    /// The paper's settings for this kind of data, for a run of `iterations`.
    pub(crate) fn config(&self, iterations: u64) -> Config {
        let mut config = Config { iterations, ..Benchmark::preset_of_format(self.data.kind).config() };
        config.log.evaluate_interval = 0;
        config
    }

    /// What is trained and evaluated, in words.
    pub(crate) fn describe(&self) -> String {
        let camera = self.training.views.first().map(|v| [v.camera.width, v.camera.height]).unwrap_or_default();
        let split = if self.data.test.is_empty() { "training" } else { "test" };
        format!(
            "{} training views of {}×{} pixels; {} of {} {split} views evaluated",
            self.training.views.len(),
            camera[0],
            camera[1],
            self.views.len(),
            self.held_out.views().len()
        )
    }

    /// The cameras of the training views, with their times.
    pub(crate) fn cameras(&self) -> Vec<engine::scene::Camera> {
        let timed = |v: &dataset::View| engine::scene::Camera { time: v.time, ..v.camera.clone() };
        self.training.views.iter().map(timed).collect()
    }

    /// Trains to the end of `config` or until `until`; evaluates `evaluations` times, and at the end.
    ///
    /// # Errors
    /// Those of training.
    pub(crate) fn run(
        &self,
        config: &Config,
        until: Until,
        evaluations: u64,
        tick: &dyn Fn(),
    ) -> Result<(Timed, Trainer)> {
        let (first, _) = start::first(config, self.data.points.as_ref());
        let mut trainer = Trainer::new(self.gpu, config, &self.training, &first)?;
        let every = config.iterations.div_ceil(evaluations.clamp(1, EVALUATIONS)).max(1);
        let (mut seconds, mut step_ms) = (0.0, Vec::new());
        let mut milestones: Vec<Milestone> = Vec::new();
        let (mut superpoints, mut last_step) = (0, None);
        while !trainer.is_done() {
            let start = Instant::now();
            trainer.advance()?;
            let is_late = until.end.is_some_and(|end| Instant::now() >= end);
            let evaluates = trainer.iteration().is_multiple_of(every) || trainer.is_done() || is_late;
            if evaluates {
                trainer.drain()?;
            }
            let taken = start.elapsed().as_secs_f64();
            seconds += taken;
            step_ms.push(1e3 * taken);
            while let Some(done) = trainer.take_finished() {
                (superpoints, last_step) = (done.report.superpoints, Some(done.report));
            }
            tick();
            if evaluates {
                let times = self.views.iter().map(|&i| self.held_out.views()[i].time);
                let [psnr, ssim] = self.score(&trainer.scene_at(times)?, config, MotionSource::Auto)?;
                let (iteration, gaussians) = (trainer.iteration(), trainer.gaussians());
                milestones.push(Milestone { iteration, seconds, psnr, ssim, gaussians });
                if is_late || until.psnr.is_some_and(|wanted| psnr >= wanted) {
                    break;
                }
            }
        }
        let steps = step_ms.len() as f64;
        let timed = Timed {
            seconds_to_psnr: until.psnr.and_then(|wanted| reached(&milestones, wanted)),
            milestones,
            step_ms: Quantiles::of(step_ms),
            seconds,
            iterations_per_second: steps / seconds.max(1e-9),
            superpoints,
            last_step,
        };
        Ok((timed, trainer))
    }

    /// Mean PSNR and SSIM of a scene over the held-out views.
    ///
    /// # Errors
    /// Those of rendering and decoding.
    pub(crate) fn score(&self, scene: &Scene, config: &Config, motion: MotionSource) -> Result<[f64; 2]> {
        let options =
            RenderOptions { background: config.background, near: config.near, motion, ..RenderOptions::default() };
        let scores = evaluate::evaluate(self.gpu, scene, &self.held_out, &self.views, &options, |_, _, _| Ok(()))?;
        Ok(evaluate::mean(&scores))
    }

    /// What is trained on.
    pub(crate) fn training(&self) -> &TrainingData {
        &self.training
    }

    /// The device.
    pub(crate) fn gpu(&self) -> &Gpu {
        self.gpu
    }

    /// The first held-out camera and its time, for timing play-back.
    pub(crate) fn first_view(&self) -> Option<(engine::scene::Camera, f64)> {
        self.views.first().map(|&i| (self.held_out.views()[i].camera.clone(), self.held_out.views()[i].time))
    }
}

/// When `wanted` dB were reached: linear between the last evaluation below and the first one at or above.
fn reached(milestones: &[Milestone], wanted: f64) -> Option<f64> {
    let at = milestones.iter().position(|m| m.psnr >= wanted)?;
    let above = milestones[at];
    let Some(below) = at.checked_sub(1).map(|i| milestones[i]) else { return Some(above.seconds) };
    let share = (wanted - below.psnr) / (above.psnr - below.psnr);
    Some(below.seconds + share * (above.seconds - below.seconds))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn the_time_to_a_psnr_is_interpolated() {
        let at = |seconds, psnr| Milestone { iteration: 1, seconds, psnr, ssim: 0.0, gaussians: 1 };
        let run = [at(10.0, 20.0), at(20.0, 24.0), at(30.0, 23.0), at(40.0, 30.0)];
        assert_eq!(reached(&run, 22.0), Some(15.0));
        assert_eq!(reached(&run, 24.0), Some(20.0));
        assert_eq!(reached(&run, 19.0), Some(10.0));
        assert_eq!(reached(&run, 26.5), Some(35.0));
        assert_eq!(reached(&run, 31.0), None);
    }
}
