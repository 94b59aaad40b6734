//! `spgs convert`: a model in another format, whole, at a time, or as a sequence over time; and what that cost.

mod args;
mod bake;
mod loss;
mod moment;

use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use engine::file::{self, Output, spz};
use engine::scene::{Camera, Gaussians, MotionSource, Scene};
use serde::Serialize;

use crate::args::{Global, motion_source};
use crate::{model, output, progress, view};
use moment::Moments;

pub use args::ConvertArgs;
pub use bake::Baked;
pub use loss::Loss;

/// What was done.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// The file read.
    pub input: PathBuf,
    /// Its size.
    pub input_bytes: u64,
    /// Gaussians in it that can be drawn.
    pub gaussians: usize,
    /// The files written.
    pub outputs: Vec<Written>,
    /// What they do not hold, in words.
    pub dropped: Vec<String>,
    /// The motion table that was made.
    pub bake: Option<Baked>,
    /// How far renders of the files are from renders of the model.
    pub loss: Option<Loss>,
}

/// A file written.
#[derive(Debug, Serialize)]
pub struct Written {
    /// Its name.
    pub file: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// The time that it shows; absent for the whole model.
    pub time: Option<f64>,
}

/// Converts.
pub fn run(args: &ConvertArgs, global: &Global) -> Result<()> {
    let mut kind = Output::of_name(&args.output)?;
    if let (Output::Spz(version), 4) = (&mut kind, args.spz_version) {
        *version = spz::Version::Four;
    }
    if args.bake && !kind.holds_motion() {
        return Err(Error::usage(
            "--bake",
            format!("a {} file", kind.ending()),
            "a .safetensors file, which holds motion",
        ));
    }
    let loaded = model::load_level(&args.input, args.level)?;
    let mut dropped = Vec::new();
    if loaded.rejected.total() > 0 {
        dropped.push(format!("{} Gaussians that cannot be drawn", loaded.rejected.total()));
    }
    let before = loaded.scene;
    let mut scene = before.clone();
    let source = motion_source(args.motion);
    let baked =
        if args.bake { Some(bake::bake(&mut scene, source, args.bake_error, global, args.json)?) } else { None };
    if args.bake {
        let parts = [
            ("network F", before.deform.is_some()),
            ("association", before.association.is_some()),
            ("deformation field", before.field.is_some()),
        ];
        dropped.extend(parts.iter().filter(|(_, is_there)| *is_there).map(|(name, _)| (*name).to_owned()));
    }
    let times = times(args, &scene);
    if times.iter().any(Option::is_some) && is_moving(&before) {
        dropped.push("motion: each file shows one time".into());
    }
    // Files that hold the whole model need no evaluation.
    let moments = times.iter().any(Option::is_some).then(|| Moments::new(&scene, source, global)).transpose()?;
    let bar = progress::bar(times.len() as u64, global.quiet || args.json);
    let mut outputs = Vec::with_capacity(times.len());
    for (i, &time) in times.iter().enumerate() {
        let path = if args.times.is_some() { numbered(&args.output, kind, i) } else { args.output.clone() };
        let frozen = match (time, &moments) {
            (Some(time), Some(moments)) => Some(still(moments.at(time)?, &scene)),
            _ => None,
        };
        let shown = frozen.as_ref().unwrap_or(&scene);
        dropped.extend(file::save_as(&path, shown, kind)?);
        let bytes = std::fs::metadata(&path).map_err(|e| Error::io(&path, "read the size", e))?.len();
        outputs.push(Written { file: path, bytes, time });
        bar.inc(1);
    }
    bar.finish_and_clear();
    dropped.sort();
    dropped.dedup();
    let loss = loss::measure(&before, kind, &outputs, source, args.views, global)?;
    let summary = Summary {
        input: args.input.clone(),
        input_bytes: size(&args.input, 4),
        gaussians: before.gaussians.len(),
        outputs,
        dropped,
        bake: baked,
        loss,
    };
    if args.json {
        return output::json(&summary);
    }
    if !global.quiet {
        summary.lines().iter().for_each(|line| output::line(line));
    }
    Ok(())
}

/// The times of the files; `None` for one that holds the whole model.
fn times(args: &ConvertArgs, scene: &Scene) -> Vec<Option<f64>> {
    match (args.time, args.times) {
        (Some(time), _) => vec![Some(time)],
        (None, Some(count)) => {
            let [start, end] = view::time_range(scene);
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

impl Summary {
    fn lines(&self) -> Vec<String> {
        let bytes: u64 = self.outputs.iter().map(|o| o.bytes).sum();
        let name = |o: Option<&Written>| o.map(|o| o.file.display().to_string()).unwrap_or_default();
        let mut to = name(self.outputs.first());
        if self.outputs.len() > 1 {
            to += &format!(" to {} ({} files)", name(self.outputs.last()), self.outputs.len());
        }
        let input = self.input.display();
        let mut lines =
            vec![format!("{input} ({} bytes, {} Gaussians) → {to} ({bytes} bytes)", self.input_bytes, self.gaussians)];
        if let Some(bake) = &self.bake {
            lines.push(bake.line());
        }
        lines.push(match &self.dropped[..] {
            [] => "left out: nothing".into(),
            dropped => format!("left out: {}", dropped.join("; ")),
        });
        lines.push(match &self.loss {
            Some(loss) => loss.line(),
            None => "loss: not measured".into(),
        });
        lines
    }
}

/// Cameras around a scene, all at one time where that is given.
fn cameras(scene: &Scene, size: [u32; 2], count: usize, time: Option<f64>) -> Vec<Camera> {
    let mut cameras = view::orbit(scene, size, count);
    if let Some(time) = time {
        cameras.iter_mut().for_each(|c| c.time = time);
    }
    cameras
}

/// Whether a scene moves by itself.
fn is_moving(scene: &Scene) -> bool {
    scene.field.is_some() || scene.motion_source(MotionSource::Auto).is_ok_and(|s| s.is_some())
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
