//! `spgs pose`: how superpoints and cameras stand in photos that were never trained.

mod page;
mod summary;

use std::path::{Path, PathBuf};

use engine::data::camera_file;
use engine::data::dataset::{self, DatasetOptions, View};
use engine::error::{Error, Result};
use engine::file::{self, Output, durable};
use engine::gpu::Gpu;
use engine::pose::{Following, Moment, Options, PhotoReport, Progress, Solve, divide, follow};
use engine::scene::Scene;
use engine::train::config::Config;

pub use self::summary::Summary;
use self::summary::word;
use crate::cli::args::{Global, PoseArgs, SolveArg};
use crate::cli::interrupt::{self, Interrupt};
use crate::cli::{gpu_session, model, output, progress};
use crate::report::files::{to_json, write_text};

/// Pixels of a photo's shorter side; in smaller ones a search ends anywhere.
const SMALLEST_SIDE: u32 = 24;

/// Where things go.
struct Target {
    model: Option<PathBuf>,
    cameras: PathBuf,
    report: Option<PathBuf>,
    page: Option<PathBuf>,
}

/// Follows the photos and says what was found.
///
/// # Errors
/// As [`pose`].
pub fn run(args: &PoseArgs, global: &Global) -> Result<()> {
    let Some(summary) = pose(args, global)? else {
        output::error_line("spgs: interrupted; nothing is written");
        std::process::exit(interrupt::CODE);
    };
    if args.json {
        return output::json(&summary);
    }
    if !global.quiet {
        lines(&summary).iter().for_each(|line| output::line(line));
    }
    Ok(())
}

/// Follows the photos. `None` when interrupted; then nothing is written.
///
/// # Errors
/// Those of model, data set and device; of writing. Then nothing is written either.
pub fn pose(args: &PoseArgs, global: &Global) -> Result<Option<Summary>> {
    let target = Target::new(&args.out, args.solve.into())?;
    let loaded = model::load(&args.model)?;
    let mut scene = loaded.scene;
    let trained = training_config(&scene);
    if let Some(count) = args.superpoints {
        if args.solve == SolveArg::Camera {
            return Err(Error::usage("--superpoints", "--solve camera", "--solve superpoints or both"));
        }
        divide(&mut scene, count as usize)?;
    }
    let views = views(args, trained.as_ref())?;
    let options = options(args, trained.as_ref());
    let gpu = gpu_session::open_to_train(global)?;
    let Some(found) = search(&gpu, &scene, &views, &options, global.quiet || args.json)? else { return Ok(None) };
    gpu_session::report_validation(&gpu);
    let keys = |scene: &Scene| scene.deformation.key_times().len();
    let summary = Summary {
        model: args.model.clone(),
        output: target.model.clone(),
        cameras: target.cameras.clone(),
        report: target.report.clone(),
        page: target.page.clone(),
        device: gpu.info().name.clone(),
        options,
        key_times: [keys(&scene), keys(&found.scene)],
        moments: found.moments.clone(),
    };
    target.write(&found, &summary)?;
    Ok(Some(summary))
}

fn search(gpu: &Gpu, scene: &Scene, views: &[View], options: &Options, quiet: bool) -> Result<Option<Following>> {
    let mut times: Vec<f32> = views.iter().map(|v| v.time as f32).collect();
    times.sort_by(f32::total_cmp);
    times.dedup();
    let bar = progress::poses(times.len() as u64, quiet);
    let interrupt = Interrupt::watch("Ctrl-C ends the program at once");
    let mut watch = |p: &Progress| {
        bar.set_position(p.moment as u64);
        let place = if p.round > 0 { format!("round {}", p.round) } else { format!("iteration {}", p.iteration) };
        bar.set_message(format!("time {:.4}, {place}, loss {:.4}", p.time, p.loss));
        !interrupt.is_set()
    };
    let found = follow(gpu, scene, views, options, None, &mut watch);
    bar.finish_and_clear();
    // Files appear whole or not at all.
    interrupt.end_at_next(None);
    found
}

impl Target {
    /// Looks whether all files can be written, before any work.
    fn new(path: &Path, solve: Solve) -> Result<Self> {
        let is_json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
        let target = if is_json && solve == Solve::Camera {
            Self { model: None, cameras: path.to_owned(), report: None, page: None }
        } else {
            let kind = Output::of_name(path)?;
            if !kind.holds_motion() {
                let expected = "a .safetensors model; with --solve camera also a .json";
                return Err(Error::usage(format!("output {}", path.display()), "a format without motion", expected));
            }
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let stem = &name[..name.len() - kind.ending().len()];
            let beside = |what: &str| path.with_file_name(format!("{stem}.{what}"));
            let [report, page] = ["pose.json", "pose.html"].map(|what| Some(beside(what)));
            Self { model: Some(path.to_owned()), cameras: beside("cameras.json"), report, page }
        };
        let all = target.model.iter().chain([&target.cameras]).chain(&target.report).chain(&target.page);
        all.into_iter().try_for_each(|path| durable::check_target(path))?;
        Ok(target)
    }

