//! Motion that is each Gaussian's own: the deformation fields of Deformable-3DGS, 4D-GS and SC-GS.
//!
//! A field is a perceptron that sees a point and the time. Its points are the Gaussians' centres at rest, or control nodes
//! that each Gaussian follows ([`ControlNodes`]). What it sees of them is a positional encoding or the product of learned
//! planes ([`FieldInput`]), which also decides what its outputs mean ([`FieldRule`]).
//!
//! Tensors in the model file, weights `[outputs, inputs]`:
//!
//! | tensor | shape | |
//! |---|---|---|
//! | `field.layer.{i}.{weight,bias}` | | hidden layers, ReLU after each; one may see `[input, h]` |
//! | `field.head.{weight,bias}` | 10, 13 or 14 outputs | see [`FieldRule`] and [`ControlNodes`] |
//! | `field.time.{0,1}.{weight,bias}` | 13 → 256 → 30 | what is made of time before it enters, where there is such a network |
//! | `field.bounds` | `[2,3]` | planes: what −1 and 1 of each axis are |
//! | `field.plane.{s}.{p}` | `[C,H,W]` | planes of resolution s over (x,y) (x,z) (x,t) (y,z) (y,t) (z,t); the first along W |
//! | `field.node.position` | `[M,3]` | control nodes at rest |
//! | `field.node.neighbor`, `field.node.weight` | `[N,K]` u32, `[N,K]` | which nodes each Gaussian follows, and how much |
//! | `field.node.share` | `[N]` | by which a Gaussian's motion is multiplied |

use super::Linear;
use super::gaussians::retain_chunks;
use super::network::finite;
use crate::error::{Error, Result};

/// Most octaves of the centre's encoding, and their number in the released codes.
pub const FIELD_MOST_OCTAVES: usize = 10;
/// Octaves of time where it enters directly, and before the network of time.
pub const FIELD_TIME_OCTAVES: [usize; 2] = [10, 6];
/// Hidden values and outputs of the network of time.
pub const FIELD_TIME_NETWORK: [usize; 2] = [256, 30];
/// Most resolutions of planes.
pub const FIELD_MOST_SCALES: usize = 8;
/// Most hidden layers.
pub const FIELD_MOST_LAYERS: usize = 16;
/// Widest layer.
pub const FIELD_MOST_WIDTH: usize = 2048;
/// The coordinates (0 to 2: x, y, z; 3: t) of the six planes: along W, along H.
pub const FIELD_PAIRS: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// A deformation field.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeformationField {
    /// What the perceptron sees of a point and the time.
    pub input: FieldInput,
    /// Hidden layers.
    pub layers: Vec<Linear>,
    /// The last layer, without ReLU.
    pub head: Linear,
    /// Points that move instead of the Gaussians themselves.
    pub nodes: Option<ControlNodes>,
}

/// What the perceptron sees of a point and the time.
#[derive(Debug, Clone, PartialEq)]
pub enum FieldInput {
    /// `[x, sin 2ᵏx, cos 2ᵏx, …]` of the centre, then time: encoded with 10 octaves, or with 6 and then by a network of its
    /// own, 13 → 256 → ReLU → 30 (Deformable-3DGS, SC-GS).
    Waves {
        /// Octaves of the centre, at most [`FIELD_MOST_OCTAVES`]; in the model file the first layer's inputs say it.
        octaves: usize,
        /// The network of time.
        time: Option<[Linear; 2]>,
    },
    /// At each resolution the product of six planes, interpolated bilinearly (4D-GS).
    Planes(FieldPlanes),
}

impl Default for FieldInput {
    fn default() -> Self {
        Self::Waves { octaves: FIELD_MOST_OCTAVES, time: None }
    }
}

/// Planes over pairs of x, y, z and t ([`FIELD_PAIRS`]). A centre is taken to −1…1 between `bounds`; time enters as it is, as
/// in the released code, so that times from 0 to 1 use the upper half of their axis.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FieldPlanes {
    /// What −1 and 1 of each axis are, world units.
    pub bounds: [[f32; 3]; 2],
    /// Channels of every plane.
    pub channels: usize,
    /// Six planes of each resolution.
    pub scales: Vec<[FieldPlane; 6]>,
}

/// One plane.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FieldPlane {
    /// Values along the second coordinate.
    pub height: usize,
    /// Values along the first coordinate.
    pub width: usize,
    /// `[channels, height, width]`.
    pub values: Vec<f32>,
}

