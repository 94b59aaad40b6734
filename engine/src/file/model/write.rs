//! A [`Scene`] to tensors by name.

use std::path::Path;

use super::{FORMAT, VERSION};
use crate::error::Result;
use crate::file::check;
use crate::file::tensors::{self, NamedTensor, floats, indices};
use crate::scene::field::{DeformationField, FieldInput};
use crate::scene::{Linear, Scene};

/// Writes a model, durably. Equal scenes give equal bytes: tensors are in the order of their names.
///
/// ```
/// use engine::file::model;
/// use engine::scene::{Gaussians, Motion, Scene, Superpoints};
///
/// let scene = Scene {
///     gaussians: Gaussians {
///         mean: vec![[0.0; 3]],
///         log_scale: vec![[-2.0; 3]],
///         rotation: vec![[1.0, 0.0, 0.0, 0.0]],
///         opacity_logit: vec![2.0],
///         sh_degree: 0,
///         sh: vec![1.0; 3],
///     },
///     superpoints: Some(Superpoints { of_gaussian: vec![0], position: vec![[0.0; 3]] }),
///     motion: Some(Motion {
///         times: vec![0.0, 1.0],
///         rotation: vec![[0.0; 3]; 2],
///         translation: vec![[0.0; 3], [1.0, 0.0, 0.0]], // moves one unit along x
///     }),
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
    tensors::write(path, [FORMAT, VERSION], tensors(scene), &scene.metadata)
}

fn tensors(scene: &Scene) -> Vec<NamedTensor<'_>> {
    let g = &scene.gaussians;
    let n = g.len();
    let mut out = vec![
        floats("gaussians.mean", vec![n, 3], g.mean.as_flattened()),
        floats("gaussians.log_scale", vec![n, 3], g.log_scale.as_flattened()),
        floats("gaussians.rotation", vec![n, 4], g.rotation.as_flattened()),
        floats("gaussians.opacity_logit", vec![n], &g.opacity_logit),
        floats("gaussians.sh", vec![n, g.sh_coefficients(), 3], &g.sh),
    ];
    if let Some(s) = &scene.superpoints {
        out.push(indices("superpoints.of_gaussian", vec![n], &s.of_gaussian));
        out.push(floats("superpoints.position", vec![s.position.len(), 3], s.position.as_flattened()));
    }
    if let Some(m) = &scene.motion {
        let shape = vec![m.times.len(), m.superpoint_count(), 3];
        out.push(floats("motion.times", vec![m.times.len()], &m.times));
        out.push(floats("motion.rotation", shape.clone(), m.rotation.as_flattened()));
        out.push(floats("motion.translation", shape, m.translation.as_flattened()));
    }
    if let Some(a) = &scene.association {
        out.push(indices("association.neighbor", vec![n, a.neighbors], &a.neighbor));
        out.push(floats("association.logit", vec![n, a.neighbors], &a.logit));
    }
    if let Some(network) = &scene.deform {
        out.extend(network.named_layers().into_iter().flat_map(|(name, l)| linear(&name, l)));
    }
    if let Some(network) = &scene.nonrigid {
        out.extend(network.named_layers().into_iter().flat_map(|(name, l)| linear(&name, l)));
    }
    if let Some(field) = &scene.field {
        out.extend(field_tensors(field, n));
    }
    out.extend(scene.extra.iter().map(|(name, tensor)| floats(name.as_str(), tensor.shape.clone(), &tensor.data)));
    out
}

fn field_tensors(field: &DeformationField, n: usize) -> Vec<NamedTensor<'_>> {
    let mut out: Vec<NamedTensor<'_>> = Vec::new();
    out.extend(field.named_layers().into_iter().flat_map(|(name, l)| linear(&name, l)));
    if let FieldInput::Planes(planes) = &field.input {
        out.push(floats("field.bounds", vec![2, 3], planes.bounds.as_flattened()));
        for (s, six) in planes.scales.iter().enumerate() {
            for (p, plane) in six.iter().enumerate() {
                let shape = vec![planes.channels, plane.height, plane.width];
                out.push(floats(format!("field.plane.{s}.{p}"), shape, &plane.values));
            }
        }
    }
    if let Some(nodes) = &field.nodes {
        let pairs = vec![n, nodes.neighbors];
        out.push(floats("field.node.position", vec![nodes.position.len(), 3], nodes.position.as_flattened()));
        out.push(indices("field.node.neighbor", pairs.clone(), &nodes.neighbor));
        out.push(floats("field.node.weight", pairs, &nodes.weight));
        out.push(floats("field.node.share", vec![n], &nodes.share));
    }
    out
}

fn linear<'a>(name: &str, layer: &'a Linear) -> [NamedTensor<'a>; 2] {
    [
        floats(format!("{name}.weight"), vec![layer.outputs, layer.inputs], &layer.weight),
        floats(format!("{name}.bias"), vec![layer.outputs], &layer.bias),
    ]
}
