//! Tensors `nonrigid.*`: network G.

use super::super::read::Tensors;
use super::{linear, prefixed};
use crate::error::Result;
use crate::file::tensors::NamedTensor;
use crate::scene::NonrigidNetwork;
use crate::scene::network::{NONRIGID_HEADS, NONRIGID_LAYERS, NONRIGID_WIDTH};

/// Prefixes of the tensors' names.
pub(super) const NAMESPACES: [&str; 1] = ["nonrigid."];

pub(super) fn tensors(network: &NonrigidNetwork) -> Vec<NamedTensor<'_>> {
    network.named_layers().into_iter().flat_map(|(name, l)| linear(&name, l)).collect()
}

/// Names that have a meaning here.
pub(super) fn is_known(name: &str) -> bool {
    prefixed(name, "nonrigid.", NONRIGID_LAYERS, &["translation", "rotation", "scaling"])
}

/// Network G, when one of its tensors is there.
pub(super) fn read(tensors: &mut Tensors<'_>) -> Result<Option<NonrigidNetwork>> {
    if !tensors.map.keys().any(|name| is_known(name)) {
        return Ok(None);
    }
    let hidden = (0..NONRIGID_LAYERS)
        .map(|i| tensors.linear(&format!("nonrigid.linear.{i}"), NonrigidNetwork::layer_inputs(i), NONRIGID_WIDTH))
        .collect::<Result<_>>()?;
    let [translation, rotation, scaling] = NONRIGID_HEADS;
    Ok(Some(NonrigidNetwork {
        linear: hidden,
        translation: tensors.linear("nonrigid.translation", NONRIGID_WIDTH, translation)?,
        rotation: tensors.linear("nonrigid.rotation", NONRIGID_WIDTH, rotation)?,
        scaling: tensors.linear("nonrigid.scaling", NONRIGID_WIDTH, scaling)?,
    }))
}
