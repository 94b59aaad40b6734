//! SOG of PlayCanvas: attributes as lossless WebP pictures, one pixel per Gaussian, and `meta.json`; a folder or a zip
//! (`.sog`).
//!
//! | picture | pixel |
//! |---|---|
//! | `means_l`, `means_u` | low and high byte of 16-bit x, y, z between `mins` and `maxs`, which hold sign(x)·ln(1 + abs x) |
//! | `quats` | the three smaller parts of w,x,y,z (0 to 255 for ∓1/√2), 252 + index of the largest |
//! | `scales` | log scales: indices into `codebook` (version 2), or between `mins` and `maxs` (version 1) |
//! | `sh0` | SH degree 0 likewise; alpha is opacity ·255 (version 2), or its logit between `mins` and `maxs` (version 1) |
//! | `shN_labels` | red + 256·green: a row of the palette |
//! | `shN_centroids` | palette, 64 rows per line of pixels, a pixel per SH coefficient: codebook indices, or between `mins` and `maxs` |
//!
//! A large scene is divided into several of them, at several levels of detail: [`levels`], [`read_level`].

mod lod;
mod meta;
mod palette;
mod picture;
mod read;
#[cfg(test)]
mod tests;
mod write;

use std::path::Path;

use super::archive::{Archive, Files};
use crate::error::{Error, Result};
use crate::scene::Gaussians;

pub use lod::{Level, levels, parse_level, read_level};
pub use write::write;

pub(crate) use lod::{LOD_META, lod_prefix};

/// Name of the description.
pub(crate) const META: &str = "meta.json";

/// Reads a SOG folder. Values are not judged here (see [`crate::file::load`]).
///
/// # Errors
/// [`Error::Corrupt`] naming the file and entry, [`Error::Io`], [`Error::Limit`].
pub fn read_folder(folder: &Path) -> Result<Gaussians> {
    read::read(&mut Files::Folder(folder.to_path_buf()), "", folder)
}

/// Reads a zipped SOG (`.sog`), from memory; `path` only names it in errors.
///
/// # Errors
/// As [`read_folder`].
pub fn parse(bytes: &[u8], path: &Path) -> Result<Gaussians> {
    let archive = Archive::open(bytes, path)?;
    let Some(prefix) = prefix(&archive.names()) else {
        return Err(Error::corrupt(path, "zip directory", "no `meta.json`", "a SOG archive"));
    };
    read::read(&mut Files::Zip(archive, prefix), "", path)
}

/// The folder within an archive that holds `meta.json`.
pub(crate) fn prefix(names: &[String]) -> Option<String> {
    prefix_of(META, names)
}

/// The folder within an archive that holds a file, the outermost one.
fn prefix_of(file: &str, names: &[String]) -> Option<String> {
    let found = names.iter().filter(|n| n.rsplit('/').next() == Some(file)).min_by_key(|n| n.len())?;
    Some(found[..found.len() - file.len()].to_owned())
}

/// How centres are stretched before they are stored: fine near 0, coarse far away.
fn stretch(v: f64) -> f64 {
    v.signum() * v.abs().ln_1p()
}

/// Inverse of [`stretch`].
fn unstretch(v: f64) -> f64 {
    v.signum() * v.abs().exp_m1()
}
