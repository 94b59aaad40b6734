//! Deformable-3DGS (Yang et al. 2024): a network of centre and time that gives each Gaussian offsets.
//!
//! `linear.{0..7}` of width 256 with ReLU, the encoding again before layer 5, heads `gaussian_warp` (3; 6-DoF: `branch_w` and
//! `branch_v`, 3 each), `gaussian_rotation` (4, added to the unit quaternion), `gaussian_scaling` (3, added to the scale).
//! Time is encoded with 10 octaves, or, for synthetic data, with 6 and then by `timenet` to 30 values (fixed in the released
//! code); centres with 10 octaves or what the first layer's inputs say (an argument there).

use std::path::Path;

use super::sp_gs::linear;
use crate::error::{Error, Result};
use crate::file::torch::Weights;
use crate::scene::Linear;
use crate::scene::field::{DeformationField, FIELD_TIME_NETWORK, FIELD_TIME_OCTAVES, FieldInput};

const WIDTH: usize = 256;
const LAYERS: usize = 8;
/// The layer before which the encoding comes in again.
const SKIP: usize = 5;

/// The network of tensors whose names begin with `prefix`; with `local_rotation` (SC-GS) the head has four outputs more.
pub(super) fn read(weights: &Weights<'_>, prefix: &str, path: &Path) -> Result<DeformationField> {
    let named = |name: &str| format!("{prefix}{name}");
    let has = |name: &str| weights.has(&named(name));
    let [hidden, code] = FIELD_TIME_NETWORK;
    let found = weights.shape(&named("linear.0.weight")).unwrap_or_default();
    let encoding = found.get(1).copied().unwrap_or(0);
    let octaves = FieldInput::octaves_of(encoding, has("timenet.0.weight"));
    let (Some(octaves), [WIDTH, _]) = (octaves, &found[..]) else {
        let time = FieldInput::time_width(has("timenet.0.weight"));
        let expected = format!("[{WIDTH}, 3 + 6 L + {time}], L up to 10 octaves of the centre");
        return Err(Error::corrupt(path, "tensor `linear.0.weight`", format!("{found:?}"), expected));
    };
    let layer = |name: &str, inputs: usize, outputs: usize| linear(weights, &named(name), inputs, outputs, path);
    let inputs = |i: usize| match i {
        0 => encoding,
        SKIP => encoding + WIDTH,
        _ => WIDTH,
    };
    let time = if has("timenet.0.weight") {
        let first = layer("timenet.0", 1 + 2 * FIELD_TIME_OCTAVES[1], hidden)?;
        Some([first, layer("timenet.2", hidden, code)?])
    } else {
        None
    };
    let mut heads: Vec<(&str, usize)> =
        if has("branch_w.weight") { vec![("branch_w", 3), ("branch_v", 3)] } else { vec![("gaussian_warp", 3)] };
    heads.extend([("gaussian_rotation", 4), ("gaussian_scaling", 3)]);
    if has("local_rotation.weight") {
        heads.push(("local_rotation", 4));
    }
    let heads = heads.into_iter().map(|(name, outputs)| layer(name, WIDTH, outputs)).collect::<Result<Vec<_>>>()?;
    Ok(DeformationField {
        input: FieldInput::Waves { octaves, time },
        layers: (0..LAYERS).map(|i| layer(&format!("linear.{i}"), inputs(i), WIDTH)).collect::<Result<_>>()?,
        head: stacked(&heads),
        nodes: None,
    })
}

/// Layers of the same inputs as one: their outputs one after another.
pub(super) fn stacked(layers: &[Linear]) -> Linear {
    Linear {
        inputs: layers.first().map_or(0, |l| l.inputs),
        outputs: layers.iter().map(|l| l.outputs).sum(),
        weight: layers.iter().flat_map(|l| l.weight.iter().copied()).collect(),
        bias: layers.iter().flat_map(|l| l.bias.iter().copied()).collect(),
    }
}
