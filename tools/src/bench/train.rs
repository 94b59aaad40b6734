//! `spgs bench --train`: times of training steps, by kernel, with the bytes that they move and the memory that they take.

mod measure;
mod report;
pub(crate) mod session;
mod start;
mod until;

use engine::data::dataset::{self, DatasetOptions};
use engine::error::{Error, Result};
use engine::gpu::Gpu;
use engine::scene::Gaussians;
use engine::scene::synthetic::{moving_scene, random_scene};
use engine::train::config::Config;
use engine::train::trainer::{Trainer, TrainingData};
use serde_json::{Value, json};

use self::measure::{Plan, TrainMeasurement};
use crate::bench::frame::{DEFAULT_SIZE, SYNTHETIC_KEYS, SYNTHETIC_SEED, SYNTHETIC_SH_DEGREE, write_text};
use crate::cli::args::{BenchArgs, Global};
use crate::cli::{gpu_session, model, output, progress};

/// Measured steps, and steps before, where the arguments do not say: one scene, then each of a sweep.
const STEPS: [[u32; 2]; 2] = [[20, 3], [3, 1]];
/// Gaussians and image sides of a sweep.
const SWEEP: [[u32; 3]; 2] = [[10_000, 100_000, 300_000], [200, 400, 800]];

/// A training set to measure on.
pub(crate) struct Case {
    name: String,
    /// Its photos.
    pub(crate) data: TrainingData,
    /// Where training starts.
    pub(crate) first: Gaussians,
    /// A configuration whose steps are all alike.
    pub(crate) config: Config,
    /// Keeps the photos that were made.
    _folder: Option<tempfile::TempDir>,
}

/// Measures and reports.
pub(crate) fn run(args: &BenchArgs, global: &Global) -> Result<()> {
    if let Some(wanted) = args.until_psnr {
        return until::run(args, global, wanted);
    }
    let fixed =
        args.model.is_some() || args.cameras.is_some() || args.view.width.is_some() || args.view.height.is_some();
    if args.sweep && fixed {
        return Err(Error::usage(
            "bench --train --sweep",
            "a model, cameras or a size",
            "none: the scenes are synthetic",
        ));
    }
    let gpu = gpu_session::open_to_measure_training(global)?;
    let [steps, warmup] = STEPS[usize::from(args.sweep)];
    let plan = Plan { steps: args.frames.unwrap_or(steps), warmup: args.warmup.unwrap_or(warmup) };
    let copy = crate::report::measure::copy_bandwidth(&gpu)?;
    let (width, height) = (args.view.width, args.view.height);
    let size = [width.or(height).unwrap_or(DEFAULT_SIZE), height.or(width).unwrap_or(DEFAULT_SIZE)];
    let scenes: Vec<(u32, [u32; 2])> = if args.sweep {
        let [counts, sides] = SWEEP;
        counts.into_iter().flat_map(|n| sides.into_iter().map(move |s| (n, [s, s]))).collect()
    } else {
        vec![(args.synthetic, size)]
    };
    let bar = progress::bar(2 * u64::from(plan.steps + plan.warmup) * scenes.len() as u64, global.quiet);
    let mut cases = Vec::new();
    for (n, size) in scenes {
        let case = if args.model.is_some() {
            posed(args)?
        } else {
            synthetic(&gpu, args.superpoints, args.view.background, n, size)?
        };
        let measured = measure::measure(&gpu, &case.config, &case.data, &case.first, plan, copy, &|| bar.inc(1))?;
        cases.push((case_record(&case, &measured), measured));
    }
    bar.finish_and_clear();
    gpu_session::report_validation(&gpu);
    let record = record(&gpu, &cases, args.sweep);
    if let Some(path) = &args.json {
        write_text(path, &(output::to_json(&record)? + "\n"))?;
    }
    if let Some(path) = &args.report {
        write_text(path, &report::html(&record, &cases))?;
    }
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        cases.iter().for_each(|(record, m)| output::line(report::text(record, m, !args.sweep).trim_end()));
    }
    Ok(())
}

