//! A run from its first iteration to its last, or until it is interrupted.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use engine::data::dataset::Dataset;
use engine::data::loader::ImageLoader;
use engine::error::Result;
use engine::gpu::Gpu;
use engine::render::RenderOptions;
use engine::train::config::Config;
use engine::train::evaluate::{self, ViewScore};
use engine::train::schedule::Stage;
use engine::train::trainer::{StepReport, Trainer};
use indicatif::ProgressBar;
use serde_json::json;

use super::log::RunLog;
use crate::cli::interrupt::Interrupt;
use crate::cli::output;

/// A run in progress.
pub(super) struct Run<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) out: PathBuf,
    pub(super) data: &'a Dataset,
    pub(super) held_out: ImageLoader,
    pub(super) trainer: Trainer,
    pub(super) log: RunLog,
    pub(super) bar: ProgressBar,
    pub(super) quiet: bool,
    /// Exponential means over the last steps: loss, PSNR.
    pub(super) smooth: [f64; 2],
    pub(super) rate: Rate,
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
            open_viewer(&self.out, data);
        }
        while !self.trainer.is_done() {
            let step = self.trainer.step()?;
            self.after(&step)?;
            if interrupt.is_set() && !self.trainer.is_done() {
                self.save()?;
                return Ok(false);
            }
        }
        interrupt.end_at_next();
        Ok(true)
    }

    /// Log, progress, evaluation and checkpoint of a step.
    fn after(&mut self, step: &StepReport) -> Result<()> {
        let c = self.trainer.config().log.clone();
        let i = step.iteration;
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
        if let Some(change) = self.trainer.take_density_change() {
            self.log.line(i, json!({ "density": change }))?;
        }
        let due = |interval: u64| interval > 0 && i.is_multiple_of(interval);
        if due(c.interval) || i == 1 {
            self.log_step(step)?;
        }
        if due(c.evaluate_interval) && !self.trainer.is_done() {
            let scores = self.evaluate(c.evaluate_views as usize)?;
            let [psnr, ssim] = evaluate::mean(&scores);
            self.log.line(i, json!({ "evaluation": { "psnr": psnr, "ssim": ssim, "views": scores } }))?;
            if !self.quiet {
                self.bar.suspend(|| {
                    output::line(&format!("{i:>7}  held-out PSNR {psnr:.2} dB, SSIM {ssim:.4}, {n} Gaussians"));
                });
            }
        }
        if due(c.checkpoint_interval) || self.trainer.is_done() {
            self.save()?;
        }
        Ok(())
    }

    fn log_step(&mut self, step: &StepReport) -> Result<()> {
        let mut kernel_ms = serde_json::Map::new();
        for t in self.trainer.timings()? {
            let entry = kernel_ms.entry(t.label).or_insert(json!(0.0));
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

    /// Scores `count` held-out views spread over the split.
    pub(super) fn evaluate(&self, count: usize) -> Result<Vec<ViewScore>> {
        let total = self.held_out.views().len();
        let step = total.div_ceil(count.max(1)).max(1);
        let indices: Vec<usize> = (0..total).step_by(step).collect();
        let scene = self.trainer.scene()?;
        evaluate::evaluate(self.gpu, &scene, &self.held_out, &indices, &self.options(), |_, _, _| Ok(()))
    }

    pub(super) fn options(&self) -> RenderOptions {
        options(self.trainer.config())
    }

    pub(super) fn save(&self) -> Result<()> {
        self.trainer.checkpoint()?.save(&self.out.join("checkpoints")).map(|_| ())
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
