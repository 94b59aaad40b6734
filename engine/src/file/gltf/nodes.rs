//! Where the scene's nodes put their meshes.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde_json::Value;

use super::document::{Document, elements};
use crate::error::Result;

/// A mesh at its place in the world.
pub(super) struct Instance {
    pub(super) mesh: usize,
    pub(super) map: DAffine3,
}

/// All meshes of the default scene, or, where there is no scene, of all nodes.
pub(super) fn instances(document: &Document<'_>) -> Result<Vec<Instance>> {
    let nodes = document.list("nodes");
    let mut is_child = vec![false; nodes.len()];
    for child in nodes.iter().flat_map(|node| elements(&node["children"])) {
        if let Some(flag) = index(child).and_then(|i| is_child.get_mut(i)) {
            *flag = true;
        }
    }
    let scene = document.list("scenes").get(document.entry("scene").unwrap_or(0));
    let roots: Vec<usize> = match scene {
        Some(scene) => elements(&scene["nodes"]).iter().filter_map(index).collect(),
        None => (0..nodes.len()).filter(|&i| !is_child[i]).collect(),
    };
    // First to last, a node before its children.
    let mut waiting: Vec<(usize, DAffine3)> = roots.into_iter().rev().map(|i| (i, DAffine3::IDENTITY)).collect();
    let mut is_seen = vec![false; nodes.len()];
    let mut instances = Vec::new();
    while let Some((i, parent)) = waiting.pop() {
        let at = format!("nodes[{i}]");
        let Some(node) = nodes.get(i) else {
            return Err(document.corrupt(&at, format!("{} nodes", nodes.len()), "one of them"));
        };
        if std::mem::replace(&mut is_seen[i], true) {
            return Err(document.corrupt(&at, "a node with two parents", "a tree of nodes"));
        }
        let map = parent * local(document, &at, node)?;
        if let Some(mesh) = index(&node["mesh"]) {
            instances.push(Instance { mesh, map });
        }
        waiting.extend(elements(&node["children"]).iter().rev().filter_map(index).map(|child| (child, map)));
    }
    Ok(instances)
}

fn index(value: &Value) -> Option<usize> {
    value.as_u64().and_then(|v| usize::try_from(v).ok())
}

/// The transform of one node: a matrix by columns, or scale, rotation and translation in this order.
fn local(document: &Document<'_>, at: &str, node: &Value) -> Result<DAffine3> {
    if let Some(m) = numbers::<16>(document, at, node, "matrix")? {
        let column = |c: usize| DVec3::new(m[4 * c], m[4 * c + 1], m[4 * c + 2]);
        let linear = DMat3::from_cols(column(0), column(1), column(2));
        return Ok(DAffine3::from_mat3_translation(linear, column(3)));
    }
    let scale = numbers(document, at, node, "scale")?.map_or(DVec3::ONE, DVec3::from_array);
    let translation = numbers(document, at, node, "translation")?.map_or(DVec3::ZERO, DVec3::from_array);
    let rotation = match numbers(document, at, node, "rotation")?.map(DQuat::from_array) {
        None => DQuat::IDENTITY,
        Some(q) if q.length() > 1.0e-6 && q.length().is_finite() => q.normalize(),
        Some(q) => return Err(document.corrupt(at, format!("rotation {q}"), "a quaternion of length 1")),
    };
    Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
}

fn numbers<const N: usize>(document: &Document<'_>, at: &str, node: &Value, key: &str) -> Result<Option<[f64; N]>> {
    if node[key].is_null() {
        return Ok(None);
    }
    let list: Vec<f64> = elements(&node[key]).iter().filter_map(Value::as_f64).collect();
    let found = || format!("{key} of {} numbers", list.len());
    list.as_slice().try_into().map(Some).map_err(|_| document.corrupt(at, found(), format!("{N} numbers")))
}