/// Control nodes (SC-GS): the field moves these, and each Gaussian follows some of them. With 14 outputs of the head the last
/// four, added to the quaternion 1, turn what is around a node.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ControlNodes {
    /// `[M]` at rest, world units.
    pub position: Vec<[f32; 3]>,
    /// K.
    pub neighbors: usize,
    /// `[N,K]` nodes.
    pub neighbor: Vec<u32>,
    /// `[N,K]` weights, whose sum is 1.
    pub weight: Vec<f32>,
    /// `[N]` by which a Gaussian's motion is multiplied.
    pub share: Vec<f32>,
}

/// What the outputs of the head mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldRule {
    /// dx 3, dq 4 (w,x,y,z), ds 3: μ + dx, norm(norm(q) + dq), exp(log_scale) + ds (Deformable-3DGS, SC-GS).
    Added = 0,
    /// w 3, v 3, dq, ds: the centre moves by the screw exp(θ (w, v)), θ = |w|, w and v divided by θ (Deformable-3DGS 6-DoF).
    Screw = 1,
    /// dx 3, dq 4, dl 3: μ + dx, norm(q + dq) of the quaternion as stored, exp(log_scale + dl) (4D-GS).
    Raw = 2,
}

impl FieldInput {
    /// Values that stand for the time beside an encoded centre.
    pub fn time_width(has_network: bool) -> usize {
        if has_network { FIELD_TIME_NETWORK[1] } else { 1 + 2 * FIELD_TIME_OCTAVES[0] }
    }

    /// Octaves of the centre in an input of `width` values; `None` when no number of octaves gives it.
    pub fn octaves_of(width: usize, has_time_network: bool) -> Option<usize> {
        let waves = width.checked_sub(3 + Self::time_width(has_time_network))?;
        (waves.is_multiple_of(6) && waves / 6 <= FIELD_MOST_OCTAVES).then_some(waves / 6)
    }

    /// Values that the perceptron sees.
    pub fn width(&self) -> usize {
        match self {
            Self::Waves { octaves, time } => 3 + 6 * octaves + Self::time_width(time.is_some()),
            Self::Planes(planes) => planes.channels * planes.scales.len(),
        }
    }
}

impl ControlNodes {
    /// Whether nodes turn what is around them, for a head of `outputs`.
    pub fn turn(outputs: usize) -> bool {
        outputs == 14
    }
}

impl DeformationField {
    /// What the outputs mean.
    pub fn rule(&self) -> FieldRule {
        match (&self.input, self.head.outputs) {
            (FieldInput::Planes(_), _) => FieldRule::Raw,
            (FieldInput::Waves { .. }, 13) => FieldRule::Screw,
            (FieldInput::Waves { .. }, _) => FieldRule::Added,
        }
    }

    /// The layer (the head is the last one) that sees the input again, before what the layer below gave.
    pub fn skip_layer(&self) -> Option<usize> {
        let all: Vec<&Linear> = self.all_layers().collect();
        (1..all.len()).find(|&i| all[i].inputs != all[i - 1].outputs)
    }

    /// Hidden layers, then the head.
    pub fn all_layers(&self) -> impl Iterator<Item = &Linear> {
        self.layers.iter().chain([&self.head])
    }

    /// Every layer with its name in the model file.
    pub fn named_layers(&self) -> Vec<(String, &Linear)> {
        let hidden = self.layers.iter().enumerate().map(|(i, l)| (format!("field.layer.{i}"), l));
        let time = match &self.input {
            FieldInput::Waves { time: Some(layers), .. } => &layers[..],
            _ => &[],
        };
        let time = time.iter().enumerate().map(|(i, l)| (format!("field.time.{i}"), l));
        hidden.chain([("field.head".to_owned(), &self.head)]).chain(time).collect()
    }

    /// Products of one evaluation.
    pub fn products(&self) -> usize {
        self.all_layers().map(|l| l.inputs * l.outputs).sum()
    }

    /// Refuses what does not fit together, for a scene of `gaussians`.
    ///
    /// # Errors
    /// `Usage` naming the tensor, what was found and what is possible.
    pub fn check(&self, gaussians: usize) -> Result<()> {
        self.check_input()?;
        self.check_layers()?;
        self.nodes.as_ref().map_or(Ok(()), |nodes| nodes.check(gaussians))
    }

    /// Keeps the Gaussians for which `keep` is true, in all arrays that have a row for each.
    pub(super) fn retain(&mut self, keep: &[bool]) {
        if let Some(nodes) = &mut self.nodes {
            retain_chunks(&mut nodes.neighbor, nodes.neighbors, keep);
            retain_chunks(&mut nodes.weight, nodes.neighbors, keep);
            retain_chunks(&mut nodes.share, 1, keep);
        }
    }

