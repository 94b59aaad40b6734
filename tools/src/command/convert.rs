//! `spgs convert`: a model in another format, whole, at a time, or as a sequence over time; and what that cost.

mod bake;
mod loss;
pub(crate) mod moment;
mod summary;
pub(crate) mod targets;
pub(crate) mod views;

use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use engine::file::{self, Output, spz};
use engine::gpu::Gpu;
use engine::scene::{Gaussians, MotionSource, Scene};

use crate::cli::args::{ConvertArgs, Global, motion_source};
use crate::cli::{gpu_session, model, output, progress};
use moment::Moments;
use targets::Targets;

pub use bake::Baked;
pub use loss::Loss;
pub use summary::Summary;
pub use targets::Written;

/// Converts, and says what that cost.
pub fn run(args: &ConvertArgs, global: &Global) -> Result<()> {
    let summary = convert(args, global)?;
    if args.json {
        return output::json(&summary);
    }
    if !global.quiet {
        summary.lines().iter().for_each(|line| output::line(line));
    }
    Ok(())
}

/// Converts.
///
/// # Errors
/// [`Error::Usage`] for options that do not fit the model or OUT; those of reading, writing and the device.
pub fn convert(args: &ConvertArgs, global: &Global) -> Result<Summary> {
    let kind = output_kind(args)?;
    let targets = Targets::prepare(names(args, kind))?;
    let loaded = model::load_level(&args.input, args.level)?;
    // Before anything is written: OUT may be IN.
    let input_bytes = size(place(&args.input), 4);
    let mut dropped = file::unread(&args.input)?;
    if loaded.rejected.total() > 0 {
        dropped.push(format!("{} Gaussians that cannot be drawn", loaded.rejected.total()));
    }
    let before = loaded.scene;
    let source = motion_source(args.motion);
    check_motion(args, &before, source)?;
    let gpu = device(args, &before, global)?;
    let moments = Moments::new(&before, source, gpu.as_ref())?;
    let quiet = global.quiet || args.json;
    let mut scene = before.clone();
    let baked = if args.bake { Some(bake::bake(&mut scene, &moments, args.bake_error, quiet)?) } else { None };
    dropped.extend(left_behind(args, &before));
    let outputs = write(targets, &times(args, &scene), kind, &scene, &moments, &mut dropped, quiet)?;
    dropped.sort();
    dropped.dedup();
    let loss = loss::measure(&moments, kind, &outputs, args.views, gpu.as_ref())?;
    Ok(Summary {
        input: args.input.clone(),
        input_bytes,
        gaussians: before.gaussians.len() + loaded.rejected.total(),
        rejected: loaded.rejected.total(),
        outputs,
        dropped,
        bake: baked,
        loss,
    })
}

/// What to write, by the name of OUT; options that do not fit it are refused.
fn output_kind(args: &ConvertArgs) -> Result<Output> {
    let mut kind = Output::of_name(&args.output)?;
    match (&mut kind, args.spz_version) {
        (Output::Spz(version), Some(4)) => *version = spz::Version::Four,
        (Output::Spz(_), _) | (_, None) => {}
        (_, Some(_)) => return Err(Error::usage("--spz-version", format!("a {} file", kind.ending()), "a .spz file")),
    }
    if args.bake && !kind.holds_motion() {
        let expected = "a .safetensors file, which holds motion";
        return Err(Error::usage("--bake", format!("a {} file", kind.ending()), expected));
    }
    Ok(kind)
}

/// Refuses options that ask for motion of a model that has none, or not that.
fn check_motion(args: &ConvertArgs, scene: &Scene, source: MotionSource) -> Result<()> {
    scene.deformation.motion_source(source)?;
    if args.times.is_some() && !scene.is_dynamic() {
        return Err(Error::usage("--times", "a model that does not move", "one that moves"));
    }
    Ok(())
}

