//! Output folders of PyTorch training runs: SP-GS, Deformable-3DGS, 4D-GS, SC-GS and plain 3DGS.
//!
//! All keep `point_cloud/iteration_N/point_cloud.ply`, the Gaussians at rest. What moves them differs:
//!
//! | run | weights | becomes |
//! |---|---|---|
//! | SP-GS, so(3) | `deform/iteration_N/deform.pth` | its own superpoints, key-time table, association and network F; network G from `fine_deform/…` |
//! | SP-GS before 2025, quaternions added | the same | a table of one pose per Gaussian at the run's own times |
//! | Deformable-3DGS | `deform/iteration_N/deform.pth` | a deformation field ([`crate::scene::field`]) |
//! | 4D-GS | `point_cloud/iteration_N/deformation.pth` | the same |
//! | SC-GS | `deform/iteration_N/deform.pth` | the same |
//!
//! The newest iteration is taken. Weights are read by [`super::torch`], which runs no code.

mod deformable;
mod four_d;
mod sc_gs;
mod sp_gs;

use std::path::{Path, PathBuf};

use super::check::{self, Problem};
use super::torch::Weights;
use super::{model, ply};
use crate::error::{Error, Result};
use crate::gpu::mmap::map_file;
use crate::scene::Scene;

/// A scene and warnings.
type Read = Result<(Scene, Vec<String>)>;

/// What weights are of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    SpGs,
    SpGsFine,
    Deformable,
    FourD,
    ScGs,
}

impl Kind {
    /// By the names of the tensors.
    fn of(weights: &Weights<'_>) -> Option<Self> {
        let has = |name| weights.has(name);
        Some(match () {
            () if has("1.sp_xyz") && has("0.gaussian_warp.weight") => Self::SpGs,
            () if has("nodes") && has("_node_radius") => Self::ScGs,
            () if has("deformation_net.grid.aabb") => Self::FourD,
            () if weights.shape("linear.0.weight").is_some_and(|s| s == [64, 84]) => Self::SpGsFine,
            () if has("linear.0.weight") && has("gaussian_rotation.weight") => Self::Deformable,
            () => return None,
        })
    }

    fn name(self) -> &'static str {
        match self {
            Self::SpGs => "SP-GS: network F, superpoints, association",
            Self::SpGsFine => "SP-GS: network G",
            Self::Deformable => "Deformable-3DGS: deformation network",
            Self::FourD => "4D-GS: deformation field",
            Self::ScGs => "SC-GS: control nodes",
        }
    }
}

/// Whether a folder is that of a run.
pub(crate) fn is_run(path: &Path) -> bool {
    newest(&path.join("point_cloud"), "point_cloud.ply").is_some()
}

/// The newest `iteration_N` of a folder that holds `file`, and N.
fn newest(folder: &Path, file: &str) -> Option<(u64, PathBuf)> {
    let entries = std::fs::read_dir(folder).ok()?.flatten();
    let iteration = |e: std::fs::DirEntry| {
        let n = e.file_name().to_str()?.strip_prefix("iteration_")?.parse::<u64>().ok()?;
        let path = e.path().join(file);
        path.is_file().then_some((n, path))
    };
    entries.filter_map(iteration).max()
}

/// The file of an iteration, or the newest there is.
fn of_iteration(folder: &Path, iteration: u64, file: &str) -> Option<(u64, PathBuf)> {
    let exact = folder.join(format!("iteration_{iteration}")).join(file);
    if exact.is_file() { Some((iteration, exact)) } else { newest(folder, file) }
}

/// What of a run's Gaussians is not taken, one name each.
///
/// # Errors
/// As [`ply::unread`].
pub fn unread(path: &Path) -> Result<Vec<String>> {
    let Some((_, cloud)) = newest(&path.join("point_cloud"), "point_cloud.ply") else { return Ok(Vec::new()) };
    let mut unread = ply::unread(&cloud)?;
    // What SC-GS chooses control nodes by.
    unread.retain(|name| !name.starts_with("property `fea_"));
    Ok(unread)
}