/// A configuration whose steps are all alike: no density control, all SH degrees and the motion from the first step.
fn config(gaussians: &Gaussians, background: [f32; 3], superpoints: u32) -> Config {
    let mut c = Config { background, ..Config::default() };
    c.schedule.scale = false;
    c.schedule.sh_degree_interval = 0;
    c.schedule.warm_up = 1;
    c.density.enabled = false;
    c.gaussians.sh_degree = gaussians.sh_degree;
    c.motion.enabled = superpoints > 0;
    c.motion.superpoints = superpoints.max(1);
    c
}

/// The model of the arguments, disturbed, and the photos of `--cameras`.
fn posed(args: &BenchArgs) -> Result<Case> {
    let (Some(path), Some(photos)) = (&args.model, &args.cameras) else {
        return Err(Error::usage(
            "bench --train",
            "a model without photos",
            "MODEL with --cameras DATA, or --synthetic",
        ));
    };
    if args.view.width.is_some() || args.view.height.is_some() {
        return Err(Error::usage("bench --train", "--width or --height", "photos at their own size"));
    }
    let data = dataset::load(photos, &DatasetOptions::default())?;
    let first = start::disturbed(&model::load(path)?.scene.gaussians, SYNTHETIC_SEED);
    let config = config(&first, args.view.background, 0);
    let name = format!("{} from a disturbed {}", photos.display(), path.display());
    let data = TrainingData { views: data.train.into(), extent: data.extent, is_static: true };
    Ok(Case { name, data, first, config, _folder: None })
}

/// A synthetic scene, disturbed, and photos of it.
pub(crate) fn synthetic(gpu: &Gpu, superpoints: u32, background: [f32; 3], n: u32, size: [u32; 2]) -> Result<Case> {
    let (count, superpoints) = (n as usize, superpoints.min(n));
    let scene = match superpoints {
        0 => random_scene(count, SYNTHETIC_SEED, SYNTHETIC_SH_DEGREE),
        m => moving_scene(count, m as usize, SYNTHETIC_KEYS, SYNTHETIC_SEED, false),
    };
    let (folder, data) = start::photos(gpu, &scene, size, background)?;
    let first = start::disturbed(&scene.gaussians, SYNTHETIC_SEED);
    let config = config(&first, background, superpoints);
    let name = format!("synthetic, seed {SYNTHETIC_SEED}");
    Ok(Case { name, data, first, config, _folder: Some(folder) })
}

/// Two training steps of a synthetic scene: a trainer whose commands are those of every further step.
pub(crate) fn stepped(gpu: &Gpu, gaussians: u32, superpoints: u32, size: [u32; 2]) -> Result<Trainer> {
    let case = synthetic(gpu, superpoints, [0.0; 3], gaussians, size)?;
    let mut trainer = Trainer::new(gpu, &case.config, &case.data, &case.first)?;
    trainer.step()?;
    trainer.step()?;
    Ok(trainer)
}

fn case_record(case: &Case, measured: &TrainMeasurement) -> Value {
    let camera = &case.data.views[0].camera;
    json!({
        "scene": {
            "name": case.name,
            "gaussians": case.first.len(),
            "sh_degree": case.first.sh_degree,
            "superpoints": if case.config.motion.enabled { case.config.motion.superpoints } else { 0 },
        },
        "photos": { "count": case.data.views.len(), "width": camera.width, "height": camera.height },
        "training": measured,
    })
}

/// Everything that makes the numbers comparable.
fn record(gpu: &Gpu, cases: &[(Value, TrainMeasurement)], sweep: bool) -> Value {
    let mut record = json!({
        "program": { "name": "spgs", "version": env!("CARGO_PKG_VERSION"), "commit": crate::report::measure::commit() },
        "command": std::env::args().collect::<Vec<_>>().join(" "),
        "device": gpu.info(),
    });
    match cases {
        [(case, _)] if !sweep => {
            for key in ["scene", "photos", "training"] {
                record[key] = case[key].clone();
            }
        }
        all => record["sweep"] = all.iter().map(|(case, _)| case.clone()).collect(),
    }
    record
}
