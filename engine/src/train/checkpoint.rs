//! Checkpoints: everything that the next step depends on, in one durable, checksummed file of named tensors.
//!
//! Random choices are functions of the seed and the iteration, and so is the order of the images: the iteration is the state
//! of the random numbers and the data cursor.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::config::{Config, Preset};
use super::parameters::ParameterState;
use super::schedule::Stage;
use crate::error::{Error, Result};
use crate::file::tensors::{self, NamedTensor, StoredTensor, floats, indices};
use crate::scene::parameter::planes;
use crate::scene::{
    Association, DeformNetwork, DeformSize, Deformation, Gaussians, NonrigidNetwork, Scene, SuperpointDeformation,
    Superpoints,
};

/// Value of the metadata entry `format`.
const FORMAT: [&str; 2] = ["spgs-checkpoint", "1"];
/// Checkpoints that are kept.
pub const KEPT: usize = 3;

/// A network's weights and moments, flat.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NetworkState {
    /// Weights and biases, layer by layer.
    pub weights: Vec<f32>,
    /// First moments.
    pub moment_1: Vec<f32>,
    /// Second moments.
    pub moment_2: Vec<f32>,
}

/// Superpoints, association and network F.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MotionState {
    /// `[M,3]` canonical centres.
    pub position: Vec<[f32; 3]>,
    /// Association rows with K' slots.
    pub association: Association,
    /// Moments of the logits, `[N,K']` each.
    pub association_moments: [Vec<f32>; 2],
    /// Network F.
    pub network: NetworkState,
}

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
    /// Motion, once it has begun.
    pub motion: Option<MotionState>,
    /// Network G, in its stage.
    pub nonrigid: Option<NetworkState>,
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
        let (kept, later): (Vec<_>, Vec<_>) = list(folder)?.into_iter().partition(|p| *p <= path);
        for old in kept[..kept.len().saturating_sub(KEPT)].iter().chain(&later) {
            std::fs::remove_file(old).map_err(|e| Error::io(old, "remove", e))?;
        }
        Ok(path)
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
        let (p, g) = (&self.parameters, &self.parameters.gaussians);
        let (n, planes) = (g.len(), planes(g.sh_degree, g.optional.present()) as usize);
        let mut out: Vec<_> = g.arrays().into_iter().map(|(name, shape, values)| floats(name, shape, values)).collect();
        out.extend([
            floats("moment_1", vec![planes, n], &p.moment_1),
            floats("moment_2", vec![planes, n], &p.moment_2),
            floats("density", vec![2, n], &p.density),
            floats("max_radius", vec![n], &p.max_radius),
            indices("superpoint_of_gaussian", vec![n], &p.superpoint_of_gaussian),
        ]);
        if let Some(m) = &self.motion {
            let shape = vec![n, m.association.neighbors];
            out.push(floats("superpoint_position", vec![m.position.len(), 3], m.position.as_flattened()));
            out.push(indices("neighbor", shape.clone(), &m.association.neighbor));
            out.push(floats("logit", shape.clone(), &m.association.logit));
            out.push(floats("logit_moment_1", shape.clone(), &m.association_moments[0]));
            out.push(floats("logit_moment_2", shape, &m.association_moments[1]));
            out.extend(network_tensors("network_f", &m.network));
        }
        if let Some(network) = &self.nonrigid {
            out.extend(network_tensors("network_g", network));
        }
        out
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// [`Error::Corrupt`] naming the tensor or entry; [`Error::Io`].
    pub fn load(path: &Path) -> Result<Self> {
        let (tensors, metadata) = tensors::read(path, FORMAT)?;
        let mut r = Reader { tensors, path };
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
        let gaussians = Gaussians::from_arrays(sh_degree, |name, shape, required| {
            if !required && !r.has(name) { Ok(None) } else { r.shaped(name, shape).map(Some) }
        })?;
        let (n, planes) = (gaussians.len(), planes(sh_degree, gaussians.optional.present()) as usize);
        let parameters = ParameterState {
            gaussians,
            moment_1: r.floats("moment_1", Some(planes * n))?,
            moment_2: r.floats("moment_2", Some(planes * n))?,
            density: r.floats("density", Some(2 * n))?,
            max_radius: r.floats("max_radius", Some(n))?,
            superpoint_of_gaussian: r.indices("superpoint_of_gaussian", Some(n))?,
        };
        let motion = r.has("superpoint_position").then(|| motion(&mut r, n)).transpose()?;
        let nonrigid = r.has("network_g.weights").then(|| network(&mut r, "network_g")).transpose()?;
        Ok(Self { config, stage, iteration, parameters, motion, nonrigid })
    }

    /// The scene as the run has it at this moment, without the association.
    ///
    /// # Errors
    /// [`Error::Usage`] for another number of weights than the configuration's networks have.
    pub fn into_scene(self) -> Result<Scene> {
        let mut deformation = Deformation::None;
        if let Some(motion) = self.motion {
            let network = Some(motion.network.deform(self.config.motion.network_size())?);
            let of_gaussian = self.parameters.superpoint_of_gaussian;
            let superpoints = Superpoints { of_gaussian, position: motion.position };
            deformation = SuperpointDeformation { superpoints, network, ..SuperpointDeformation::default() }.into();
        }
        if let Some(network) = self.nonrigid {
            deformation = deformation.with_nonrigid(network.nonrigid()?)?;
        }
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

fn network_tensors<'a>(name: &str, n: &'a NetworkState) -> [NamedTensor<'a>; 3] {
    let shape = vec![n.weights.len()];
    [
        floats(format!("{name}.weights"), shape.clone(), &n.weights),
        floats(format!("{name}.moment_1"), shape.clone(), &n.moment_1),
        floats(format!("{name}.moment_2"), shape, &n.moment_2),
    ]
}

