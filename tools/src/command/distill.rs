//! `spgs distill`: the motion of any model as superpoints, within a bound in pixels; and what that cost.

mod compare;
mod page;
mod photos;
mod session;
mod summary;
mod tune;

use std::path::Path;

use engine::distill::{self, Options};
use engine::error::{Error, Result};
use engine::file::{self, durable};
use engine::gpu::Gpu;
use engine::render::RenderOptions;
use engine::scene::{Camera, MotionSource, Scene};
use engine::train::bake::Views;
use engine::train::config::Config;
use serde_json::{Value, json};

use crate::cli::args::{DistillArgs, Global, motion_source};
use crate::cli::interrupt::Interrupt;
use crate::cli::{gpu_session, model, output, progress};
use crate::command::convert::moment::Moments;
use crate::command::convert::targets::Targets;
use crate::command::convert::views;
use crate::report::files::{to_json, write_text};
use crate::report::provenance;
use compare::Shown;
use photos::{Held, Photos};
use session::{Taught, step};

pub use summary::Summary;
pub use tune::Tuning;

/// Size of the cameras that are made where no data set has any.
const SIZE: [u32; 2] = [800, 800];
/// Views in which images are compared: on a GPU, and on a CPU.
const COMPARED: [u32; 2] = [256, 16];
/// Names of the files, the model first.
const NAMES: [&str; 3] = ["model.safetensors", "report.json", "report.html"];

/// Distills, and says what that cost.
///
/// # Errors
/// As [`distill()`].
pub fn run(args: &DistillArgs, global: &Global) -> Result<()> {
    let record = distill(args, global)?;
    if args.json {
        return output::json(&record.0);
    }
    if !global.quiet {
        record.1.lines().iter().for_each(|line| output::line(line));
    }
    Ok(())
}

/// Distills; the record that was written, and what it says.
///
/// # Errors
/// Those of reading and writing, of the device, and of [`distill::distill`]. Then nothing is written.
pub fn distill(args: &DistillArgs, global: &Global) -> Result<(Value, Summary)> {
    check_folder(&args.out)?;
    let loaded = model::load(&args.teacher)?;
    let teacher = loaded.scene;
    let source = motion_source(args.motion);
    teacher.deformation.motion_source(source)?;
    let quiet = global.quiet || args.json;
    let gpu = device(args, &teacher, global)?;
    let interrupt = Interrupt::watch("Ctrl-C ends the program at once");
    let bar = progress::counter("", quiet);
    let moments = Moments::new(&teacher, source, gpu.as_ref())?;
    let taught = look(args, moments)?;
    let mut place = |time: f64| taught.moments.at(time);
    let options = Options { error_px: args.error, max_superpoints: args.max_superpoints as usize };
    let mut tick = |what: &'static str, done: usize, _| step(&bar, &interrupt, what, done);
    let mut fitted = distill::distill(&teacher, &mut place, &taught.views, &options, &mut tick)?;
    fitted.report.dropped.extend(file::unread(&args.teacher)?);
    let held = held(args, gpu.as_ref())?;
    let cameras = compared(args, &taught, gpu.as_ref())?;
    let tuned = match (args.iterations, &gpu) {
        (Some(iterations), Some(gpu)) => {
            bar.finish_and_clear();
            let (held, interrupt) = (held.as_ref(), &interrupt);
            let task = tune::Task { gpu, taught: &taught, held, compared: &cameras, interrupt, quiet };
            Some(task.tune(args, &fitted, iterations)?)
        }
        _ => None,
    };
    let (mut scene, tuning) = match tuned {
        Some((scene, tuning)) => (scene, Some(tuning)),
        None => (fitted.scene, None),
    };
    let report = fitted.report;
    let mut record = json!({ "teacher": name(&args.teacher), "report": report, "tuning": tuning });
    // The same model has the same bytes, however long it took.
    for part in ["report", "tuning"] {
        record[part].as_object_mut().map(|part| part.remove("seconds"));
    }
    scene.metadata.insert("distilled".into(), record.to_string());
    let mut shown = Vec::new();
    let bar = progress::counter("", quiet);
    let (mut images, mut photos) = (None, None);
    if let Some(gpu) = &gpu {
        images = compare::compare(gpu, &taught.moments, &scene, &cameras, &taught.options, &mut shown, &mut |k| {
            step(&bar, &interrupt, "images of teacher and student", k);
        })?;
        photos = score(gpu, held.as_ref(), &taught, &scene, &mut |k| step(&bar, &interrupt, "photos", k))?;
    }
    bar.finish_and_clear();
    let summary = Summary {
        teacher: args.teacher.clone(),
        out: args.out.clone(),
        motion: report,
        tuning,
        bytes: [std::fs::metadata(&args.teacher).ok().filter(|m| m.is_file()).map(|m| m.len()), None],
        measured_in: taught.measured_in,
        images,
        photos,
    };
    write(summary, &scene, gpu.as_ref(), &shown)
}

/// Looks whether files can be written, before any work.
fn check_folder(out: &Path) -> Result<()> {
    if out.is_dir() {
        return NAMES.iter().try_for_each(|name| durable::check_target(&out.join(name)));
    }
    if std::fs::symlink_metadata(out).is_ok() {
        return Err(Error::usage(format!("--out {}", out.display()), "something else", "a folder, or a new name"));
    }
    Ok(())
}

