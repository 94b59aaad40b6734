//! Tensors `superpoints.*`, `motion.*`, `association.*` and `deform.*`: superpoints, what gives their poses, and what training
//! needs of them.

use super::super::read::Tensors;
use super::{linear, prefixed};
use crate::error::{Error, Result};
use std::borrow::Cow;

use crate::file::tensors::{NamedTensor, floats, indices, narrow_indices};
use crate::scene::{Association, Blend, DeformNetwork, DeformSize, Motion, SuperpointDeformation, Superpoints};

/// Prefixes of the tensors' names.
pub(super) const NAMESPACES: [&str; 4] = ["superpoints.", "motion.", "association.", "deform."];

const SUPERPOINTS: [&str; 2] = ["superpoints.of_gaussian", "superpoints.position"];
const BLEND: [&str; 2] = ["superpoints.blend_index", "superpoints.blend_weight"];
const TABLE: [&str; 3] = ["motion.times", "motion.rotation", "motion.translation"];
const ASSOCIATION: [&str; 2] = ["association.neighbor", "association.logit"];

/// All but network G, when superpoints are there.
pub(super) fn read(tensors: &mut Tensors<'_>, n: usize) -> Result<Option<SuperpointDeformation>> {
    let (superpoints, blend) = (superpoints(tensors, n)?, blend(tensors, n)?);
    let (table, association, network) = (motion(tensors)?, association(tensors, n)?, network(tensors)?);
    let parts = [
        (BLEND[0], blend.is_some()),
        (TABLE[0], table.is_some()),
        (ASSOCIATION[0], association.is_some()),
        ("deform.linear.0.weight", network.is_some()),
    ];
    match (superpoints, parts.iter().find(|(_, is_there)| *is_there)) {
        (Some(superpoints), _) => {
            Ok(Some(SuperpointDeformation { superpoints, blend, table, network, association, nonrigid: None }))
        }
        (None, None) => Ok(None),
        (None, Some((name, _))) => {
            let (at, found) = (format!("tensor `{}`", SUPERPOINTS[0]), format!("nothing, though `{name}` is there"));
            Err(Error::corrupt(tensors.path, at, found, "the superpoints that it moves"))
        }
    }
}

/// All but network G, for a scene of `n` Gaussians.
pub(super) fn tensors(s: &SuperpointDeformation, n: usize) -> Vec<NamedTensor<'_>> {
    let mut out = vec![
        indices(SUPERPOINTS[0], vec![n], &s.superpoints.of_gaussian),
        floats(SUPERPOINTS[1], vec![s.superpoints.position.len(), 3], s.superpoints.position.as_flattened()),
    ];
    if let Some(b) = &s.blend {
        let shape = vec![n, b.neighbors];
        out.push(narrow_indices(BLEND[0], shape.clone(), &b.index, s.superpoints.position.len()));
        // Either type holds the very weights.
        out.push(match b.levels() {
            Some(levels) => NamedTensor { name: BLEND[1].into(), dtype: "U8", shape, bytes: Cow::Owned(levels) },
            None => floats(BLEND[1], shape, &b.weight),
        });
    }
    if let Some(m) = &s.table {
        let shape = vec![m.times.len(), m.superpoint_count(), 3];
        out.push(floats(TABLE[0], vec![m.times.len()], &m.times));
        out.push(floats(TABLE[1], shape.clone(), m.rotation.as_flattened()));
        out.push(floats(TABLE[2], shape, m.translation.as_flattened()));
    }
    if let Some(a) = &s.association {
        out.push(indices(ASSOCIATION[0], vec![n, a.neighbors], &a.neighbor));
        out.push(floats(ASSOCIATION[1], vec![n, a.neighbors], &a.logit));
    }
    if let Some(network) = &s.network {
        out.extend(network.named_layers().into_iter().flat_map(|(name, l)| linear(&name, l)));
    }
    out
}