    fn check_input(&self) -> Result<()> {
        match &self.input {
            FieldInput::Waves { octaves, .. } if *octaves > FIELD_MOST_OCTAVES => Err(Error::usage(
                "field, octaves of the centre",
                octaves.to_string(),
                format!("0 to {FIELD_MOST_OCTAVES}"),
            )),
            FieldInput::Waves { time: None, .. } => Ok(()),
            FieldInput::Waves { time: Some([first, second]), .. } => {
                let [hidden, outputs] = FIELD_TIME_NETWORK;
                first.check("field.time.0", [1 + 2 * FIELD_TIME_OCTAVES[1], hidden])?;
                second.check("field.time.1", [hidden, outputs])
            }
            FieldInput::Planes(planes) => planes.check(),
        }
    }

    fn check_layers(&self) -> Result<()> {
        let usage = |what: String, found: String, expected: &str| Err(Error::usage(what, found, expected));
        if !(1..=FIELD_MOST_LAYERS).contains(&self.layers.len()) {
            return usage("field.layer".into(), self.layers.len().to_string(), "1 to 16 hidden layers");
        }
        let seen = self.input.width();
        let skip = self.skip_layer();
        let mut below = 0;
        for (i, layer) in self.all_layers().enumerate() {
            let name = if i < self.layers.len() { format!("field.layer.{i}") } else { "field.head".into() };
            if layer.outputs == 0 || layer.outputs > FIELD_MOST_WIDTH {
                return usage(name, format!("{} outputs", layer.outputs), "1 to 2048");
            }
            let again = if i == 0 || skip == Some(i) { seen } else { 0 };
            layer.check(&name, [again + below, layer.outputs])?;
            below = layer.outputs;
        }
        let possible: &[usize] = match (&self.input, &self.nodes) {
            (FieldInput::Planes(_), _) => &[10],
            (FieldInput::Waves { .. }, None) => &[10, 13],
            (FieldInput::Waves { .. }, Some(_)) => &[10, 14],
        };
        if !possible.contains(&self.head.outputs) {
            return usage("field.head".into(), format!("{} outputs", self.head.outputs), &format!("{possible:?}"));
        }
        if matches!(self.input, FieldInput::Planes(_)) && self.nodes.is_some() {
            return usage("field.node.position".into(), "nodes beside planes".into(), "nodes with encoded centres");
        }
        Ok(())
    }
}

impl FieldPlanes {
    fn check(&self) -> Result<()> {
        let sizes = (0..3).map(|a| self.bounds[1][a] - self.bounds[0][a]);
        if !sizes.into_iter().all(f32::is_normal) {
            return Err(Error::usage("field.bounds", format!("{:?}", self.bounds), "a box with a size"));
        }
        if self.channels == 0 || !(1..=FIELD_MOST_SCALES).contains(&self.scales.len()) {
            let found = format!("{} resolutions of {} channels", self.scales.len(), self.channels);
            return Err(Error::usage("field.plane", found, "1 to 8 resolutions of at least one channel"));
        }
        for (s, planes) in self.scales.iter().enumerate() {
            for (p, plane) in planes.iter().enumerate() {
                let expected = plane.height.checked_mul(plane.width).and_then(|n| n.checked_mul(self.channels));
                if plane.values.is_empty() || expected != Some(plane.values.len()) {
                    let found = format!("{} values for {} x {}", plane.values.len(), plane.height, plane.width);
                    let expected = format!("{} channels of each", self.channels);
                    return Err(Error::usage(format!("field.plane.{s}.{p}"), found, expected));
                }
                finite(&format!("field.plane.{s}.{p}"), &plane.values)?;
            }
        }
        Ok(())
    }
}

impl ControlNodes {
    fn check(&self, gaussians: usize) -> Result<()> {
        let (m, k) = (self.position.len(), self.neighbors);
        let found = [self.neighbor.len(), self.weight.len(), self.share.len()];
        if m == 0 || k == 0 || found != [gaussians * k, gaussians * k, gaussians] {
            let expected = format!("nodes, and for {gaussians} Gaussians as many weights as neighbours");
            return Err(Error::usage("field.node", format!("{m} nodes, {k} neighbours, {found:?}"), expected));
        }
        if let Some(i) = self.neighbor.iter().position(|&j| j as usize >= m) {
            let found = format!("{} at element {i}", self.neighbor[i]);
            return Err(Error::usage("field.node.neighbor", found, format!("indices below M = {m}")));
        }
        finite("field.node.position", self.position.as_flattened())?;
        finite("field.node.weight", &self.weight)?;
        finite("field.node.share", &self.share)
    }
}
