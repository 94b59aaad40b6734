//! A [`Scene`] to tensors by name.

use std::path::Path;

use super::{ANTIALIASED, FORMAT, VERSION, deformation};
use crate::error::Result;
use crate::file::check;
use crate::file::tensors::{self, NamedTensor, floats};
use crate::scene::Scene;

/// Writes a model, durably. Equal scenes give equal bytes: tensors are in the order of their names.
///
/// ```
/// use engine::file::model;
/// use engine::scene::{Gaussians, Motion, Scene, SuperpointDeformation, Superpoints};
///
/// let superpoints = Superpoints { of_gaussian: vec![0], position: vec![[0.0; 3]] };
/// let table = Motion {
///     times: vec![0.0, 1.0],
///     rotation: vec![[0.0; 3]; 2],
///     translation: vec![[0.0; 3], [1.0, 0.0, 0.0]], // moves one unit along x
/// };
/// let scene = Scene {
///     gaussians: Gaussians {
///         mean: vec![[0.0; 3]],
///         log_scale: vec![[-2.0; 3]],
///         rotation: vec![[1.0, 0.0, 0.0, 0.0]],
///         opacity_logit: vec![2.0],
///         sh_degree: 0,
///         sh: vec![1.0; 3],
///         ..Gaussians::default()
///     },
///     deformation: SuperpointDeformation::of_table(superpoints, table).into(),
///     ..Scene::default()
/// };
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("moving.safetensors");
/// model::write(&path, &scene)?;
/// assert_eq!(model::read(&path)?.0, scene);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`crate::Error::Usage`] naming the tensor when the scene is inconsistent; [`crate::Error::Io`].
pub fn write(path: &Path, scene: &Scene) -> Result<()> {
    check::scene(scene).map_err(|problem| problem.usage(path))?;
    let mut metadata = scene.metadata.clone();
    if scene.gaussians.antialiased {
        metadata.insert(ANTIALIASED.into(), "true".into());
    }
    tensors::write(path, [FORMAT, VERSION], tensors(scene), &metadata)
}

fn tensors(scene: &Scene) -> Vec<NamedTensor<'_>> {
    let g = &scene.gaussians;
    let n = g.len();
    let array = |(name, shape, values)| floats(format!("gaussians.{name}"), shape, values);
    let mut out: Vec<_> = g.arrays().into_iter().map(array).collect();
    out.extend(deformation::tensors(&scene.deformation, n));
    out.extend(scene.extra.iter().map(|(name, tensor)| floats(name.as_str(), tensor.shape.clone(), &tensor.data)));
    out
}