/// The device, where something asks for one: opened before anything is written, so that a wrong name ends the program early.
/// Without any device the files are written, with a warning.
fn device(args: &ConvertArgs, scene: &Scene, global: &Global) -> Result<Option<Gpu>> {
    let has_field = scene.deformation.field().is_some() && (args.bake || args.time.is_some() || args.times.is_some());
    if args.views == 0 && !has_field {
        return Ok(None);
    }
    match gpu_session::open(global) {
        Ok(gpu) => Ok(Some(gpu)),
        Err(error @ Error::NoDevice { .. }) => {
            if args.views > 0 {
                log::warn!("the loss is not measured: {error}");
            }
            if has_field {
                log::warn!("the deformation field is evaluated on the CPU, which is slow: {error}");
            }
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// What the options leave out.
fn left_behind(args: &ConvertArgs, before: &Scene) -> Vec<String> {
    if args.bake {
        let stays = ["superpoints", "motion", "network G"];
        let parts = before.deformation.parts().into_iter();
        return parts.filter(|part| !stays.contains(part)).map(str::to_owned).collect();
    }
    let is_still = args.time.is_some() || args.times.is_some();
    if is_still && before.is_dynamic() { vec!["motion: each file shows one time".into()] } else { Vec::new() }
}

/// Writes the files: all of them, or none that is new.
fn write(
    mut targets: Targets,
    times: &[Option<f64>],
    kind: Output,
    scene: &Scene,
    moments: &Moments<'_>,
    dropped: &mut Vec<String>,
    quiet: bool,
) -> Result<Vec<Written>> {
    let bar = progress::bar(times.len() as u64, quiet);
    let mut outputs = Vec::with_capacity(times.len());
    for (i, &time) in times.iter().enumerate() {
        let file = targets.files()[i].clone();
        let frozen = time.map(|time| moments.at(time).map(|g| still(g, scene))).transpose()?;
        targets.begin(i);
        dropped.extend(file::save_as(&file, frozen.as_ref().unwrap_or(scene), kind)?);
        let bytes = std::fs::metadata(&file).map_err(|e| Error::io(&file, "read the size", e))?.len();
        outputs.push(Written { file, bytes, time });
        bar.inc(1);
    }
    bar.finish_and_clear();
    targets.keep();
    Ok(outputs)
}

/// The names of the files, as many as [`times`].
fn names(args: &ConvertArgs, kind: Output) -> Vec<PathBuf> {
    match args.times {
        Some(count) => (0..count as usize).map(|i| numbered(&args.output, kind, i)).collect(),
        None => vec![args.output.clone()],
    }
}

/// The times of the files; `None` for one that holds the whole model.
fn times(args: &ConvertArgs, scene: &Scene) -> Vec<Option<f64>> {
    match (args.time, args.times) {
        (Some(time), _) => vec![Some(time)],
        (None, Some(count)) => {
            let [start, end] = scene.time_range();
            let step = (end - start) / f64::from(count.max(2) - 1);
            (0..count).map(|i| Some(start + step * f64::from(i))).collect()
        }
        (None, None) => vec![None],
    }
}

/// Gaussians alone, with what is known of their origin where the format holds that.
fn still(gaussians: Gaussians, scene: &Scene) -> Scene {
    Scene { gaussians, metadata: scene.metadata.clone(), ..Scene::default() }
}

/// `out/scene.spz` → `out/scene_00012.spz`.
fn numbered(path: &Path, kind: Output, index: usize) -> PathBuf {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let (stem, ending) = name.split_at(name.len() - kind.ending().len());
    path.with_file_name(format!("{stem}_{index:05}{ending}"))
}

/// The folder of a description that has its parts beside it; else the path itself.
fn place(path: &Path) -> &Path {
    match path.file_name().and_then(|n| n.to_str()) {
        Some("meta.json" | "lod-meta.json") => {
            path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
        }
        _ => path,
    }
}

/// Bytes of a file, or of a folder's files, three folders deep.
fn size(path: &Path, depth: u32) -> u64 {
    match std::fs::metadata(path) {
        Ok(m) if m.is_file() => m.len(),
        Ok(_) if depth > 0 => {
            std::fs::read_dir(path).into_iter().flatten().flatten().map(|e| size(&e.path(), depth - 1)).sum()
        }
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_go_before_the_ending() {
        let name = |p: &str, kind| numbered(Path::new(p), kind, 7).to_string_lossy().into_owned();
        assert_eq!(name("out/a.spz", Output::Spz(spz::Version::Three)), "out/a_00007.spz");
        assert_eq!(name("a.compressed.ply", Output::CompressedPly), "a_00007.compressed.ply");
    }
}
