//! Model files (`.safetensors`, 3DGS `.ply`) and pictures, read strictly and written durably.

pub(crate) mod check;
mod checksum;
pub mod describe;
pub mod durable;
pub mod model;
pub mod picture;
pub mod ply;
pub mod tensors;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};
use crate::scene::gaussians::retain_chunks;
use crate::scene::{Rejected, Scene};

pub use describe::{Description, describe};

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

/// Kinds of model files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// 3DGS `.ply`: static.
    Ply,
    /// The engine's own model.
    Safetensors,
}

impl Format {
    /// By the file's first bytes; the extension does not matter.
    fn of_file(path: &Path) -> Result<Self> {
        let mut head = Vec::new();
        let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
        file.take(9).read_to_end(&mut head).map_err(|e| Error::io(path, "read", e))?;
        if head.starts_with(b"ply\n") || head.starts_with(b"ply\r") {
            return Ok(Self::Ply);
        }
        // A safetensors file begins with the header's length (u64, below 100 MB) and an opening brace.
        let is_named = |extension: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
        if (head.len() == 9 && head[4..8] == [0; 4] && head[8] == b'{') || is_named("safetensors") {
            return Ok(Self::Safetensors);
        }
        let found = format!("{:?}", head.escape_ascii().to_string());
        Err(Error::corrupt(path, "byte 0", found, "a .safetensors model or a 3DGS .ply"))
    }
}

/// Loads a model of either format, told apart by content. Gaussians that cannot be rendered (NaN, zero quaternion, absurd
/// scale: [`crate::scene::Gaussians::is_valid`]) are dropped from every per-Gaussian array, counted and warned of.
///
/// # Errors
/// [`Error::Corrupt`] naming the place, [`Error::Io`], [`Error::Usage`].
pub fn load(path: &Path) -> Result<Loaded> {
    let (scene, warnings) = match Format::of_file(path)? {
        Format::Ply => (Scene { gaussians: ply::read(path)?, ..Scene::default() }, Vec::new()),
        Format::Safetensors => model::read(path)?,
    };
    Ok(clean(scene, warnings, path))
}

/// Writes a model in the format of the extension, durably. Returns warnings: what the format cannot hold.
///
/// # Errors
/// [`Error::Usage`] for another extension or an inconsistent scene; [`Error::Io`].
pub fn save(path: &Path, scene: &Scene) -> Result<Vec<String>> {
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    match extension.as_deref() {
        Some("safetensors") => model::write(path, scene).map(|()| Vec::new()),
        Some("ply") => {
            ply::write(path, &scene.gaussians)?;
            let lost: Vec<&str> = [
                ("superpoints", scene.superpoints.is_some()),
                ("motion", scene.motion.is_some()),
                ("association", scene.association.is_some()),
                ("network F", scene.deform.is_some()),
                ("network G", scene.nonrigid.is_some()),
                ("further tensors", !scene.extra.is_empty()),
                ("metadata", !scene.metadata.is_empty()),
            ]
            .into_iter()
            .filter_map(|(name, is_there)| is_there.then_some(name))
            .collect();
            let warning = || format!("{}: a .ply cannot hold {}: left out", path.display(), lost.join(", "));
            Ok(if lost.is_empty() { Vec::new() } else { vec![warning()] })
        }
        other => {
            let found = other.map_or("no extension".into(), |e| format!(".{e}"));
            Err(Error::usage(format!("model file {}", path.display()), found, ".safetensors or .ply"))
        }
    }
}

/// Drops what cannot be rendered.
fn clean(mut scene: Scene, mut warnings: Vec<String>, path: &Path) -> Loaded {
    let mut rejected = Rejected::default();
    let n = scene.gaussians.len();
    let keep: Vec<bool> = (0..n).map(|i| scene.gaussians.is_valid(i, &mut rejected)).collect();
    if rejected.total() > 0 {
        retain(&mut scene, &keep);
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

/// Keeps some Gaussians, with all that belongs to them.
fn retain(scene: &mut Scene, keep: &[bool]) {
    scene.gaussians.retain(keep);
    if let Some(superpoints) = &mut scene.superpoints {
        retain_chunks(&mut superpoints.of_gaussian, 1, keep);
    }
    if let Some(association) = &mut scene.association {
        retain_chunks(&mut association.neighbor, association.neighbors, keep);
        retain_chunks(&mut association.logit, association.neighbors, keep);
    }
    let per_gaussian = scene
        .extra
        .iter_mut()
        .filter(|(name, t)| name.starts_with("gaussians.") && t.shape.first() == Some(&keep.len()));
    for (_, tensor) in per_gaussian {
        let width: usize = tensor.shape[1..].iter().product();
        if width > 0 {
            retain_chunks(&mut tensor.data, width, keep);
        }
        tensor.shape[0] = keep.iter().filter(|&&k| k).count();
    }
}
