//! Loading what the command line names, with its warnings on standard error.

use std::path::Path;

use engine::data::CameraSet;
use engine::error::{Error, Result};
use engine::file::Loaded;
use engine::scene::{Camera, Scene};

use crate::cli::camera;

/// Loads a model and warns of what was skipped.
pub fn load(path: &Path) -> Result<Loaded> {
    load_level(path, None)
}

/// Loads a model, at this level of detail if one is asked for, and warns of what was skipped.
pub fn load_level(path: &Path, level: Option<u32>) -> Result<Loaded> {
    let loaded = read_level(path, level)?;
    loaded.warnings.iter().for_each(|w| log::warn!("{w}"));
    Ok(loaded)
}

/// The same without a word on standard error.
pub(crate) fn read_level(path: &Path, level: Option<u32>) -> Result<Loaded> {
    match level {
        Some(level) => engine::file::load_level(path, level),
        None => engine::file::load(path),
    }
}

/// Loads cameras at the asked-for size: both sides, one of them (the other in proportion), or the cameras' own.
pub fn load_cameras(path: &Path, split: Option<&str>, size: [Option<u32>; 2]) -> Result<CameraSet> {
    let both = match size {
        [Some(width), Some(height)] => Some([width, height]),
        _ => None,
    };
    let mut set = engine::data::load_cameras(path, split, both)?;
    set.warnings.iter().for_each(|w| log::warn!("{w}"));
    if both.is_none() {
        set.cameras = set.cameras.iter().map(|c| camera::resized(c, size[0], size[1])).collect();
    }
    Ok(set)
}

/// Frame `index` of a camera file.
pub fn camera(set: &CameraSet, index: usize) -> Result<&Camera> {
    let expected = || format!("0 to {} ({})", set.cameras.len().saturating_sub(1), set.source);
    set.cameras.get(index).ok_or_else(|| Error::usage("--frame", index.to_string(), expected()))
}

/// `36000 Gaussians of SH degree 2, 39 superpoints, 129 key times`.
pub fn describe(scene: &Scene) -> String {
    let mut text = format!("{} Gaussians of SH degree {}", scene.gaussians.len(), scene.gaussians.sh_degree);
    if let Some(superpoints) = scene.deformation.superpoints() {
        text += &format!(", {} superpoints", superpoints.position.len());
    }
    if let Some(motion) = scene.deformation.table() {
        text += &format!(", {} key times", motion.times.len());
    }
    if scene.deformation.network().is_some() {
        text += ", network F";
    }
    if scene.gaussians.antialiased {
        text += ", antialiased";
    }
    text
}
