//! Folders of pictures.

use std::path::{Path, PathBuf};

use super::views::stored_factor;
use crate::data::colmap::natural_order;
use crate::error::{Error, Result};

/// Extensions of pictures.
pub(super) const EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "JPG", "PNG", "JPEG"];

/// `images` and the `images_K` folders, as (K, folder), K ascending; 1 for `images`.
fn levels(folder: &Path) -> Vec<(u32, PathBuf)> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let level = |path: PathBuf| {
        let name = path.file_name()?.to_str()?;
        let factor = if name == "images" { 1 } else { name.strip_prefix("images_")?.parse().ok()? };
        (factor > 0 && path.is_dir()).then_some((factor, path))
    };
    let mut levels: Vec<_> = entries.flatten().filter_map(|e| level(e.path())).collect();
    levels.sort();
    levels
}

/// The folder that serves a downscale best, and how many times smaller its pictures are; `images` if there is none.
pub(super) fn level(folder: &Path, downscale: u32) -> (PathBuf, u32) {
    let levels = levels(folder);
    let factors: Vec<u32> = levels.iter().map(|l| l.0).collect();
    let wanted = stored_factor(&factors, downscale);
    match levels.into_iter().find(|l| Some(l.0) == wanted) {
        Some((factor, path)) => (path, factor),
        None => (folder.join("images"), 1),
    }
}

/// All pictures of that folder in natural order; none where the folder is absent.
pub(super) fn listed(folder: &Path, downscale: u32) -> Result<(Vec<PathBuf>, u32)> {
    let (folder, factor) = level(folder, downscale);
    if !folder.is_dir() {
        return Ok((Vec::new(), factor));
    }
    let entries = std::fs::read_dir(&folder).map_err(|e| Error::io(&folder, "list", e))?;
    let is_picture = |p: &PathBuf| p.extension().is_some_and(|e| EXTENSIONS.iter().any(|x| e == *x));
    let mut pictures: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(is_picture).collect();
    pictures.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok((pictures, factor))
}
