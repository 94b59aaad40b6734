//! `spgs bench train`: times of training steps, by kernel, with the bytes that they move and the memory that they take.

mod measure;
mod report;
pub(crate) mod session;
mod start;
mod until;

use std::path::Path;

use engine::data::dataset::{self, DatasetOptions};
use engine::error::{Error, Result};
use engine::gpu::Gpu;
use engine::scene::Gaussians;
use engine::train::config::Config;
use engine::train::trainer::{Trainer, TrainingData};
use serde_json::{Value, json};

use self::measure::TrainMeasurement;
pub(super) use self::measure::{Plan, predicted};
pub(super) use self::until::table as milestones;
use super::scene::{self, DEFAULT_SIZE, SYNTHETIC_SEED};
use crate::cli::args::{Global, TrainBenchArgs};
use crate::cli::{gpu_session, model, output, progress};
use crate::report::provenance;

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
pub(crate) fn run(args: &TrainBenchArgs, global: &Global) -> Result<()> {
    if let Some(wanted) = args.until_psnr {
        return until::run(args, global, wanted);
    }
    let fixed = args.scene.model.is_some() || args.cameras.is_some() || args.size.asked() != [None; 2];
    if args.sweep && fixed {
        return Err(Error::usage(
            "bench train --sweep",
            "a model, cameras or a size",
            "none: the scenes are synthetic",
        ));
    }
    let gpu = gpu_session::open_to_train(global)?;
    let [steps, warmup] = STEPS[usize::from(args.sweep)];
    let plan = Plan { steps: args.frames.unwrap_or(steps), warmup: args.warmup.unwrap_or(warmup) };
    let copy = engine::render::copy_rate::copy_rate(&gpu)?;
    let scenes: Vec<(u32, [u32; 2])> = if args.sweep {
        let [counts, sides] = SWEEP;
        counts.into_iter().flat_map(|n| sides.into_iter().map(move |s| (n, [s, s]))).collect()
    } else {
        vec![(args.scene.synthetic, args.size.or_square(DEFAULT_SIZE))]
    };
    let bar = progress::bar(u64::from(3 * plan.steps + 2 * plan.warmup) * scenes.len() as u64, global.quiet);
    let mut cases = Vec::new();
    for (n, size) in scenes {
        let case = if args.scene.model.is_some() {
            posed(args)?
        } else {
            synthetic(&gpu, args.scene.superpoints, args.background, n, size)?
        };
        cases.push(measure_case(&gpu, &case, plan, copy, &|| bar.inc(1))?);
    }
    bar.finish_and_clear();
    gpu_session::report_validation(&gpu);
    let record = provenance::record(None, &gpu, numbers(&cases, args.sweep));
    args.results.write(&record, || Ok(report::html(&record, &cases)))?;
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        cases
            .iter()
            .for_each(|(record, m)| output::line(report::text(record, m, !args.sweep, args.predict).trim_end()));
    }
    Ok(())
}

/// Measures a training set: its record, and what was measured. `copy`: rate of copies, GB/s; `tick` is called after each step.
pub(super) fn measure_case(
    gpu: &Gpu,
    case: &Case,
    plan: Plan,
    copy: f64,
    tick: &dyn Fn(),
) -> Result<(Value, TrainMeasurement)> {
    let measured = measure::measure(gpu, &case.config, &case.data, &case.first, plan, copy, tick)?;
    Ok((case_record(case, &measured), measured))
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
fn posed(args: &TrainBenchArgs) -> Result<Case> {
    let (Some(path), Some(photos)) = (&args.scene.model, &args.cameras) else {
        return Err(Error::usage("bench train", "a model without photos", "MODEL with --cameras DATA, or --synthetic"));
    };
    if args.size.asked() != [None; 2] {
        return Err(Error::usage("bench train", "--width or --height", "photos at their own size"));
    }
    photos_of_model(path, args.scene.level, photos, args.background)
}

/// A model, disturbed, and photos of it.
pub(super) fn photos_of_model(path: &Path, level: Option<u32>, photos: &Path, background: [f32; 3]) -> Result<Case> {
    let data = dataset::load(photos, &DatasetOptions::default())?;
    let first = start::disturbed(&model::load_level(path, level)?.scene.gaussians, SYNTHETIC_SEED);
    let config = config(&first, background, 0);
    let name = format!("{} from a disturbed {}", photos.display(), path.display());
    let data = TrainingData { views: data.train.into(), extent: data.extent, is_static: true };
    Ok(Case { name, data, first, config, _folder: None })
}

/// A synthetic scene, disturbed, and photos of it.
pub(crate) fn synthetic(gpu: &Gpu, superpoints: u32, background: [f32; 3], n: u32, size: [u32; 2]) -> Result<Case> {
    let superpoints = superpoints.min(n);
    let scene = scene::synthetic(n, superpoints, false);
    let (folder, data) = start::photos(gpu, &scene, size, background)?;
    let first = start::disturbed(&scene.gaussians, SYNTHETIC_SEED);
    let config = config(&first, background, superpoints);
    let name = scene::synthetic_name();
    Ok(Case { name, data, first, config, _folder: Some(folder) })
}

/// Two training steps of a synthetic scene: a trainer whose commands are those of every further step.
///
/// # Errors
/// As those of the trainer.
pub fn stepped(gpu: &Gpu, gaussians: u32, superpoints: u32, size: [u32; 2]) -> Result<Trainer> {
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

/// The numbers of one training set, or of a sweep over several.
fn numbers(cases: &[(Value, TrainMeasurement)], sweep: bool) -> Value {
    match cases {
        [(case, _)] if !sweep => case.clone(),
        all => json!({ "sweep": all.iter().map(|(case, _)| case.clone()).collect::<Vec<_>>() }),
    }
}
