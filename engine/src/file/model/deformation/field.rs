//! Tensors `field.*`: a deformation field.

use super::super::read::Tensors;
use super::linear as layer_tensors;
use crate::error::Result;
use crate::file::tensors::{NamedTensor, floats, indices};
use crate::scene::Linear;
use crate::scene::field::{
    ControlNodes, DeformationField, FIELD_MOST_LAYERS, FIELD_MOST_SCALES, FIELD_PAIRS, FieldInput, FieldPlane,
    FieldPlanes,
};

/// Prefixes of the tensors' names.
pub(super) const NAMESPACES: [&str; 1] = ["field."];

/// The field, when its head is there. What does not fit together is found by [`DeformationField::check`].
pub(super) fn read(tensors: &mut Tensors<'_>, gaussians: usize) -> Result<Option<DeformationField>> {
    if !tensors.has("field.head.weight") {
        return Ok(None);
    }
    let mut layers = Vec::new();
    while tensors.has(&format!("field.layer.{}.weight", layers.len())) && layers.len() < FIELD_MOST_LAYERS {
        layers.push(linear(tensors, &format!("field.layer.{}", layers.len()))?);
    }
    let head = linear(tensors, "field.head")?;
    let input = if tensors.has("field.plane.0.0") {
        FieldInput::Planes(planes(tensors)?)
    } else {
        let networks = |t: &mut Tensors<'_>| Ok([linear(t, "field.time.0")?, linear(t, "field.time.1")?]);
        let time = tensors.has("field.time.0.weight").then(|| networks(tensors)).transpose()?;
        // A width that no number of octaves has is found when all is checked.
        let width = layers.first().map_or(0, |l| l.inputs);
        FieldInput::Waves { octaves: FieldInput::octaves_of(width, time.is_some()).unwrap_or(0), time }
    };
    let nodes = if tensors.has("field.node.position") { Some(nodes(tensors, gaussians)?) } else { None };
    Ok(Some(DeformationField { input, layers, head, nodes }))
}

/// A layer of whatever shape it has.
fn linear(tensors: &mut Tensors<'_>, name: &str) -> Result<Linear> {
    let (shape, weight) = tensors.f32s(&format!("{name}.weight"), &[None, None])?;
    let (_, bias) = tensors.f32s(&format!("{name}.bias"), &[Some(shape[0])])?;
    Ok(Linear { inputs: shape[1], outputs: shape[0], weight, bias })
}

fn planes(tensors: &mut Tensors<'_>) -> Result<FieldPlanes> {
    let (_, bounds) = tensors.rows::<3>("field.bounds", &[Some(2)])?;
    let mut made = FieldPlanes { bounds: [bounds[0], bounds[1]], ..FieldPlanes::default() };
    while tensors.has(&format!("field.plane.{}.0", made.scales.len())) && made.scales.len() < FIELD_MOST_SCALES {
        let mut six: [FieldPlane; 6] = Default::default();
        for (p, plane) in six.iter_mut().enumerate().take(FIELD_PAIRS.len()) {
            let channels = (p > 0 || !made.scales.is_empty()).then_some(made.channels);
            let name = format!("field.plane.{}.{p}", made.scales.len());
            let (shape, values) = tensors.f32s(&name, &[channels, None, None])?;
            made.channels = shape[0];
            *plane = FieldPlane { height: shape[1], width: shape[2], values };
        }
        made.scales.push(six);
    }
    Ok(made)
}

fn nodes(tensors: &mut Tensors<'_>, gaussians: usize) -> Result<ControlNodes> {
    let n = Some(gaussians);
    let (_, position) = tensors.rows::<3>("field.node.position", &[None])?;
    let (shape, neighbor) = tensors.u32s("field.node.neighbor", &[n, None])?;
    let (_, weight) = tensors.f32s("field.node.weight", &[n, Some(shape[1])])?;
    let (_, share) = tensors.f32s("field.node.share", &[n])?;
    Ok(ControlNodes { position, neighbors: shape[1], neighbor, weight, share })
}

pub(super) fn tensors(field: &DeformationField, n: usize) -> Vec<NamedTensor<'_>> {
    let mut out: Vec<NamedTensor<'_>> = Vec::new();
    out.extend(field.named_layers().into_iter().flat_map(|(name, l)| layer_tensors(&name, l)));
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

/// Names that have a meaning here.
pub(super) fn is_known(name: &str) -> bool {
    const PARTS: [&str; 5] = ["field.layer.", "field.head.", "field.time.", "field.plane.", "field.node."];
    name == "field.bounds" || PARTS.iter().any(|part| name.starts_with(part))
}