/// The device: a field is evaluated on it, and images are drawn. Without any, the motion alone is measured.
fn device(args: &DistillArgs, teacher: &Scene, global: &Global) -> Result<Option<Gpu>> {
    if args.iterations.is_some() {
        return gpu_session::open_to_train(global).map(Some);
    }
    if args.teacher_views == Some(0) && args.data.is_none() && teacher.deformation.field().is_none() {
        return Ok(None);
    }
    match gpu_session::open(global) {
        Ok(gpu) => Ok(Some(gpu)),
        Err(error @ Error::NoDevice { .. }) => {
            log::warn!(
                "images are not compared, and a deformation field is evaluated on the CPU, which is slow: {error}"
            );
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Cameras of the data, or around the scene.
fn look<'a>(args: &DistillArgs, moments: Moments<'a>) -> Result<Taught<'a>> {
    let trained: Option<Config> =
        moments.scene().metadata.get("training").and_then(|text| serde_json::from_str(text).ok());
    let mut options = RenderOptions { motion: moments.source(), ..RenderOptions::default() };
    if let Some(config) = &trained {
        (options.background, options.near) = (config.background, config.near);
    }
    let (cameras, measured_in) = match &args.data {
        Some(data) => {
            let all = cameras_of(data, args.downscale)?;
            let some: Vec<Camera> = distill::spread(&all, distill::CAMERAS).cloned().collect();
            let size = some.first().map(|c| format!("{}x{}", c.width, c.height)).unwrap_or_default();
            let measured_in = format!("{} cameras of {}, {size}", some.len(), name(data));
            (some, measured_in)
        }
        None => {
            let around = views::around(&moments, SIZE, distill::CAMERAS, None)?;
            options.near = around.near;
            (around.cameras, format!("{} views of {}x{} around the scene", distill::CAMERAS, SIZE[0], SIZE[1]))
        }
    };
    let views = Views { cameras, near: f64::from(options.near), everywhere: true };
    Ok(Taught { moments, views, measured_in, options })
}

/// Photos to score on, where there is a device.
fn held(args: &DistillArgs, gpu: Option<&Gpu>) -> Result<Option<Held>> {
    match (&args.data, gpu) {
        (Some(data), Some(_)) => Held::of(data, args.downscale),
        _ => Ok(None),
    }
}

/// Scores teacher and student on photos.
fn score(
    gpu: &Gpu,
    held: Option<&Held>,
    taught: &Taught<'_>,
    student: &Scene,
    tick: &mut dyn FnMut(usize),
) -> Result<Option<Photos>> {
    let Some(held) = held else { return Ok(None) };
    let auto = RenderOptions { motion: MotionSource::Auto, ..taught.options.clone() };
    let teacher = held.score(gpu, taught.moments.scene(), &taught.options, tick)?;
    Ok(Some(held.both([teacher, held.score(gpu, student, &auto, tick)?])))
}

/// All cameras of a data set or a camera file.
fn cameras_of(data: &Path, downscale: Option<u32>) -> Result<Vec<Camera>> {
    let all = model::load_cameras(data, None, [None; 2])?.cameras;
    let side = |pixels: u32, by: u32| (f64::from(pixels) / f64::from(by)).round().max(1.0) as u32;
    let smaller = |c: &Camera, by: u32| c.resized(side(c.width, by), side(c.height, by));
    Ok(match downscale {
        Some(by) => all.iter().map(|c| smaller(c, by)).collect(),
        None => all,
    })
}

/// The views in which images are compared: of the data, at their times, or around the scene.
fn compared(args: &DistillArgs, taught: &Taught<'_>, gpu: Option<&Gpu>) -> Result<Vec<Camera>> {
    let Some(gpu) = gpu else { return Ok(Vec::new()) };
    let count = args.teacher_views.unwrap_or(COMPARED[usize::from(gpu.info().is_cpu())]) as usize;
    if count == 0 {
        return Ok(Vec::new());
    }
    let Some(data) = &args.data else {
        let size = SIZE.map(|side| side / 2);
        return Ok(views::around(&taught.moments, size, count, None)?.cameras);
    };
    let all = cameras_of(data, args.downscale)?;
    Ok(distill::spread(&all, count).cloned().collect())
}

fn name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}

/// Writes all files, or none that is new.
fn write(mut summary: Summary, scene: &Scene, gpu: Option<&Gpu>, shown: &[Shown]) -> Result<(Value, Summary)> {
    let mut targets = Targets::prepare(NAMES.iter().map(|name| summary.out.join(name)).collect())?;
    let files = targets.files().to_vec();
    targets.begin(0);
    file::save(&files[0], scene)?;
    summary.bytes[1] = std::fs::metadata(&files[0]).ok().map(|m| m.len());
    let numbers = json!(summary);
    let record = match gpu {
        Some(gpu) => provenance::record(Some("distill"), gpu, numbers),
        None => numbers,
    };
    let page = page::page(&record, &summary, shown)?;
    targets.begin(1);
    write_text(&files[1], &(to_json(&record)? + "\n"))?;
    targets.begin(2);
    write_text(&files[2], &page)?;
    targets.keep();
    Ok((record, summary))
}
