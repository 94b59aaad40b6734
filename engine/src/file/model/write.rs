//! A [`Scene`] to tensors by name.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::{FORMAT, RESERVED, VERSION, checksum};
use crate::error::{Error, Result};
use crate::file::check;
use crate::file::durable::write_atomic;
use crate::scene::{Linear, Scene};

/// A tensor to be written.
struct Out<'a> {
    name: Cow<'a, str>,
    dtype: &'static str,
    shape: Vec<usize>,
    bytes: Cow<'a, [u8]>,
}

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
/// [`Error::Usage`] naming the tensor when the scene is inconsistent; [`Error::Io`].
pub fn write(path: &Path, scene: &Scene) -> Result<()> {
    check::scene(scene).map_err(|problem| problem.usage(path))?;
    let mut tensors = tensors(scene);
    tensors.sort_by(|a, b| a.name.cmp(&b.name));
    let header = header(&tensors, scene, path)?;
    write_atomic(path, |out| {
        out.write_all(&(header.len() as u64).to_le_bytes())?;
        out.write_all(&header)?;
        tensors.iter().try_for_each(|tensor| out.write_all(&tensor.bytes))
    })
}

/// The JSON header, padded with spaces so that the data are 8-byte aligned.
fn header(tensors: &[Out<'_>], scene: &Scene, path: &Path) -> Result<Vec<u8>> {
    let sums: BTreeMap<&str, String> =
        tensors.par_iter().map(|t| (t.name.as_ref(), checksum::of_bytes(&t.bytes))).collect();
    let sums = json!(sums).to_string();
    let mut metadata: BTreeMap<&str, &str> =
        scene.metadata.iter().map(|(key, value)| (key.as_str(), value.as_str())).collect();
    metadata.retain(|key, _| !RESERVED.contains(key));
    metadata.extend([("format", FORMAT), ("version", VERSION), (checksum::TENSORS, sums.as_str())]);

    let mut entries = Map::new();
    let mut descriptions = BTreeMap::new();
    let mut begin = 0;
    for tensor in tensors {
        let offsets = [begin, begin + tensor.bytes.len()];
        begin = offsets[1];
        let texts = [tensor.dtype.into(), format!("{:?}", tensor.shape), format!("{offsets:?}")];
        descriptions.insert(tensor.name.as_ref(), texts);
        let entry = json!({ "dtype": tensor.dtype, "shape": tensor.shape, "data_offsets": offsets });
        entries.insert(tensor.name.to_string(), entry);
    }
    let header_sum = checksum::of_header(&metadata, &descriptions);
    metadata.insert(checksum::HEADER, &header_sum);
    let mut all = Map::from_iter([("__metadata__".to_string(), json!(metadata))]);
    all.append(&mut entries);
    let mut text = Value::Object(all).to_string().into_bytes();
    text.resize(text.len().next_multiple_of(8), b' ');
    // The limit of the format's readers.
    const MAX_HEADER: usize = 100_000_000;
    if text.len() > MAX_HEADER {
        let what = format!("{} (bytes of header and metadata)", path.display());
        return Err(Error::Limit { what, need: text.len() as u128, have: MAX_HEADER as u128 });
    }
    Ok(text)
}

fn tensors(scene: &Scene) -> Vec<Out<'_>> {
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
    out.extend(scene.extra.iter().map(|(name, tensor)| floats(name.as_str(), tensor.shape.clone(), &tensor.data)));
    out
}

fn linear<'a>(name: &str, layer: &'a Linear) -> [Out<'a>; 2] {
    [
        floats(format!("{name}.weight"), vec![layer.outputs, layer.inputs], &layer.weight),
        floats(format!("{name}.bias"), vec![layer.outputs], &layer.bias),
    ]
}

fn floats<'a>(name: impl Into<Cow<'a, str>>, shape: Vec<usize>, values: &'a [f32]) -> Out<'a> {
    let bytes = if cfg!(target_endian = "little") {
        Cow::Borrowed(bytemuck::cast_slice(values))
    } else {
        Cow::Owned(values.iter().flat_map(|v| v.to_le_bytes()).collect())
    };
    Out { name: name.into(), dtype: "F32", shape, bytes }
}

fn indices<'a>(name: &'a str, shape: Vec<usize>, values: &'a [u32]) -> Out<'a> {
    let bytes = if cfg!(target_endian = "little") {
        Cow::Borrowed(bytemuck::cast_slice(values))
    } else {
        Cow::Owned(values.iter().flat_map(|v| v.to_le_bytes()).collect())
    };
    Out { name: name.into(), dtype: "U32", shape, bytes }
}
