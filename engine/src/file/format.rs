//! Which kind of model a file or folder is, by content.

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::archive::{Archive, ZIP};
use super::{checkpoint, gltf, ply, sog, splat, spz, torch};
use crate::error::{Error, Result};
use crate::gpu::mmap::map_file;

/// Kinds of model files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Format {
    /// 3DGS `.ply`: static.
    Ply,
    /// Compressed `.ply` of PlayCanvas and SuperSplat: static.
    CompressedPly,
    /// `.splat`: static, without view-dependent colour.
    Splat,
    /// `.spz`: static.
    Spz,
    /// SOG, a folder with `meta.json` or a zip: static.
    Sog,
    /// SOG at several levels of detail, a folder with `lod-meta.json` or a zip: static.
    StreamedSog,
    /// glTF with `KHR_gaussian_splatting` (`.glb`, `.gltf`): static.
    Gltf,
    /// The output folder of a PyTorch training run: SP-GS, Deformable-3DGS, 4D-GS, SC-GS, 3DGS.
    Checkpoint,
    /// PyTorch weights (`.pth`) alone.
    Torch,
    /// The engine's own model.
    Safetensors,
}

/// Bytes that are looked at: more than the header of any compressed `.ply`.
const HEAD: u64 = 4096;

impl Format {
    /// By content; the extension only decides where content cannot.
    ///
    /// # Errors
    /// [`Error::Corrupt`] for anything else, [`Error::Io`].
    pub fn of_file(path: &Path) -> Result<Self> {
        let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?;
        if metadata.is_dir() {
            return Self::of_folder(path).ok_or_else(|| {
                let expected = "a SOG folder (meta.json or lod-meta.json) or a training run's (point_cloud/iteration_N/point_cloud.ply)";
                Error::corrupt(path, "folder", "no model", expected)
            });
        }
        let mut head = Vec::new();
        let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
        file.take(HEAD).read_to_end(&mut head).map_err(|e| Error::io(path, "read", e))?;
        let is_named = |extension: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
        if head.starts_with(b"ply\n") || head.starts_with(b"ply\r") {
            return Ok(if ply::is_compressed(&head) { Self::CompressedPly } else { Self::Ply });
        }
        if head.starts_with(&spz::GZIP) || head.starts_with(&spz::MAGIC) {
            return Ok(Self::Spz);
        }
        if head.starts_with(&gltf::MAGIC) {
            return Ok(Self::Gltf);
        }
        if head.starts_with(&ZIP) {
            return Self::of_zip(path);
        }
        // A safetensors file begins with the header's length (u64, below 100 MB) and an opening brace.
        if (head.len() >= 9 && head[4..8] == [0; 4] && head[8] == b'{') || is_named("safetensors") {
            return Ok(Self::Safetensors);
        }
        let is_json = head.trim_ascii_start().starts_with(b"{");
        if is_json && is_named("gltf") {
            return Ok(Self::Gltf);
        }
        if is_json && path.file_name().is_some_and(|n| n == sog::META) {
            return Ok(Self::Sog);
        }
        if is_json && path.file_name().is_some_and(|n| n == sog::LOD_META) {
            return Ok(Self::StreamedSog);
        }
        if is_named("splat") || splat::is_plausible(&head, metadata.len()) {
            return Ok(Self::Splat);
        }
        let found = format!("{:?}", head[..head.len().min(9)].escape_ascii().to_string());
        let expected = "a .safetensors model, a .ply, .splat, .spz, .sog, .glb, .gltf or .pth";
        Err(Error::corrupt(path, "byte 0", found, expected))
    }

    fn of_zip(path: &Path) -> Result<Self> {
        let bytes = map_file(path)?;
        let names = Archive::open(&bytes, path)?.names();
        // Each part of a scene with levels of detail has a `meta.json` of its own.
        if sog::lod_prefix(&names).is_some() {
            return Ok(Self::StreamedSog);
        }
        if sog::prefix(&names).is_some() {
            return Ok(Self::Sog);
        }
        if torch::prefix(&names).is_some() {
            return Ok(Self::Torch);
        }
        let found = format!("a zip of {} entries without them", names.len());
        Err(Error::corrupt(path, "zip directory", found, "`meta.json` (SOG) or `data.pkl` (PyTorch)"))
    }

    /// The kind of model that a folder holds, if it does.
    pub fn of_folder(path: &Path) -> Option<Self> {
        if checkpoint::is_run(path) {
            return Some(Self::Checkpoint);
        }
        let has = |name: &str| path.join(name).is_file();
        if has(sog::META) { Some(Self::Sog) } else { has(sog::LOD_META).then_some(Self::StreamedSog) }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => "3DGS .ply",
            Self::CompressedPly => "compressed .ply",
            Self::Splat => ".splat",
            Self::Spz => ".spz",
            Self::Sog => "SOG",
            Self::StreamedSog => "streamed SOG",
            Self::Gltf => "glTF KHR_gaussian_splatting",
            Self::Checkpoint => "training run",
            Self::Torch => "PyTorch .pth",
            Self::Safetensors => "spgs .safetensors model",
        })
    }
}
