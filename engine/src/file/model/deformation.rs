//! What moves a scene, as tensors by name: one module for each model.

mod field;
mod nonrigid;
mod superpoints;

use super::read::Tensors;
use crate::error::Result;
use crate::file::check::Problem;
use crate::file::tensors::{NamedTensor, floats};
use crate::scene::deformation::field_beside_others;
use crate::scene::{Deformation, Linear, SuperpointDeformation};

/// The model that the tensors hold.
pub(super) fn read(tensors: &mut Tensors<'_>, gaussians: usize) -> Result<Deformation> {
    let superpoints = superpoints::read(tensors, gaussians)?;
    let nonrigid = nonrigid::read(tensors)?;
    let field = field::read(tensors, gaussians)?;
    match (superpoints, nonrigid, field) {
        (None, None, None) => Ok(Deformation::None),
        (Some(s), nonrigid, None) => Ok(SuperpointDeformation { nonrigid, ..s }.into()),
        (None, Some(network), None) => Ok(network.into()),
        (None, None, Some(field)) => Ok(field.into()),
        (_, _, Some(_)) => Err(Problem::from(field_beside_others()).corrupt(tensors.path)),
    }
}

/// The tensors of a scene with this many Gaussians.
pub(super) fn tensors(deformation: &Deformation, gaussians: usize) -> Vec<NamedTensor<'_>> {
    match deformation {
        Deformation::None => Vec::new(),
        Deformation::Superpoints(s) => {
            let mut out = superpoints::tensors(s, gaussians);
            out.extend(s.nonrigid.iter().flat_map(nonrigid::tensors));
            out
        }
        Deformation::Nonrigid(network) => nonrigid::tensors(network),
        Deformation::Field(field) => field::tensors(field, gaussians),
    }
}

/// Whether a name starts with a prefix of these tensors.
pub(super) fn is_reserved(name: &str) -> bool {
    let mut all = superpoints::NAMESPACES.iter().chain(&nonrigid::NAMESPACES).chain(&field::NAMESPACES);
    all.any(|space| name.starts_with(space))
}

/// Whether a tensor of this name has a meaning here, and so cannot be a further one.
pub(crate) fn is_known(name: &str) -> bool {
    superpoints::is_known(name) || nonrigid::is_known(name) || field::is_known(name)
}

/// `{prefix}linear.{0..layers}.{weight,bias}`, `{prefix}{head}.{weight,bias}`.
fn prefixed(name: &str, prefix: &str, layers: usize, heads: &[&str]) -> bool {
    let Some((layer, "weight" | "bias")) = name.strip_prefix(prefix).and_then(|rest| rest.rsplit_once('.')) else {
        return false;
    };
    let hidden = |i: &str| (0..layers).any(|layer| layer.to_string() == i);
    heads.contains(&layer) || layer.strip_prefix("linear.").is_some_and(hidden)
}

fn linear<'a>(name: &str, layer: &'a Linear) -> [NamedTensor<'a>; 2] {
    [
        floats(format!("{name}.weight"), vec![layer.outputs, layer.inputs], &layer.weight),
        floats(format!("{name}.bias"), vec![layer.outputs], &layer.bias),
    ]
}
