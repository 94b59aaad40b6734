//! `spgs train`: posed images → model.

mod decide;
mod finish;
pub mod log;
pub mod report;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use engine::data::dataset::{self, Dataset, DatasetOptions};
use engine::data::loader::ImageLoader;
use engine::error::{Error, Result};
use engine::file::durable::write_atomic;
use engine::gpu::Gpu;
use engine::render::RenderOptions;
use engine::train::checkpoint::Checkpoint;
use engine::train::config::Config;
use engine::train::evaluate::{self, ViewScore};
use engine::train::schedule::Stage;
use engine::train::trainer::{StepReport, Trainer, TrainingData};
use indicatif::ProgressBar;
use serde_json::json;

use self::log::RunLog;
use crate::cli::args::{Global, TrainArgs};
use crate::cli::interrupt::Interrupt;
use crate::cli::{gpu_session, output, progress};
use crate::report::files::create_folder;

/// A run in progress.
struct Run<'a> {
    gpu: &'a Gpu,
    out: PathBuf,
    data: &'a Dataset,
    held_out: ImageLoader,
    trainer: Trainer,
    log: RunLog,
    bar: ProgressBar,
    quiet: bool,
    /// Exponential means over the last steps: loss, PSNR.
    smooth: [f64; 2],
    rate: Rate,
}

/// Iterations per second over the last stretch.
struct Rate {
    since: std::time::Instant,
    iterations: u64,
    per_second: f64,
}

/// Trains, exports, evaluates and reports.
///
/// # Errors
/// As the engine's; an interrupted run saves a checkpoint and ends without error.
pub fn run(args: &TrainArgs, global: &Global) -> Result<()> {
    if args.print_config {
        output::line(decide::config(args, None)?.to_toml()?.trim_end());
        return Ok(());
    }
    let (Some(path), Some(out)) = (&args.data, &args.out) else {
        return Err(Error::usage("spgs train", "no data set or no --out", "both"));
    };
    let checkpoints = out.join("checkpoints");
    // The non-rigid stage begins with what the rigid one left.
    let saved = if args.resume || args.nonrigid { Some(newest(&checkpoints)?) } else { None };
    let (data, config) = match &saved {
        Some(c) => (load(path, &c.config.data, args)?, decide::resumed(args, &c.config)?),
        None => {
            let first = decide::config(args, None)?;
            let data = load(path, &first.data, args)?;
            let config = decide::config(args, Some(data.kind))?;
            (data, config)
        }
    };
    let say = !global.quiet && !args.json;
    if say {
        data.decisions.iter().for_each(|d| output::line(&format!("data    {d}")));
    }
    let gpu = gpu_session::open_to_train(global)?;
    let training = TrainingData { views: data.train.clone().into(), extent: data.extent, is_static: data.is_static };
    let stage = saved.as_ref().map(|c| c.stage);
    let trainer = match saved {
        Some(checkpoint) if args.nonrigid && checkpoint.stage != Stage::Nonrigid => {
            Trainer::nonrigid(&gpu, &config, &training, &checkpoint)?
        }
        Some(mut checkpoint) => {
            checkpoint.config = config;
            Trainer::resume(&gpu, &training, &checkpoint)?
        }
        None => {
            let (first, line) = decide::first_gaussians(args, &config, &data)?;
            if say {
                output::line(&format!("start   {line}"));
            }
            Trainer::new(&gpu, &config, &training, &first)?
        }
    };
    let trainer = trainer.with_profile(true);
    create_folder(out)?;
    let text = trainer.config().to_toml()?;
    write_atomic(&out.join("config.toml"), |f| f.write_all(text.as_bytes()))?;
    if say {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
    }
    let held_out = if data.test.is_empty() { &data.train } else { &data.test };
    let held_out = ImageLoader::new(held_out.clone().into(), trainer.config().budget.image_bytes, 1)?;
    let bar = progress::training(trainer.schedule().iterations(), trainer.iteration(), global.quiet);
    let kept = if stage.is_some() { log::Kept::UpTo(trainer.iteration()) } else { log::Kept::Nothing };
    let log = RunLog::open(out, kept, trainer.schedule().stage())?;
    let rate = Rate { since: std::time::Instant::now(), iterations: 0, per_second: 0.0 };
    let smooth = [f64::NAN; 2];
    let mut run =
        Run { gpu: &gpu, out: out.clone(), data: &data, held_out, trainer, log, bar, quiet: !say, smooth, rate };
    let finished = run.iterate(args.view.then_some(path))?;
    run.bar.finish_and_clear();
    gpu_session::report_validation(&gpu);
    if !finished {
        let at = run.trainer.iteration();
        output::error_line(&format!(
            "spgs: interrupted; iteration {at} is saved in {}; go on with --resume",
            checkpoints.display()
        ));
        return Ok(());
    }
    run.finish(path, args.json)
}

/// The newest checkpoint of a folder.
fn newest(folder: &Path) -> Result<Checkpoint> {
    let (checkpoint, _, problems) = Checkpoint::newest(folder)?.ok_or_else(|| {
        Error::usage("--resume", format!("no checkpoint in {}", folder.display()), "the --out folder of an earlier run")
    })?;
    problems.iter().for_each(|p| ::log::warn!("damaged checkpoint passed over: {p}"));
    Ok(checkpoint)
}

fn load(path: &Path, options: &DatasetOptions, args: &TrainArgs) -> Result<Dataset> {
    let downscale = args.downscale.or(options.downscale);
    dataset::load(path, &DatasetOptions { downscale, ..*options })
}

impl Run<'_> {
    /// Runs to the end (true) or until interrupted (false); a viewer may watch, with the cameras of this data set.
    fn iterate(&mut self, watch: Option<&Path>) -> Result<bool> {
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
    fn evaluate(&self, count: usize) -> Result<Vec<ViewScore>> {
        let total = self.held_out.views().len();
        let step = total.div_ceil(count.max(1)).max(1);
        let indices: Vec<usize> = (0..total).step_by(step).collect();
        let scene = self.trainer.scene()?;
        evaluate::evaluate(self.gpu, &scene, &self.held_out, &indices, &self.options(), |_, _, _| Ok(()))
    }

    fn options(&self) -> RenderOptions {
        options(self.trainer.config())
    }

    fn save(&self) -> Result<()> {
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

fn options(config: &Config) -> RenderOptions {
    RenderOptions { background: config.background, near: config.near, ..RenderOptions::default() }
}
