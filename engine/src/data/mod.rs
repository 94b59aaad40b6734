//! Data sets of posed pictures, and camera files: NeRF `transforms*.json` and COLMAP models.

pub mod camera_file;
pub mod colmap;
pub mod dataset;
mod frame;
mod json;
pub mod lens;
pub mod loader;
mod npy;
pub mod pixels;
mod resample;
#[cfg(test)]
mod tests;
pub mod transforms;

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::scene::Camera;

pub use dataset::{Dataset, DatasetKind, DatasetOptions, Points, SplitRule, TimeRule, View};
pub use loader::ImageLoader;
pub use pixels::{ImageSource, Pixels};

/// Largest image side accepted from a camera file, pixels.
pub const MAX_IMAGE_SIDE: u32 = 16_384;

/// Every [`LLFF_HOLD`]-th image of a COLMAP model is a test image (the convention of LLFF, mip-NeRF 360 and 3DGS).
pub const LLFF_HOLD: usize = 8;

/// Cameras in the order of the file.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSet {
    /// The cameras; at least one.
    pub cameras: Vec<Camera>,
    /// What was assumed, for the user to read; one line each.
    pub warnings: Vec<String>,
    /// The file or folder that was read.
    pub source: String,
}

/// Loads cameras from a `transforms*.json`, a folder with `transforms_{split}.json`, another data set ([`dataset`]), or a
/// COLMAP folder. Pictures need not be there.
///
/// - `split`: `None` means `test` for a folder of `transforms_*.json` (falling back to `transforms.json`, then to
///   `transforms_train.json`, with a warning) and all images for COLMAP. A split that is named must exist. For COLMAP,
///   `test` is every 8th image by name, `train` the others, `all` all; times are given before the split. Other data sets
///   have `train`, `test`, `val` and `all` by the rules of [`dataset`]. A single file is read whole, whatever the split.
/// - `size_override`: the image size to render at. Focal lengths and principal points in pixels are scaled with it; a
///   `camera_angle_x` keeps its meaning (square pixels). It also serves where the file gives no size.
///
/// # Errors
/// [`Error::Corrupt`] naming the frame and key (json) or byte or line (COLMAP); [`Error::Usage`] when nothing that can be
/// read is found at `path`; [`Error::Io`].
pub fn load_cameras(path: &Path, split: Option<&str>, size_override: Option<[u32; 2]>) -> Result<CameraSet> {
    if let Some(side) = size_override.into_iter().flatten().find(|s| !(1..=MAX_IMAGE_SIDE).contains(s)) {
        return Err(Error::usage("image size", side.to_string(), format!("1 to {MAX_IMAGE_SIDE} pixels")));
    }
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?;
    if !metadata.is_dir() {
        return transforms::read(path, size_override);
    }
    let (file, warning) = match transforms_in(path, split) {
        Some(found) => found,
        None if dataset::is_known(path) => return dataset::cameras(path, split, size_override),
        None => {
            return match colmap::find(path) {
                Some(model) => colmap_set(path, &model, split, size_override),
                None => Err(nothing_found(path, split)),
            };
        }
    };
    let mut set = transforms::read(&file, size_override)?;
    set.warnings.extend(warning);
    Ok(set)
}

fn transforms_in(folder: &Path, split: Option<&str>) -> Option<(PathBuf, Option<String>)> {
    let existing = |name: String| Some(folder.join(name)).filter(|p| p.is_file());
    if let Some(split) = split {
        return existing(format!("transforms_{split}.json")).map(|file| (file, None));
    }
    if let Some(file) = existing("transforms_test.json".into()) {
        return Some((file, None));
    }
    let fallback = existing("transforms.json".into()).or_else(|| existing("transforms_train.json".into()))?;
    let warning = format!("{}: no transforms_test.json, using {}", folder.display(), fallback.display());
    Some((fallback, Some(warning)))
}

fn nothing_found(folder: &Path, split: Option<&str>) -> Error {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .map(|entries| entries.flatten().filter_map(|e| e.file_name().into_string().ok()).collect())
        .unwrap_or_default();
    names.retain(|n| n.starts_with("transforms") && n.ends_with(".json"));
    names.sort();
    let found = if names.is_empty() { "none of them".into() } else { names.join(", ") };
    let wanted = format!("transforms_{}.json", split.unwrap_or("test"));
    let expected = format!(
        "{wanted}, a COLMAP model (cameras and images, .bin or .txt; also in sparse/0 or sparse), or a data set that spgs train reads"
    );
    Error::usage(format!("cameras in {}", folder.display()), found, expected)
}

fn colmap_set(data: &Path, folder: &Path, split: Option<&str>, size_override: Option<[u32; 2]>) -> Result<CameraSet> {
    let mut set = colmap::read(folder)?;
    let names: Vec<&str> = set.cameras.iter().map(|c| c.name.as_str()).collect();
    let times = dataset::colmap_times(data, &names)?;
    set.cameras.iter_mut().zip(times).for_each(|(c, t)| c.time = t);
    let test = |i: usize| i.is_multiple_of(LLFF_HOLD);
    let mut index = 0;
    let mut keep = |wanted: &dyn Fn(usize) -> bool| {
        index += 1;
        wanted(index - 1)
    };
    match split {
        None | Some("all") => {}
        Some("test") => set.cameras.retain(|_| keep(&test)),
        Some("train") => set.cameras.retain(|_| keep(&|i| !test(i))),
        Some(other) => return Err(Error::usage("split of a COLMAP model", other, "test, train or all")),
    }
    if split.is_some_and(|s| s != "all") {
        set.warnings.push(format!("{}: test images are every {LLFF_HOLD}th by name", folder.display()));
    }
    if set.cameras.is_empty() {
        return Err(Error::usage(format!("cameras in {}", folder.display()), "no image in the split", "at least one"));
    }
    if let Some([width, height]) = size_override {
        set.cameras.iter_mut().for_each(|c| *c = c.resized(width, height));
    }
    Ok(set)
}

/// Time of frame `i` of `n` where the data gives none: uniform over [0, 1].
fn uniform_time(i: usize, n: usize) -> f64 {
    if n > 1 { i as f64 / (n - 1) as f64 } else { 0.0 }
}
