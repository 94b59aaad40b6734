//! Model files and pictures, read strictly and written durably.
//!
//! | format | read | written | holds |
//! |---|---|---|---|
//! | `.safetensors` ([`model`]) | yes | yes | everything, bit for bit |
//! | 3DGS `.ply` ([`ply`]) | yes | yes | Gaussians, bit for bit |
//! | compressed `.ply` ([`ply::write_compressed`]) | yes | yes | Gaussians, 16 bytes each and SH in 8 bits |
//! | `.splat` ([`splat`]) | yes | yes | Gaussians without view-dependent colour, 32 bytes each |
//! | `.spz` ([`spz`]) | versions 2, 3, 4 | 3, 4 | Gaussians, 20 to 65 bytes each before gzip or zstd |
//! | SOG ([`sog`]) | versions 1, 2; folder, zip; levels of detail | 2, zip | Gaussians in lossless pictures |
//! | glTF ([`gltf`]) | `.glb`, `.gltf`; plain or holding `.spz` | `.glb` | Gaussians in f32, `KHR_gaussian_splatting` |
//! | training runs of SP-GS, Deformable-3DGS, 4D-GS, SC-GS ([`checkpoint`]), by a reader of PyTorch files ([`torch`]) that runs no code | yes | no | Gaussians and motion |

pub(crate) mod affine;
pub(crate) mod archive;
pub(crate) mod check;
pub mod checkpoint;
mod checksum;
pub(crate) mod codec;
pub mod describe;
pub mod durable;
mod format;
pub mod gltf;
pub mod model;
pub mod picture;
pub mod ply;
mod save;
pub mod sog;
pub mod splat;
pub mod spz;
pub mod tensors;
#[cfg(test)]
mod tests;
pub mod torch;

use std::path::Path;

use crate::error::{Error, Result};
use crate::gpu::mmap::map_file;
use crate::scene::{Gaussians, Rejected, Scene};

pub use describe::{Description, describe};
pub use format::Format;
pub use save::{Output, save, save_as};

/// A model that was read and cleaned.
#[derive(Debug, Clone, PartialEq)]
pub struct Loaded {
    /// The scene; every Gaussian in it is valid.
    pub scene: Scene,
    /// How many Gaussians of the file were dropped, by reason.
    pub rejected: Rejected,
    /// What the user should know; one line each.
    pub warnings: Vec<String>,
}

/// Loads a model of any [`Format`], told apart by content. Gaussians that cannot be rendered (NaN, zero quaternion, absurd
/// scale: [`crate::scene::Gaussians::is_valid`]) are dropped from every per-Gaussian array, counted and warned of.
///
/// # Errors
/// [`crate::Error::Corrupt`] naming the place, [`crate::Error::Limit`] for what would unpack to more than a file of its size can hold,
/// [`crate::Error::Io`], [`crate::Error::Usage`].
pub fn load(path: &Path) -> Result<Loaded> {
    let (scene, warnings) = read(path, Format::of_file(path)?)?;
    Ok(clean(scene, warnings, path))
}

/// Loads one level of detail of a model that has several ([`Format::StreamedSog`]), 0 the finest; cleaned as by [`load`].
///
/// # Errors
/// [`Error::Usage`] for a model without levels and for a level that is not there or lacks files; else as [`load`].
pub fn load_level(path: &Path, level: u32) -> Result<Loaded> {
    let format = Format::of_file(path)?;
    if format != Format::StreamedSog {
        return Err(Error::usage(format!("level of detail of {}", path.display()), format.to_string(), "streamed SOG"));
    }
    let (gaussians, warnings) = sog::read_level(path, Some(level))?;
    Ok(clean(Scene { gaussians, ..Scene::default() }, warnings, path))
}

/// What of a file [`load`] does not take without a word, one name each: further properties and elements of a `.ply`, its
/// normals where they are not 0.
///
/// # Errors
/// As [`load`].
pub fn unread(path: &Path) -> Result<Vec<String>> {
    match Format::of_file(path)? {
        Format::Ply | Format::CompressedPly => ply::unread(path),
        Format::Checkpoint => checkpoint::unread(path),
        _ => Ok(Vec::new()),
    }
}

/// Reads a model whose kind is known; nothing is judged or dropped.
fn read(path: &Path, format: Format) -> Result<(Scene, Vec<String>)> {
    let mut warnings = Vec::new();
    let mut with_warnings = |(gaussians, found): (Gaussians, Vec<String>)| {
        warnings = found;
        gaussians
    };
    let gaussians = match format {
        Format::Safetensors => return model::read(path),
        Format::Checkpoint => return checkpoint::read(path),
        Format::Torch => return checkpoint::read_weights(path),
        Format::Spz => with_warnings(spz::parse(&map_file(path)?, path)?),
        Format::Gltf => with_warnings(gltf::parse(&map_file(path)?, path)?),
        Format::StreamedSog => with_warnings(sog::read_level(path, None)?),
        Format::Ply | Format::CompressedPly => ply::read(path)?,
        Format::Splat => splat::parse(&map_file(path)?, path)?,
        Format::Sog if path.is_dir() => sog::read_folder(path)?,
        Format::Sog if path.file_name().is_some_and(|n| n == sog::META) => {
            sog::read_folder(path.parent().unwrap_or(Path::new(".")))?
        }
        Format::Sog => sog::parse(&map_file(path)?, path)?,
    };
    Ok((Scene { gaussians, ..Scene::default() }, warnings))
}

/// Drops what cannot be rendered.
fn clean(mut scene: Scene, mut warnings: Vec<String>, path: &Path) -> Loaded {
    let mut rejected = Rejected::default();
    let n = scene.gaussians.len();
    let keep: Vec<bool> = (0..n).map(|i| scene.gaussians.is_valid(i, &mut rejected)).collect();
    if rejected.total() > 0 {
        scene.retain(&keep);
        warnings.push(format!(
            "{}: {} of {n} Gaussians are skipped: {} not finite, {} with a zero rotation, {} with an absurd scale, {} out of range",
            path.display(),
            rejected.total(),
            rejected.not_finite,
            rejected.zero_rotation,
            rejected.absurd_scale,
            rejected.out_of_range
        ));
    }
    if scene.gaussians.is_empty() {
        warnings.push(format!("{}: the model has no Gaussian: images will be empty", path.display()));
    }
    Loaded { scene, rejected, warnings }
}
