//! Writing a model in the format of its file name.

use std::borrow::Cow;
use std::path::Path;

use super::{gltf, model, ply, sog, splat, spz};
use crate::error::{Error, Result};
use crate::scene::Scene;
use crate::scene::parameter::{PARAMETERS, SMOOTHING};

/// Formats that can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Output {
    /// `.safetensors`.
    Safetensors,
    /// `.ply`.
    Ply,
    /// `.compressed.ply`.
    CompressedPly,
    /// `.splat`.
    Splat,
    /// `.spz`; version 3 unless said.
    Spz(spz::Version),
    /// `.sog`.
    Sog,
    /// `.glb`.
    Gltf,
}

/// File name endings; longer ones first.
const ENDINGS: [(&str, Output); 7] = [
    (".compressed.ply", Output::CompressedPly),
    (".ply", Output::Ply),
    (".safetensors", Output::Safetensors),
    (".splat", Output::Splat),
    (".spz", Output::Spz(spz::Version::Three)),
    (".sog", Output::Sog),
    (".glb", Output::Gltf),
];

impl Output {
    /// By the end of the file name.
    ///
    /// # Errors
    /// [`Error::Usage`] for another ending.
    pub fn of_name(path: &Path) -> Result<Self> {
        let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        match ENDINGS.iter().find(|(ending, _)| name.ends_with(ending)) {
            Some((_, output)) => Ok(*output),
            None => {
                let found = path.extension().map_or("no extension".into(), |e| format!(".{}", e.to_string_lossy()));
                let expected = ".safetensors, .ply, .compressed.ply, .splat, .spz, .sog or .glb";
                Err(Error::usage(format!("model file {}", path.display()), found, expected))
            }
        }
    }

    /// The file name ending.
    pub fn ending(self) -> &'static str {
        ENDINGS
            .iter()
            .find(|(_, output)| std::mem::discriminant(output) == std::mem::discriminant(&self))
            .map_or("", |(ending, _)| ending)
    }

    /// Whether everything of a scene is kept, motion included.
    pub fn holds_motion(self) -> bool {
        self == Self::Safetensors
    }
}

/// Writes a model in the format of the file name's ending, durably. Returns warnings: what the format cannot hold.
///
/// # Errors
/// [`Error::Usage`] for another ending or an inconsistent scene; [`Error::Limit`] for values that the format cannot hold;
/// [`Error::Io`].
pub fn save(path: &Path, scene: &Scene) -> Result<Vec<String>> {
    let output = Output::of_name(path)?;
    let lost = save_as(path, scene, output)?;
    let warning = || format!("{}: a {} cannot hold {}: left out", path.display(), output.ending(), lost.join(", "));
    Ok(if lost.is_empty() { Vec::new() } else { vec![warning()] })
}

/// Writes a model in a format, durably. Returns what the format cannot hold, one name each.
///
/// # Errors
/// As [`save`].
pub fn save_as(path: &Path, scene: &Scene, output: Output) -> Result<Vec<String>> {
    let mut gaussians = Cow::Borrowed(&scene.gaussians);
    if !output.holds_motion() && scene.gaussians.optional.present().has(SMOOTHING) {
        gaussians.to_mut().fold_smoothing();
    }
    match output {
        Output::Safetensors => model::write(path, scene)?,
        Output::Ply => ply::write(path, &gaussians)?,
        Output::CompressedPly => ply::write_compressed(path, &gaussians)?,
        Output::Splat => splat::write(path, &gaussians)?,
        Output::Spz(version) => spz::write(path, &gaussians, version)?,
        Output::Sog => sog::write(path, &gaussians)?,
        Output::Gltf => gltf::write(path, &gaussians)?,
    }
    Ok(lost(output, scene))
}

/// What of a scene a format leaves out.
fn lost(output: Output, scene: &Scene) -> Vec<String> {
    if output.holds_motion() {
        return Vec::new();
    }
    let degree = scene.gaussians.sh_degree;
    let mut lost = Vec::new();
    if output == Output::Splat && degree > 0 {
        lost.push(format!("SH degrees 1 to {degree}"));
    }
    let left_out = scene.gaussians.optional.present().iter().filter(|parameter| *parameter != SMOOTHING);
    lost.extend(left_out.map(|parameter| format!("{}s", PARAMETERS[parameter].name)));
    if scene.gaussians.antialiased && !matches!(output, Output::Spz(_)) {
        lost.push("that it is antialiased".into());
    }
    lost.extend(scene.deformation.parts().into_iter().map(String::from));
    lost.extend((!scene.extra.is_empty()).then(|| "further tensors".into()));
    lost.extend((!scene.metadata.is_empty()).then(|| "metadata".into()));
    lost
}
