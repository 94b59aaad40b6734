//! 4D-GS (Wu et al. 2024): planes over pairs of x, y, z, t, whose product a small network turns into offsets.
//!
//! `deformation_net.grid.aabb` `[2,3]`; `grids.{s}.{p}` `[1,C,B,A]` for the pairs (x,y) (x,z) (x,t) (y,z) (y,t) (z,t);
//! features of all resolutions s one after another → `feature_out.0` → heads `ReLU, Linear, ReLU, Linear`, added to the
//! centre and, before activation, to scale and rotation. Offsets of opacity and colour (off by default in the released
//! configurations) are not taken.
//!
//! The three heads become two layers of the field: their first layers see the same input and are stacked; their second
//! layers are one with zeros where an output of one head would see another head's hidden values.

use std::path::Path;

use super::deformable::stacked;
use super::sp_gs::linear;
use crate::error::{Error, Result};
use crate::file::torch::Weights;
use crate::scene::Linear;
use crate::scene::field::{DeformationField, FIELD_MOST_SCALES, FIELD_PAIRS, FieldInput, FieldPlane, FieldPlanes};

/// Prefix of the tensors' names.
const NET: &str = "deformation_net";
/// Heads and their outputs, in the order of the field's.
const HEADS: [(&str, usize); 3] = [("pos_deform", 3), ("rotations_deform", 4), ("scales_deform", 3)];

/// Reads the field.
pub(super) fn read(weights: &Weights<'_>, path: &Path) -> Result<DeformationField> {
    let planes = planes(weights, path)?;
    let width = weights.shape(&format!("{NET}.feature_out.0.weight")).and_then(|s| s.first().copied()).unwrap_or(0);
    if (1..8).any(|i| weights.has(&format!("{NET}.feature_out.{i}.weight"))) {
        let found = "a deeper network before the heads";
        return Err(Error::corrupt(path, "tensor `feature_out`", found, "one layer (net depth 0 or 1)"));
    }
    let feature = linear(weights, &format!("{NET}.feature_out.0"), planes.channels * planes.scales.len(), width, path)?;
    let layer =
        |name: &str, i: usize, outputs: usize| linear(weights, &format!("{NET}.{name}.{i}"), width, outputs, path);
    let first = HEADS.map(|(name, _)| layer(name, 1, width)).into_iter().collect::<Result<Vec<_>>>()?;
    let second = HEADS.map(|(name, outputs)| layer(name, 3, outputs)).into_iter().collect::<Result<Vec<_>>>()?;
    Ok(DeformationField {
        input: FieldInput::Planes(planes),
        layers: vec![feature, stacked(&first)],
        head: side_by_side(&second),
        nodes: None,
    })
}

fn planes(weights: &Weights<'_>, path: &Path) -> Result<FieldPlanes> {
    let (ends, _) = weights.floats(&format!("{NET}.grid.aabb"), &[Some(2), Some(3)])?;
    let bounds: [[f32; 3]; 2] = std::array::from_fn(|e| std::array::from_fn(|a| ends[3 * e + a]));
    if (0..3).any(|a| !(bounds[1][a] - bounds[0][a]).is_normal()) {
        return Err(Error::corrupt(path, "tensor `grid.aabb`", format!("{bounds:?}"), "a box with a size"));
    }
    let mut made = FieldPlanes { bounds, ..FieldPlanes::default() };
    while weights.has(&format!("{NET}.grid.grids.{}.0", made.scales.len())) && made.scales.len() < FIELD_MOST_SCALES {
        let s = made.scales.len();
        let of_pair = |p: usize| plane(weights, &format!("{NET}.grid.grids.{s}.{p}"), path);
        let planes = (0..FIELD_PAIRS.len()).map(of_pair).collect::<Result<Vec<_>>>()?;
        let channels = planes.first().map_or(0, |(channels, _)| *channels);
        if planes.iter().any(|(c, _)| *c != channels || (s > 0 && *c != made.channels)) {
            let found = format!("{:?} channels", planes.iter().map(|(c, _)| *c).collect::<Vec<_>>());
            return Err(Error::corrupt(path, format!("tensors `grids.{s}.*`"), found, "as many channels each"));
        }
        made.channels = channels;
        let planes: Vec<FieldPlane> = planes.into_iter().map(|(_, plane)| plane).collect();
        made.scales.push(planes.try_into().map_err(|_| Error::corrupt(path, "grid", "planes", "six"))?);
    }
    if made.scales.is_empty() {
        return Err(Error::corrupt(path, "tensor `grid.grids.0.0`", "nothing", "six planes for each resolution"));
    }
    Ok(made)
}

/// Channels and values of a plane.
fn plane(weights: &Weights<'_>, name: &str, path: &Path) -> Result<(usize, FieldPlane)> {
    let (values, shape) = weights.floats(name, &[Some(1), None, None, None])?;
    if values.is_empty() {
        return Err(Error::corrupt(path, format!("tensor `{name}`"), format!("{shape:?}"), "at least one value"));
    }
    Ok((shape[1], FieldPlane { height: shape[2], width: shape[3], values }))
}

/// Layers of inputs of their own as one: block after block along the diagonal.
fn side_by_side(layers: &[Linear]) -> Linear {
    let inputs = layers.iter().map(|l| l.inputs).sum();
    let mut made = Linear { inputs, ..Linear::default() };
    let mut first = 0;
    for layer in layers {
        for row in layer.weight.chunks_exact(layer.inputs.max(1)) {
            let mut wide = vec![0.0; inputs];
            wide[first..first + layer.inputs].copy_from_slice(row);
            made.weight.extend(wide);
        }
        made.bias.extend(&layer.bias);
        made.outputs += layer.outputs;
        first += layer.inputs;
    }
    made
}