/// Names that have a meaning here.
pub(super) fn is_known(name: &str) -> bool {
    let listed = SUPERPOINTS.iter().chain(&BLEND).chain(&TABLE).chain(&ASSOCIATION).any(|known| *known == name);
    listed || prefixed(name, "deform.", DeformSize::MOST_LAYERS, &["translation", "rotation"])
}

fn superpoints(tensors: &mut Tensors<'_>, n: usize) -> Result<Option<Superpoints>> {
    if !tensors.group(&SUPERPOINTS)? {
        return Ok(None);
    }
    let (_, of_gaussian) = tensors.u32s(SUPERPOINTS[0], &[Some(n)])?;
    let (_, position) = tensors.rows::<3>(SUPERPOINTS[1], &[None])?;
    Ok(Some(Superpoints { of_gaussian, position }))
}

fn blend(tensors: &mut Tensors<'_>, n: usize) -> Result<Option<Blend>> {
    if !tensors.group(&BLEND)? {
        return Ok(None);
    }
    let (shape, index) = tensors.indices(BLEND[0], &[Some(n), None])?;
    let (_, weight) = tensors.weights(BLEND[1], &[Some(n), Some(shape[1])])?;
    Ok(Some(Blend { neighbors: shape[1], index, weight }))
}

fn motion(tensors: &mut Tensors<'_>) -> Result<Option<Motion>> {
    if !tensors.group(&TABLE)? {
        return Ok(None);
    }
    let (shape, times) = tensors.f32s(TABLE[0], &[None])?;
    let t = Some(shape[0]);
    let (shape, rotation) = tensors.rows::<3>(TABLE[1], &[t, None])?;
    let (_, translation) = tensors.rows::<3>(TABLE[2], &[t, Some(shape[1])])?;
    Ok(Some(Motion { times, rotation, translation }))
}

fn association(tensors: &mut Tensors<'_>, n: usize) -> Result<Option<Association>> {
    if !tensors.group(&ASSOCIATION)? {
        return Ok(None);
    }
    let (shape, neighbor) = tensors.u32s(ASSOCIATION[0], &[Some(n), None])?;
    let (_, logit) = tensors.f32s(ASSOCIATION[1], &[Some(n), Some(shape[1])])?;
    Ok(Some(Association { neighbors: shape[1], neighbor, logit }))
}

fn network(tensors: &mut Tensors<'_>) -> Result<Option<DeformNetwork>> {
    if !tensors.map.keys().any(|name| name.starts_with("deform.")) {
        return Ok(None);
    }
    let size = network_size(tensors)?;
    let mut layer = |name: &str, inputs, outputs| tensors.linear(name, inputs, outputs);
    let linear = (0..size.layers)
        .map(|i| layer(&format!("deform.linear.{i}"), size.layer_inputs(i), size.width))
        .collect::<Result<_>>()?;
    let translation = layer("deform.translation", size.width, 3)?;
    let rotation = layer("deform.rotation", size.width, 3)?;
    Ok(Some(DeformNetwork { linear, translation, rotation }))
}

/// Size of network F, by the tensors that are there.
fn network_size(tensors: &Tensors<'_>) -> Result<DeformSize> {
    let named = |i: usize| tensors.map.get(&format!("deform.linear.{i}.weight"));
    let layers = (0..DeformSize::MOST_LAYERS).rev().find(|&i| named(i).is_some()).map_or(1, |i| i + 1);
    let width = named(0).and_then(|view| view.shape().first().copied()).unwrap_or(DeformSize::PAPER.width);
    let size = DeformSize { layers, width };
    size.check().map(|()| size).map_err(|_| {
        let expected = format!("a multiple of {} up to {} rows", DeformSize::WIDTH_STEP, DeformSize::MOST_WIDTH);
        Error::corrupt(tensors.path, "deform.linear.0.weight", format!("{width} rows"), expected)
    })
}
