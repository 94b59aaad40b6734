//! Deformable-3DGS (Yang et al. 2024): a network of centre and time that gives each Gaussian offsets.
//!
//! `linear.{0..7}` of width 256 with ReLU, the encoding again before layer 5, heads `gaussian_warp` (3),
//! `gaussian_rotation` (4, added to the unit quaternion), `gaussian_scaling` (3, added to the scale). Centres are encoded
//! with 10 octaves; time with 10, or, for synthetic data, with 6 and then by `timenet` to 30 values. Other numbers of
//! octaves do not show in the weights' shapes one by one, and are refused.

use std::path::Path;

use rayon::prelude::*;

use super::mlp::{LANES, Row, dense, encode, relu, row};
use super::per_gaussian::{Deformation, Placed, added};
use super::sp_gs::linear;
use crate::error::{Error, Result};
use crate::file::torch::Weights;
use crate::scene::{Gaussians, Linear};

/// Octaves of the centre.
const POSITION_OCTAVES: usize = 10;
/// Values of an encoded centre.
const POSITION_WIDTH: usize = 3 + 6 * POSITION_OCTAVES;
/// Octaves of time: without and with `timenet`.
const TIME_OCTAVES: [usize; 2] = [10, 6];
/// Outputs of `timenet`.
const TIME_WIDTH: usize = 30;
const WIDTH: usize = 256;
const LAYERS: usize = 8;
/// The layer before which the encoding comes in again.
const SKIP: usize = 5;

/// The network.
pub(super) struct Network {
    timenet: Option<[Linear; 2]>,
    layers: Vec<Linear>,
    warp: Linear,
    rotation: Linear,
    scaling: Linear,
    /// SC-GS: how a node turns what is around it.
    local_rotation: Option<Linear>,
}

/// What the network gives a point.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Offset {
    pub(super) mean: [f32; 3],
    /// w,x,y,z.
    pub(super) rotation: [f32; 4],
    pub(super) scale: [f32; 3],
    pub(super) local_rotation: Option<[f32; 4]>,
}

impl Network {
    /// Of tensors whose names begin with `prefix`.
    pub(super) fn read(weights: &Weights<'_>, prefix: &str, path: &Path) -> Result<Self> {
        let named = |name: &str| format!("{prefix}{name}");
        let has_timenet = weights.has(&named("timenet.0.weight"));
        let time = if has_timenet { TIME_WIDTH } else { 1 + 2 * TIME_OCTAVES[0] };
        let encoding = POSITION_WIDTH + time;
        let found = weights.shape(&named("linear.0.weight")).unwrap_or_default();
        if found != [WIDTH, encoding] {
            let octaves = if has_timenet { "6" } else { "10" };
            let expected = format!("[{WIDTH}, {encoding}]: 10 octaves of the centre, {octaves} of time");
            return Err(Error::corrupt(path, "tensor `linear.0.weight`", format!("{found:?}"), expected));
        }
        if weights.has(&named("branch_w.weight")) {
            let expected = "an offset of the centre (`gaussian_warp`)";
            return Err(Error::usage(format!("{}: motion", path.display()), "a screw motion (6-DoF)", expected));
        }
        let layer = |name: &str, inputs: usize, outputs: usize| linear(weights, &named(name), inputs, outputs, path);
        let inputs = |i: usize| match i {
            0 => encoding,
            SKIP => encoding + WIDTH,
            _ => WIDTH,
        };
        let timenet = if has_timenet {
            Some([layer("timenet.0", 1 + 2 * TIME_OCTAVES[1], WIDTH)?, layer("timenet.2", WIDTH, TIME_WIDTH)?])
        } else {
            None
        };
        let local = weights.has(&named("local_rotation.weight"));
        Ok(Self {
            timenet,
            layers: (0..LAYERS).map(|i| layer(&format!("linear.{i}"), inputs(i), WIDTH)).collect::<Result<_>>()?,
            warp: layer("gaussian_warp", WIDTH, 3)?,
            rotation: layer("gaussian_rotation", WIDTH, 4)?,
            scaling: layer("gaussian_scaling", WIDTH, 3)?,
            local_rotation: if local { Some(layer("local_rotation", WIDTH, 4)?) } else { None },
        })
    }

    /// The encoded time, the same in every lane.
    fn time(&self, time: f64) -> Vec<Row> {
        let t = [[time as f32; LANES]];
        match &self.timenet {
            None => encode(&t, TIME_OCTAVES[0]),
            Some([first, second]) => dense(second, &relu(dense(first, &encode(&t, TIME_OCTAVES[1])))),
        }
    }

    /// Offsets of all points at a time.
    pub(super) fn offsets_of(&self, points: &[[f32; 3]], time: f64) -> Vec<Offset> {
        let time = self.time(time);
        points.par_chunks(LANES).flat_map_iter(|chunk| self.chunk(chunk, &time)).collect()
    }

    /// Offsets of up to 16 points.
    fn chunk(&self, points: &[[f32; 3]], time: &[Row]) -> Vec<Offset> {
        let mut encoding = encode(&[0, 1, 2].map(|a| row(points, a)), POSITION_OCTAVES);
        encoding.extend_from_slice(time);
        let mut h = encoding.clone();
        for (i, layer) in self.layers.iter().enumerate() {
            if i == SKIP {
                h.splice(0..0, encoding.iter().copied());
            }
            h = relu(dense(layer, &h));
        }
        let (warp, rotation, scaling) = (dense(&self.warp, &h), dense(&self.rotation, &h), dense(&self.scaling, &h));
        let local = self.local_rotation.as_ref().map(|l| dense(l, &h));
        let offset = |lane: usize| Offset {
            mean: std::array::from_fn(|a| warp[a][lane]),
            rotation: std::array::from_fn(|c| rotation[c][lane]),
            scale: std::array::from_fn(|a| scaling[a][lane]),
            local_rotation: local.as_ref().map(|l| std::array::from_fn(|c| l[c][lane])),
        };
        (0..points.len()).map(offset).collect()
    }
}

/// Smallest standard deviation that an offset can leave, as its logarithm: the smallest that can be drawn.
const MIN_LOG_SCALE: f32 = -30.0;

impl Deformation for Network {
    fn place(&self, g: &Gaussians, time: f64) -> Vec<Placed> {
        let placed = |(i, o): (usize, &Offset)| {
            let log_scale = |a: usize| (g.log_scale[i][a].exp() + o.scale[a]).max(0.0).ln().max(MIN_LOG_SCALE);
            Placed { log_scale: std::array::from_fn(log_scale), ..added(g, i, &o.mean, &o.rotation) }
        };
        self.offsets_of(&g.mean, time).iter().enumerate().map(placed).collect()
    }
}
