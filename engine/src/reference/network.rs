//! Network F in f64, its f32 weights taken as exact numbers.

use glam::DVec3;
use rayon::prelude::*;

use super::motion::Pose;
use crate::scene::network::{ENCODING_WIDTH, POSITION_FREQUENCIES, SKIP_LAYER, TIME_FREQUENCIES};
use crate::scene::{DeformNetwork, Linear};

/// Poses of all superpoints at `time`; `position` are the canonical centres `[M,3]`.
pub fn network_poses(network: &DeformNetwork, position: &[[f32; 3]], time: f64) -> Vec<Pose> {
    position.par_iter().map(|p| network_pose(network, p.map(f64::from), time)).collect()
}

fn network_pose(network: &DeformNetwork, position: [f64; 3], time: f64) -> Pose {
    let mut encoding = Vec::with_capacity(ENCODING_WIDTH);
    encode(&position, POSITION_FREQUENCIES, &mut encoding);
    encode(&[time], TIME_FREQUENCIES, &mut encoding);
    let mut hidden = encoding.clone();
    for (i, layer) in network.linear.iter().enumerate() {
        if i == SKIP_LAYER {
            hidden.splice(0..0, encoding.iter().copied());
        }
        hidden = apply(layer, &hidden);
        hidden.iter_mut().for_each(|h| *h = h.max(0.0));
    }
    let vector = |head: &Linear| DVec3::from_slice(&apply(head, &hidden));
    Pose { rotation: vector(&network.rotation), translation: vector(&network.translation) }
}

/// Appends `[x, sin(2⁰x), cos(2⁰x), sin(2¹x), …]`, each over all components of x before the next.
fn encode(x: &[f64], frequencies: usize, out: &mut Vec<f64>) {
    out.extend_from_slice(x);
    for k in 0..frequencies {
        let scale = f64::from(1u32 << k);
        out.extend(x.iter().map(|x| (scale * x).sin()));
        out.extend(x.iter().map(|x| (scale * x).cos()));
    }
}

/// W x + b.
fn apply(layer: &Linear, x: &[f64]) -> Vec<f64> {
    let rows = layer.weight.chunks_exact(layer.inputs.max(1));
    rows.zip(&layer.bias)
        .map(|(row, &b)| row.iter().zip(x).map(|(&w, x)| f64::from(w) * x).sum::<f64>() + f64::from(b))
        .collect()
}