fn motion(r: &mut Reader<'_>, n: usize) -> Result<MotionState> {
    let neighbor = r.indices("neighbor", None)?;
    let count = neighbor.len();
    Ok(MotionState {
        position: r.floats("superpoint_position", None)?.as_chunks().0.to_vec(),
        association: Association { neighbors: count / n.max(1), neighbor, logit: r.floats("logit", Some(count))? },
        association_moments: [r.floats("logit_moment_1", Some(count))?, r.floats("logit_moment_2", Some(count))?],
        network: network(r, "network_f")?,
    })
}

fn network(r: &mut Reader<'_>, name: &str) -> Result<NetworkState> {
    let weights = r.floats(&format!("{name}.weights"), None)?;
    let count = Some(weights.len());
    let moment_1 = r.floats(&format!("{name}.moment_1"), count)?;
    Ok(NetworkState { weights, moment_1, moment_2: r.floats(&format!("{name}.moment_2"), count)? })
}

impl NetworkState {
    /// Network F with these weights.
    ///
    /// # Errors
    /// [`Error::Usage`] for another number of weights.
    pub fn deform(&self, size: DeformSize) -> Result<DeformNetwork> {
        DeformNetwork::from_flat(&self.weights, size)
    }

    /// Network G with these weights.
    ///
    /// # Errors
    /// [`Error::Usage`] for another number of weights.
    pub fn nonrigid(&self) -> Result<NonrigidNetwork> {
        NonrigidNetwork::from_flat(&self.weights)
    }
}

struct Reader<'a> {
    tensors: BTreeMap<String, StoredTensor>,
    path: &'a Path,
}

impl Reader<'_> {
    fn has(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    /// Floats of this shape, where sides are known.
    fn shaped(&mut self, name: &str, shape: &[Option<usize>]) -> Result<Vec<f32>> {
        let fits = |f: &[usize]| f.len() == shape.len() && f.iter().zip(shape).all(|(f, s)| s.is_none_or(|s| s == *f));
        if let Some(found) = self.tensors.get(name).map(|t| &t.shape).filter(|found| !fits(found)) {
            let sides: Vec<String> = shape.iter().map(|s| s.map_or("any".into(), |n| n.to_string())).collect();
            let expected = format!("F32 [{}]", sides.join(", "));
            return Err(Error::corrupt(self.path, format!("tensor `{name}`"), format!("{found:?}"), expected));
        }
        self.floats(name, None)
    }

    fn bytes(&mut self, name: &str, dtype: &str, count: Option<usize>) -> Result<Vec<u8>> {
        let expected = || count.map_or(format!("{dtype} values"), |c| format!("{c} {dtype} values"));
        let at = || format!("tensor `{name}`");
        match self.tensors.remove(name) {
            None => Err(Error::corrupt(self.path, at(), "nothing", expected())),
            Some(t) if t.dtype != dtype || count.is_some_and(|c| t.bytes.len() != 4 * c) => {
                Err(Error::corrupt(self.path, at(), format!("{} {:?}", t.dtype, t.shape), expected()))
            }
            Some(t) => Ok(t.bytes),
        }
    }

    fn floats(&mut self, name: &str, count: Option<usize>) -> Result<Vec<f32>> {
        let bytes = self.bytes(name, "F32", count)?;
        Ok(bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
    }

    fn indices(&mut self, name: &str, count: Option<usize>) -> Result<Vec<u32>> {
        let bytes = self.bytes(name, "U32", count)?;
        Ok(bytes.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect())
    }
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