    /// The model last: where it is, the others are.
    fn write(&self, found: &Following, summary: &Summary) -> Result<()> {
        camera_file::write(&self.cameras, &found.cameras)?;
        if let Some(report) = &self.report {
            write_text(report, &(to_json(summary)? + "\n"))?;
        }
        if let Some(path) = &self.page {
            write_text(path, &page::page(summary)?)?;
        }
        if let Some(model) = &self.model {
            file::save(model, &found.scene)?;
        }
        Ok(())
    }
}

/// What the model was trained with, if the engine trained it.
fn training_config(scene: &Scene) -> Option<Config> {
    scene.metadata.get("training").and_then(|text| serde_json::from_str(text).ok())
}

/// The photos, at the size that is looked at.
fn views(args: &PoseArgs, trained: Option<&Config>) -> Result<Vec<View>> {
    let as_trained = trained.map(|c| c.data).unwrap_or_default();
    let options = DatasetOptions { downscale: args.downscale.or(as_trained.downscale), ..as_trained };
    let data = dataset::load(&args.images, &options)?;
    let all = match args.split.as_deref() {
        None if data.test.is_empty() => data.train,
        None | Some("test") => data.test,
        Some("train") => data.train,
        Some("val") => data.val,
        Some("all") => [data.train, data.test, data.val].concat(),
        Some(other) => return Err(Error::usage("--split", other, "train, test, val or all")),
    };
    let (from, to) = (args.from.unwrap_or(f64::NEG_INFINITY), args.to.unwrap_or(f64::INFINITY));
    let taken = all.into_iter().filter(|v| (from..=to).contains(&v.time));
    let views: Vec<View> = taken.step_by(args.every as usize).collect();
    if views.is_empty() {
        let what = format!("photos of {}", args.images.display());
        return Err(Error::usage(what, "none in this split and between these times", "at least one"));
    }
    if let Some(small) = views.iter().find(|v| v.camera.width.min(v.camera.height) < SMALLEST_SIDE) {
        let found = format!("{}x{} pixels", small.camera.width, small.camera.height);
        let expected = format!(
            "{SMALLEST_SIDE} on the shorter side; photos are reduced as those of the training were, unless `--downscale 1` keeps them"
        );
        return Err(Error::usage(format!("photo {}", small.name), found, expected));
    }
    Ok(views)
}

fn options(args: &PoseArgs, trained: Option<&Config>) -> Options {
    let usual = Options::default();
    Options {
        solve: args.solve.into(),
        init: args.init,
        iterations: args.iterations,
        rounds: args.rounds,
        coupling: args.coupling,
        smoothness: args.smoothness,
        background: args.background.or(trained.map(|c| c.background)).unwrap_or(usual.background),
        near: args.near.or(trained.map(|c| c.near)).unwrap_or(usual.near),
        deterministic: args.deterministic,
        ..usual
    }
}

/// For people.
fn lines(summary: &Summary) -> Vec<String> {
    let mut lines: Vec<String> = summary.moments.iter().flat_map(of_moment).collect();
    let [before, after] = summary.key_times;
    let cameras = summary.cameras.display();
    lines.push(match &summary.output {
        Some(output) => {
            let page = summary.page.as_ref().map_or_else(String::new, |page| format!(", charts in {}", page.display()));
            format!("{}: {before} → {after} key times; cameras in {cameras}{page}", output.display())
        }
        None => format!("cameras in {cameras}"),
    });
    lines
}

fn of_moment(moment: &Moment) -> Vec<String> {
    let mut lines: Vec<String> =
        moment.photos.iter().map(|p| format!("time {:.4}, {}", moment.time, of_photo(p))).collect();
    if !moment.superpoints.is_empty() {
        if !moment.is_better {
            lines.push("    nothing better found: superpoints stay as they were".into());
        }
        let mut across: Vec<f64> = moment.superpoints.iter().filter_map(|u| u.across_px).collect();
        across.sort_by(f64::total_cmp);
        let median = across.get(across.len() / 2).map_or_else(String::new, |px| format!(", ±{px:.3} px (median)"));
        let seen = moment.superpoints.iter().filter(|u| u.seen).count();
        lines.push(format!("    {seen} of {} superpoints seen{median}", moment.superpoints.len()));
    }
    lines
}

fn of_photo(photo: &PhotoReport) -> String {
    let line = format!("{}: {:.2} → {:.2} dB", photo.name, photo.psnr_before, photo.psnr);
    let Some(camera) = &photo.camera else { return line };
    let word = word(camera.verdict);
    let px = camera.moved_px.map_or_else(String::new, |px| format!(" ({px:.2} px)"));
    format!("{line}; camera turned {:.3}°, moved {:.4}{px}: {word}", camera.turned_degrees, camera.moved)
}
