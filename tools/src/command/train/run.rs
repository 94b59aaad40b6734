//! A run from its first iteration to its last, or until it is interrupted.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use engine::data::dataset::Dataset;
use engine::data::loader::ImageLoader;
use engine::error::Result;
use engine::gpu::Gpu;
use engine::render::RenderOptions;
use engine::train::config::{Config, LogConfig};
use engine::train::evaluate;
use engine::train::schedule::Stage;
use engine::train::start;
use engine::train::trainer::{Finished, Trainer, TrainingData};
use engine::train::window_trial;
use indicatif::ProgressBar;
use serde_json::json;

use super::background::Background;
use super::log::SharedLog;
use crate::cli::interrupt::Interrupt;
use crate::cli::output;

/// A run in progress.
pub(super) struct Run<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) out: PathBuf,
    pub(super) data: &'a Dataset,
    pub(super) training: TrainingData,
    pub(super) held_out: ImageLoader,
    pub(super) trainer: Trainer,
    pub(super) log: SharedLog,
    pub(super) bar: ProgressBar,
    pub(super) quiet: bool,
    /// Exponential means over the last steps: loss, PSNR.
    pub(super) smooth: [f64; 2],
    pub(super) rate: Rate,
    pub(super) background: Background,
}

/// Iterations per second over the last stretch.
pub(super) struct Rate {
    pub(super) since: std::time::Instant,
    pub(super) iterations: u64,
    pub(super) per_second: f64,
}

