//! Checkpoints: everything that the next step depends on, in one durable, checksummed file of named tensors.
//!
//! Random choices are functions of the seed and the iteration, and so is the order of the images: the iteration is the state
//! of the random numbers and the data cursor. A window of times opens by what it saw, and has a state of its own.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::config::{Config, Preset};
use super::deformation;
use super::parameters::ParameterState;
use super::saved::{Saved, Stored};
use super::schedule::Stage;
use crate::error::{Error, Result};
use crate::file::check::Problem;
use crate::file::tensors::{self, NamedTensor, floats, indices};
use crate::scene::parameter::planes;
use crate::scene::{Gaussians, Scene};

/// Value of the metadata entry `format`.
const FORMAT: [&str; 2] = ["spgs-checkpoint", "1"];
/// Checkpoints that are kept.
pub const KEPT: usize = 3;

/// Everything that the next step depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// The configuration, as given (not scaled).
    pub config: Config,
    /// Stage.
    pub stage: Stage,
    /// Iterations done in the stage.
    pub iteration: u64,
    /// Gaussians with moments and statistics.
    pub parameters: ParameterState,
    /// What the model of motion and the window of times keep, as their modules write it.
    pub saved: Saved,
}

impl Checkpoint {
    /// Writes the checkpoint durably into `folder` as `checkpoint-{stage}-{iteration}.safetensors`; then removes all but the
    /// newest three, and those of later iterations: they are of a run that was given up for this one, and resuming must
    /// not go on with them.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn save(&self, folder: &Path) -> Result<PathBuf> {
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "make folder", e))?;
        let stage = if self.stage == Stage::Nonrigid { 2 } else { 1 };
        let path = folder.join(format!("checkpoint-{stage}-{:09}.safetensors", self.iteration));
        tensors::write(&path, FORMAT, self.tensors(), &self.metadata()?)?;
        for later in list(folder)?.iter().filter(|p| **p > path) {
            remove(later)?;
        }
        Self::remove_old(folder, &path)?;
        Ok(path)
    }

    /// Removes all but the newest three of the checkpoints up to `newest`. A kill may have come between a checkpoint and
    /// the removal of the oldest, and a run that goes on from its last iteration writes none that would make up for it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn remove_old(folder: &Path, newest: &Path) -> Result<()> {
        let mut kept = list(folder)?;
        kept.retain(|p| p.as_path() <= newest);
        kept[..kept.len().saturating_sub(KEPT)].iter().try_for_each(|old| remove(old))
    }

    fn metadata(&self) -> Result<BTreeMap<String, String>> {
        let stage = serde_json::to_string(&self.stage).unwrap_or_default();
        Ok(BTreeMap::from([
            ("config".into(), self.config.to_toml()?),
            ("stage".into(), stage),
            ("iteration".into(), self.iteration.to_string()),
            ("sh_degree".into(), self.parameters.gaussians.sh_degree.to_string()),
        ]))
    }

    fn tensors(&self) -> Vec<NamedTensor<'_>> {
        let mut out = parameter_tensors(&self.parameters);
        out.extend(self.saved.tensors());
        out
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// [`Error::Corrupt`] naming the tensor or entry; [`Error::Io`].
    pub fn load(path: &Path) -> Result<Self> {
        let (tensors, metadata) = tensors::read(path, FORMAT)?;
        let entry = |key: &str| {
            let missing = || Error::corrupt(path, format!("metadata entry `{key}`"), "nothing", "it");
            metadata.get(key).cloned().ok_or_else(missing)
        };
        let wrong =
            |key: &str, found: String| Error::corrupt(path, format!("metadata entry `{key}`"), found, "a valid value");
        let config = Config::parse(&entry("config")?, Preset::default(), path)?;
        let stage = serde_json::from_str(&entry("stage")?).map_err(|e| wrong("stage", e.to_string()))?;
        let iteration = entry("iteration")?.parse().map_err(|_| wrong("iteration", "no number".into()))?;
        let sh_degree: u32 = entry("sh_degree")?.parse().map_err(|_| wrong("sh_degree", "no number".into()))?;
        if sh_degree > 3 {
            return Err(wrong("sh_degree", sh_degree.to_string()));
        }
        let in_file = |error: Error| Problem::from(error).corrupt(path);
        let (parameters, saved) =
            parameters(Saved(tensors), sh_degree, config.gaussians.antialiased).map_err(in_file)?;
        let checkpoint = Self { config, stage, iteration, parameters, saved };
        // What it moves by is read for its errors.
        deformation::of_checkpoint(&checkpoint.stored()).map_err(in_file)?;
        Ok(checkpoint)
    }

    /// What the model of motion goes on from.
    pub(super) fn stored(&self) -> Stored<'_> {
        Stored { config: &self.config, parameters: &self.parameters, saved: &self.saved }
    }

    /// The scene as the run has it at this moment, without the association.
    ///
    /// # Errors
    /// [`Error::Usage`] for another number of weights than the configuration's networks have.
    pub fn into_scene(self) -> Result<Scene> {
        let deformation = deformation::of_checkpoint(&self.stored())?;
        Ok(Scene { gaussians: self.parameters.gaussians, deformation, ..Scene::default() })
    }

    /// The newest checkpoint in `folder` that can be read, and what was wrong with newer ones. `None`: there is none.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be listed; the newest one's error when none can be read.
    pub fn newest(folder: &Path) -> Result<Option<(Self, PathBuf, Vec<String>)>> {
        let mut problems = Vec::new();
        let mut first_error = None;
        for path in list(folder)?.into_iter().rev() {
            match Self::load(&path) {
                Ok(checkpoint) => return Ok(Some((checkpoint, path, problems))),
                Err(e) => {
                    problems.push(e.to_string());
                    first_error.get_or_insert(e);
                }
            }
        }
        first_error.map_or(Ok(None), Err)
    }
}