/// Reads the newest iteration of a run.
///
/// # Errors
/// [`Error::Corrupt`] naming file and tensor, [`Error::Usage`] for motion that cannot be played, [`Error::Io`].
pub fn read(path: &Path) -> Read {
    let (iteration, cloud) = newest(&path.join("point_cloud"), "point_cloud.ply").ok_or_else(|| {
        Error::corrupt(path, "folder", "no point_cloud/iteration_N/point_cloud.ply", "the folder of a training run")
    })?;
    let mut scene = Scene { gaussians: ply::read(&cloud)?, ..Scene::default() };
    let mut warnings = Vec::new();
    let beside = cloud.with_file_name("deformation.pth");
    let deform = of_iteration(&path.join("deform"), iteration, "deform.pth");
    let source = if beside.is_file() { Some((iteration, beside)) } else { deform };
    let Some((weights_iteration, file)) = source else {
        warnings.push(format!("{}: no weights of motion (deform.pth): the scene stands still", path.display()));
        return Ok((scene, warnings));
    };
    if weights_iteration != iteration {
        let (found, name) = (weights_iteration, file.display());
        warnings.push(format!("{name}: of iteration {found}, the Gaussians of {iteration}"));
    }
    let bytes = map_file(&file)?;
    let weights = Weights::parse(&bytes, &file)?;
    let unsupported = |found: &str| {
        let expected = "motion of SP-GS, Deformable-3DGS, 4D-GS or SC-GS; its Gaussians alone are in point_cloud.ply";
        Error::usage(format!("{}: motion", file.display()), found, expected)
    };
    match Kind::of(&weights) {
        Some(Kind::SpGs) => sp_gs::apply(&mut scene, &weights, &file, &mut warnings)?,
        Some(Kind::Deformable) => scene.deformation = deformable::read(&weights, "", &file)?.into(),
        Some(Kind::FourD) => scene.deformation = four_d::read(&weights, &file)?.into(),
        Some(Kind::ScGs) => {
            let features = ply::numbered(&cloud, "fea_")?;
            scene.deformation = sc_gs::read(&weights, &scene.gaussians, &features, &file)?.into();
        }
        Some(Kind::SpGsFine) => return Err(unsupported(Kind::SpGsFine.name())),
        None => return Err(unsupported("weights of no known method")),
    }
    if let Some((_, fine)) = of_iteration(&path.join("fine_deform"), iteration, "deform.pth") {
        let bytes = map_file(&fine)?;
        let network = sp_gs::nonrigid(&Weights::parse(&bytes, &fine)?, &fine)?;
        let rigid = std::mem::take(&mut scene.deformation);
        scene.deformation = rigid.with_nonrigid(network).map_err(|e| Problem::from(e).corrupt(&file))?;
    }
    scene
        .metadata
        .insert("source".into(), format!("{}, iteration {iteration}", Kind::of(&weights).map_or("", Kind::name)));
    check::scene(&scene).map_err(|problem| problem.corrupt(&file))?;
    Ok((scene, warnings))
}

/// Reads the run that weights belong to, when they lie in one.
///
/// # Errors
/// As [`read`]; [`Error::Usage`] for weights alone, which have no Gaussians.
pub fn read_weights(path: &Path) -> Read {
    // <run>/deform/iteration_N/deform.pth, <run>/point_cloud/iteration_N/deformation.pth
    match path.ancestors().nth(3).filter(|run| is_run(run)) {
        Some(run) => read(run),
        None => {
            let bytes = map_file(path)?;
            let kind = Kind::of(&Weights::parse(&bytes, path)?).map_or("weights of no known method", Kind::name);
            let expected = "the folder of the run, with point_cloud/iteration_N/point_cloud.ply";
            Err(Error::usage(path.display().to_string(), format!("{kind}, without Gaussians"), expected))
        }
    }
}

/// Says what weights are of, and their tensors.
///
/// # Errors
/// [`Error::Corrupt`], [`Error::Io`].
pub(crate) fn describe_weights(path: &Path) -> Result<(String, Vec<model::TensorInfo>)> {
    let bytes = map_file(path)?;
    let weights = Weights::parse(&bytes, path)?;
    let kind = Kind::of(&weights).map_or("weights of no known method", Kind::name);
    Ok((kind.to_owned(), weights.describe()))
}
