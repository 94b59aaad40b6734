//! `spgs train`: posed images → model.

mod background;
mod decide;
mod exposures;
mod finish;
pub mod log;
mod refit;
pub mod report;
mod run;
mod transients;

use std::path::{Path, PathBuf};

use engine::data::dataset::{self, Dataset, DatasetOptions};
use engine::data::loader::ImageLoader;
use engine::error::{Error, Result};
use engine::file::durable::write_atomic;
use engine::train::checkpoint::Checkpoint;
use engine::train::config::Config;
use engine::train::schedule::Stage;
use engine::train::trainer::{Profile, Trainer, TrainingData};

use self::background::Background;
use self::log::{RunLog, SharedLog};
use self::run::{Rate, Run};
use crate::cli::args::{Global, TrainArgs};
use crate::cli::{gpu_session, output, progress};
use crate::report::files::create_folder;

/// Trains, exports, evaluates and reports.
///
/// # Errors
/// As the engine's; an interrupted run saves a checkpoint and ends without error.
pub fn run(args: &TrainArgs, global: &Global) -> Result<()> {
    if args.print_config {
        let config =
            args.data.as_deref().map_or_else(|| decide::config(args, None), |data| Ok(begin(data, args)?.1))?;
        output::line(config.to_toml()?.trim_end());
        return Ok(());
    }
    let (Some(path), Some(out)) = (&args.data, &args.out) else {
        return Err(Error::usage("spgs train", "no data set or no --out", "both"));
    };
    let checkpoints = out.join("checkpoints");
    // The non-rigid stage begins with what the rigid one left.
    let saved = if args.resume || args.nonrigid { Some(newest(&checkpoints)?) } else { None };
    let (saved, newest) = saved.unzip();
    let (data, config) = match &saved {
        Some(c) => {
            let begins = args.nonrigid && c.stage != Stage::Nonrigid;
            let config = if begins { decide::nonrigid(args, &c.config)? } else { decide::resumed(args, &c.config)? };
            (load(path, &c.config.data, args)?, config)
        }
        None => begin(path, args)?,
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
    let trainer = trainer.with_profile(Profile::Logged);
    create_folder(out)?;
    if let Some(newest) = newest {
        // What a kill left beside the last three.
        Checkpoint::remove_old(&checkpoints, &newest)?;
    }
    let text = trainer.config().to_toml()?;
    write_atomic(&out.join("config.toml"), |f| f.write_all(text.as_bytes()))?;
    if say {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
    }
    let held_out = if data.test.is_empty() { &data.train } else { &data.test };
    let held_out = ImageLoader::new(held_out.clone().into(), trainer.config().budget.image_bytes, 1)?;
    let bar = progress::training(trainer.schedule().iterations(), trainer.iteration(), global.quiet);
    let kept = if stage.is_some() { log::Kept::UpTo(trainer.iteration()) } else { log::Kept::Nothing };
    let log = SharedLog::new(RunLog::open(out, kept, trainer.schedule().stage())?);
    let rate = Rate { since: std::time::Instant::now(), iterations: 0, per_second: 0.0 };
    let smooth = [f64::NAN; 2];
    let mut run = Run {
        gpu: &gpu,
        out: out.clone(),
        data: &data,
        training,
        held_out,
        trainer,
        log,
        bar,
        quiet: !say,
        smooth,
        rate,
        background: Background::default(),
    };
    let finished = run.iterate(args.view.then_some(path))?;
    run.bar.finish_and_clear();
    gpu_session::report_validation(&gpu);
    if !finished {
        output::error_line(&run.interrupted());
        return Ok(());
    }
    run.finish(path, args.json)
}

/// The newest checkpoint of a folder that a run goes on from, and its file.
fn newest(folder: &Path) -> Result<(Checkpoint, PathBuf)> {
    let (checkpoint, path, problems) = Checkpoint::newest(folder)?.ok_or_else(|| {
        Error::usage("--resume", format!("no checkpoint in {}", folder.display()), "the --out folder of an earlier run")
    })?;
    problems.iter().for_each(|p| ::log::warn!("damaged checkpoint passed over: {p}"));
    Ok((checkpoint, path))
}

/// The data set of a new run, and its configuration, which depends on the data's format.
fn begin(path: &Path, args: &TrainArgs) -> Result<(Dataset, Config)> {
    let first = decide::config(args, None)?;
    let data = load(path, &first.data, args)?;
    let config = decide::config(args, Some(&data))?;
    Ok((data, config))
}

fn load(path: &Path, options: &DatasetOptions, args: &TrainArgs) -> Result<Dataset> {
    let downscale = args.downscale.or(options.downscale);
    dataset::load(path, &DatasetOptions { downscale, ..*options })
}
