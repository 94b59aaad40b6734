//! SC-GS (Huang et al. 2024): control nodes that a network moves; each Gaussian follows the three nearest.
//!
//! `nodes` `[M,3+H]` (place and H further coordinates), `_node_radius` `[M]` (logarithms), `_node_weight` `[M,1]` (logits),
//! `network.*` as Deformable-3DGS's, with `network.local_rotation` when nodes turn what is around them. The point cloud has H
//! further coordinates `fea_*` of each Gaussian, and with one more the logit of how much it moves.
//!
//! Weights are w ∝ sigmoid(weight)·exp(−d²/2r²) + 10⁻⁷ over the three nearest nodes in all 3 + H coordinates. The centre
//! moves by Σ w·Δ of the nodes, or, where nodes turn, to Σ w·(R(x − n) + n + Δ); Σ w·Δq is added to the raw quaternion.

use std::path::Path;

use rayon::prelude::*;

use super::deformable;
use crate::error::{Error, Result};
use crate::file::torch::Weights;
use crate::scene::Gaussians;
use crate::scene::field::{ControlNodes, DeformationField};

/// Nodes that a Gaussian follows.
const NEAREST: usize = 3;
/// Added to every weight, so that far Gaussians have some.
const WEIGHT_MIN: f64 = 1.0e-7;

/// Reads the field; `features`: `[N,F]` of the point cloud.
pub(super) fn read(weights: &Weights<'_>, g: &Gaussians, features: &[f32], path: &Path) -> Result<DeformationField> {
    let (nodes, shape) = weights.floats("nodes", &[None, None])?;
    let (m, width) = (shape[0], shape[1]);
    let hyper = width
        .checked_sub(3)
        .ok_or_else(|| Error::corrupt(path, "tensor `nodes`", format!("{shape:?}"), "at least 3 coordinates each"))?;
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
        raw.map(|(j, w)| (j as u32, (w / sum) as f32))
    };
    let follows: Vec<[(u32, f32); NEAREST]> = (0..n).into_par_iter().map(follow).collect();
    let share = |i: usize| if given > hyper { sigmoid(features[i * given + hyper]) as f32 } else { 1.0 };
    let nodes = ControlNodes {
        position: nodes.chunks_exact(width).map(|p| [p[0], p[1], p[2]]).collect(),
        neighbors: NEAREST,
        neighbor: follows.iter().flatten().map(|(j, _)| *j).collect(),
        weight: follows.iter().flatten().map(|(_, w)| *w).collect(),
        share: (0..n).map(share).collect(),
    };
    Ok(DeformationField { nodes: Some(nodes), ..deformable::read(weights, "network.", path)? })
}