/// The Gaussians' part.
fn parameter_tensors(p: &ParameterState) -> Vec<NamedTensor<'_>> {
    let g = &p.gaussians;
    let (n, planes) = (g.len(), planes(g.sh_degree, g.optional.present()) as usize);
    let mut out: Vec<_> = g.arrays().into_iter().map(|(name, shape, values)| floats(name, shape, values)).collect();
    out.extend([
        floats("moment_1", vec![planes, n], &p.moment_1),
        floats("moment_2", vec![planes, n], &p.moment_2),
        floats("density", vec![2, n], &p.density),
        floats("max_radius", vec![n], &p.max_radius),
        indices("superpoint_of_gaussian", vec![n], &p.superpoint_of_gaussian),
    ]);
    out
}

/// The Gaussians' part, and what is left.
fn parameters(mut saved: Saved, sh_degree: u32, antialiased: bool) -> Result<(ParameterState, Saved)> {
    let gaussians = Gaussians::from_arrays(sh_degree, |name, shape, required| {
        if !required && !saved.has(name) { Ok(None) } else { saved.shaped(name, shape).map(Some) }
    })?;
    let gaussians = Gaussians { antialiased, ..gaussians };
    let (n, planes) = (gaussians.len(), planes(sh_degree, gaussians.optional.present()) as usize);
    let parameters = ParameterState {
        moment_1: saved.floats("moment_1", Some(planes * n))?,
        moment_2: saved.floats("moment_2", Some(planes * n))?,
        density: saved.floats("density", Some(2 * n))?,
        max_radius: saved.floats("max_radius", Some(n))?,
        superpoint_of_gaussian: saved.indices("superpoint_of_gaussian", Some(n))?,
        gaussians,
    };
    let own = parameter_tensors(&parameters);
    own.iter().for_each(|tensor| drop(saved.0.remove(tensor.name.as_ref())));
    Ok((parameters, saved))
}

fn remove(path: &Path) -> Result<()> {
    std::fs::remove_file(path).map_err(|e| Error::io(path, "remove", e))
}

/// The checkpoints in a folder, oldest first.
fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = match std::fs::read_dir(folder) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => other.map_err(|e| Error::io(folder, "list", e))?,
    };
    let name_fits = |p: &PathBuf| {
        let name = p.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        name.starts_with("checkpoint-") && name.ends_with(".safetensors")
    };
    let mut all: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(name_fits).collect();
    all.sort();
    Ok(all)
}