impl Run<'_> {
    /// Runs to the end (true) or until interrupted (false); a viewer may watch, with the cameras of this data set.
    pub(super) fn iterate(&mut self, watch: Option<&Path>) -> Result<bool> {
        // The second Ctrl-C, and one after the last iteration, waits for nothing: every file is there whole or not at all.
        let interrupt = Interrupt::watch("Ctrl-C will not save a checkpoint");
        // A run that is cut off before its first interval is resumed from here.
        if self.trainer.iteration() == 0 && self.trainer.schedule().stage() != Stage::Nonrigid {
            self.save()?;
        }
        if let Some(data) = watch {
            self.background.join()?;
            open_viewer(&self.out, data);
        }
        while !self.trainer.is_done() {
            if self.trainer.tries_window() && !self.try_window(&interrupt)? {
                self.save()?;
                self.background.join()?;
                return Ok(false);
            }
            let mut went = self.trainer.advance();
            let stops = interrupt.is_set();
            // An evaluation and a checkpoint want the state of their iteration, no later one.
            if went.is_ok() && (stops || self.is_due(self.trainer.iteration())) {
                // No more than what one iteration wants is waited for.
                went = self.background.join().and_then(|()| self.trainer.drain());
            }
            while let Some(done) = self.trainer.take_finished() {
                self.after(&done)?;
            }
            went?;
            if stops && !self.trainer.is_done() {
                self.save()?;
                self.background.join()?;
                return Ok(false);
            }
        }
        interrupt.end_at_next(Some(self.interrupted()));
        self.background.join()?;
        Ok(true)
    }

    /// What is said of a run that is cut off.
    pub(super) fn interrupted(&self) -> String {
        let (at, folder) = (self.trainer.iteration(), self.out.join("checkpoints"));
        format!("spgs: interrupted; iteration {at} is saved in {}; go on with --resume", folder.display())
    }

    /// Whether an evaluation or a checkpoint follows an iteration.
    fn is_due(&self, iteration: u64) -> bool {
        let c = &self.trainer.config().log;
        let due = |interval| LogConfig::due(interval, iteration);
        let tries = self.trainer.tries_window();
        tries
            || due(c.evaluate_interval)
            || due(c.checkpoint_interval)
            || iteration >= self.trainer.schedule().iterations()
    }

    /// Log, progress, evaluation and checkpoint of a step.
    fn after(&mut self, done: &Finished) -> Result<()> {
        let c = self.trainer.config().log.clone();
        let step = &done.report;
        let (i, last) = (step.iteration, step.iteration >= self.trainer.schedule().iterations());
        for (mean, now) in self.smooth.iter_mut().zip([step.loss, step.psnr]) {
            *mean = if mean.is_nan() { now } else { 0.95 * *mean + 0.05 * now };
        }
        self.rate.iterations += 1;
        let elapsed = self.rate.since.elapsed().as_secs_f64();
        if elapsed > 1.0 {
            self.rate.per_second = self.rate.iterations as f64 / elapsed;
            self.rate = Rate { since: std::time::Instant::now(), iterations: 0, ..self.rate };
        }
        let [loss, psnr] = self.smooth;
        let n = step.gaussians;
        self.bar.set_message(format!("loss {loss:.4}, PSNR {psnr:.2} dB, {n} Gaussians"));
        self.bar.inc(1);
        if let Some(found) = self.trainer.take_lost_object() {
            self.log.line(i, json!({ "lost_object": found }))?;
        }
        if let Some(found) = self.trainer.take_transients_found() {
            self.log.line(i, json!({ "transients": found }))?;
        }
        if let Some(change) = done.density {
            self.log.line(i, json!({ "density": change }))?;
        }
        if c.logs(i) {
            self.log_step(done)?;
        }
        if LogConfig::due(c.evaluate_interval, i) && !last {
            self.evaluate(i, c.evaluate_views as usize)?;
        }
        if LogConfig::due(c.checkpoint_interval, i) || last {
            self.save()?;
        }
        Ok(())
    }

    /// Whether a window of times would have been better: then the run goes on from there. False where Ctrl-C stops it.
    fn try_window(&mut self, interrupt: &Interrupt) -> Result<bool> {
        let of = self.trainer.iteration();
        let (first, _) = start::first(self.trainer.config(), self.data.points.as_ref());
        let bar = &self.bar;
        let trial = window_trial::try_window(&mut self.trainer, &self.training, &first, &mut |i| {
            bar.set_message(format!("tries a window of times: {i} of {of}"));
            !interrupt.is_set()
        })?;
        let Some(trial) = trial else { return Ok(!interrupt.is_set()) };
        self.log.line(of + 1, json!({ "window_trial": trial }))?;
        if !self.quiet {
            self.bar.suspend(|| output::line(&trial.to_string()));
        }
        Ok(true)
    }

    fn log_step(&mut self, done: &Finished) -> Result<()> {
        let Finished { report: step, timings, .. } = done;
        let mut kernel_ms = serde_json::Map::new();
        for t in timings {
            let entry = kernel_ms.entry(&t.label).or_insert(json!(0.0));
            *entry = json!(entry.as_f64().unwrap_or(0.0) + (t.us * 1e-3 * 1e4).round() / 1e4);
        }
        let (used, _) = self.gpu.memory_used();
        let [position, rotation, translation] = step.property;
        let line = json!({
            "loss": step.loss, "l1": step.l1, "ssim": step.ssim, "psnr": step.psnr,
            "property": { "position": position, "rotation": rotation, "translation": translation },
            "gaussians": step.gaussians, "superpoints": step.superpoints, "visible": step.visible,
            "instances": step.instances, "view": step.view, "device_bytes": used,
            "iterations_per_second": self.rate.per_second, "kernel_ms": kernel_ms,
        });
        self.log.line(step.iteration, line)
    }

    /// Renders `count` held-out views spread over the split; they are scored while the run goes on.
    fn evaluate(&mut self, iteration: u64, count: usize) -> Result<()> {
        let total = self.held_out.views().len();
        let step = total.div_ceil(count.max(1)).max(1);
        let indices: Vec<usize> = (0..total).step_by(step).collect();
        let times = indices.iter().map(|&i| self.held_out.views()[i].time);
        let scene = self.trainer.scene_at(times)?;
        let options = options(self.trainer.config());
        let views = evaluate::render_views(self.gpu, &scene, &self.held_out, &indices, &options)?;
        let (log, bar, quiet) = (self.log.clone(), self.bar.clone(), self.quiet);
        let (seconds, n) = (log.seconds(), self.trainer.gaussians());
        self.background.push(move || {
            let scores = views.iter().map(|view| Ok(view.score()?.0)).collect::<Result<Vec<_>>>()?;
            let [psnr, ssim] = evaluate::mean(&scores);
            let line = json!({ "evaluation": { "psnr": psnr, "ssim": ssim, "views": scores } });
            log.line_at(iteration, seconds, line)?;
            if !quiet {
                let text = format!("{iteration:>7}  held-out PSNR {psnr:.2} dB, SSIM {ssim:.4}, {n} Gaussians");
                bar.suspend(|| output::line(&text));
            }
            Ok(())
        })
    }

    /// Takes the state as it is; the file is written while the run goes on, after the evaluation of the same iteration and
    /// after the last checkpoint. A kill loses what was computed since the last file that is whole, as if the run waited.
    fn save(&mut self) -> Result<()> {
        let (checkpoint, folder) = (self.trainer.checkpoint()?, self.out.join("checkpoints"));
        self.background.push(move || checkpoint.save(&folder).map(|_| ()))
    }
}

/// Starts `spgs view` on the run's folder. It stays open when the run ends; without a display the run goes on alone.
fn open_viewer(out: &Path, data: &Path) {
    let started = std::env::current_exe().and_then(|program| {
        Command::new(program)
            .arg("view")
            .arg(out)
            .arg("--data")
            .arg(data)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
    });
    if let Err(e) = started {
        ::log::warn!("no viewer: {e}");
    }
}

pub(super) fn options(config: &Config) -> RenderOptions {
    RenderOptions { background: config.background, near: config.near, ..RenderOptions::default() }
}
