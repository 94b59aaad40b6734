//! SC-GS (Huang et al. 2024): control nodes that a network moves; each Gaussian follows the three nearest.
//!
//! `nodes` `[M,3+H]` (place and H further coordinates), `_node_radius` `[M]` (logarithms), `_node_weight` `[M,1]` (logits),
//! `network.*` as Deformable-3DGS's, with `network.local_rotation` when nodes turn what is around them. The point cloud has H
//! further coordinates `fea_*` of each Gaussian, and with one more the logit of how much it moves.
//!
//! Weights are w ∝ sigmoid(weight)·exp(−d²/2r²) + 10⁻⁷ over the three nearest nodes in all 3 + H coordinates. The centre
//! moves by Σ w·Δ of the nodes, or, where nodes turn, to Σ w·(R(x − n) + n + Δ); Σ w·Δq is added to the raw quaternion.

use std::path::Path;

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::deformable::Network;
use super::per_gaussian::{Deformation, Placed};
use crate::error::{Error, Result};
use crate::file::codec::unit;
use crate::file::torch::Weights;
use crate::scene::Gaussians;

/// Nodes that a Gaussian follows.
const NEAREST: usize = 3;
/// Added to every weight, so that far Gaussians have some.
const WEIGHT_MIN: f64 = 1.0e-7;

/// Nodes, and what each Gaussian follows.
pub(super) struct Nodes {
    place: Vec<[f32; 3]>,
    network: Network,
    /// `[N]` nodes and weights.
    follows: Vec<[(usize, f64); NEAREST]>,
    /// `[N]` how much a Gaussian moves.
    moves: Vec<f64>,
}

impl Nodes {
    /// `features`: `[N,F]` of the point cloud.
    pub(super) fn read(weights: &Weights<'_>, g: &Gaussians, features: &[f32], path: &Path) -> Result<Self> {
        let (nodes, shape) = weights.floats("nodes", &[None, None])?;
        let (m, width) = (shape[0], shape[1]);
        let hyper = width.checked_sub(3).ok_or_else(|| {
            Error::corrupt(path, "tensor `nodes`", format!("{shape:?}"), "at least 3 coordinates each")
        })?;
        let n = g.len();
        let given = features.len() / n.max(1);
        if m < NEAREST || (given != hyper && given != hyper + 1) {
            let found = format!("{m} nodes of {hyper} further coordinates, Gaussians of {given}");
            return Err(Error::corrupt(path, "tensor `nodes`", found, "3 nodes or more, and as many coordinates"));
        }
        let (radius, _) = weights.floats("_node_radius", &[Some(m)])?;
        let weight = if weights.has("_node_weight") {
            weights.floats("_node_weight", &[Some(m), Some(1)])?.0
        } else {
            vec![f32::INFINITY; m]
        };
        let sigmoid = |v: f32| 1.0 / (1.0 + (-f64::from(v)).exp());
        let follow = |i: usize| {
            let at = |c: usize| f64::from(if c < 3 { g.mean[i][c] } else { features[i * given + c - 3] });
            let squared = |j: usize| (0..width).map(|c| (at(c) - f64::from(nodes[j * width + c])).powi(2)).sum::<f64>();
            let mut order: Vec<(f64, usize)> = (0..m).map(|j| (squared(j), j)).collect();
            order.select_nth_unstable_by(NEAREST - 1, |a, b| a.0.total_cmp(&b.0));
            let raw: [(usize, f64); NEAREST] = std::array::from_fn(|k| {
                let (d2, j) = order[k];
                let r = f64::from(radius[j]).exp();
                (j, sigmoid(weight[j]) * (-d2 / (2.0 * r * r)).exp() + WEIGHT_MIN)
            });
            let sum: f64 = raw.iter().map(|(_, w)| w).sum();
            raw.map(|(j, w)| (j, w / sum))
        };
        let moves = |i: usize| if given > hyper { sigmoid(features[i * given + hyper]) } else { 1.0 };
        Ok(Self {
            place: nodes.chunks_exact(width).map(|p| [p[0], p[1], p[2]]).collect(),
            network: Network::read(weights, "network.", path)?,
            follows: (0..n).into_par_iter().map(follow).collect(),
            moves: (0..n).map(moves).collect(),
        })
    }
}

/// Smallest standard deviation that an offset can leave, as its logarithm: the smallest that can be drawn.
const MIN_LOG_SCALE: f32 = -30.0;

impl Deformation for Nodes {
    fn place(&self, g: &Gaussians, time: f64) -> Vec<Placed> {
        let moved = self.network.offsets_of(&self.place, time);
        let turns: Option<Vec<DQuat>> = moved.iter().map(|o| o.local_rotation.map(turn)).collect();
        let placed = |i: usize| {
            let x = promote(g.mean[i]);
            let (mut mean, mut rotation, mut scale) = (DVec3::ZERO, [0.0; 4], DVec3::ZERO);
            for &(j, w) in &self.follows[i] {
                let (node, offset) = (promote(self.place[j]), &moved[j]);
                let delta = promote(offset.mean);
                mean += w * turns.as_ref().map_or(delta, |t| t[j] * (x - node) + node + delta - x);
                scale += w * promote(offset.scale);
                (0..4).for_each(|c| rotation[c] += w * f64::from(offset.rotation[c]));
            }
            let much = self.moves[i];
            let raw = std::array::from_fn(|c| g.rotation[i][c] + (much * rotation[c]) as f32);
            let log_scale =
                |a: usize| (g.log_scale[i][a].exp() + (much * scale[a]) as f32).max(0.0).ln().max(MIN_LOG_SCALE);
            Placed {
                mean: (x + much * mean).as_vec3().to_array(),
                rotation: unit(raw),
                log_scale: std::array::from_fn(log_scale),
            }
        };
        (0..g.len()).into_par_iter().map(placed).collect()
    }
}

/// The identity plus an offset, normalised.
fn turn(offset: [f32; 4]) -> DQuat {
    let [w, x, y, z] = unit([offset[0] + 1.0, offset[1], offset[2], offset[3]]);
    DQuat::from_xyzw(x, y, z, w)
}

fn promote(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}
