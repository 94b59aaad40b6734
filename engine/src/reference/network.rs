//! Networks F and G in f64, their f32 weights taken as exact numbers.

use glam::DVec3;
use rayon::prelude::*;

use super::motion::{Offset, Pose};
use crate::scene::network::{NONRIGID_FREQUENCIES, POSITION_FREQUENCIES, TIME_FREQUENCIES, relu};
use crate::scene::{DeformNetwork, Linear, NonrigidNetwork};

/// Poses of all superpoints at `time`; `position` are the canonical centres `[M,3]`.
pub fn network_poses(network: &DeformNetwork, position: &[[f32; 3]], time: f64) -> Vec<Pose> {
    let network = Perceptron::of_deform(network);
    let pose = |p: &[f32; 3]| {
        let output = network.trace(&deform_encoding(p.map(f64::from), time)).output;
        Pose { rotation: DVec3::from_slice(&output[..3]), translation: DVec3::from_slice(&output[3..]) }
    };
    position.par_iter().map(pose).collect()
}

/// Offsets of Gaussians whose rigidly moved centres are `centre`.
pub fn nonrigid_offsets(network: &NonrigidNetwork, centre: &[DVec3], time: f64) -> Vec<Offset> {
    let network = Perceptron::of_nonrigid(network);
    let offset = |c: &DVec3| {
        let output = network.trace(&nonrigid_encoding(*c, time)).output;
        let part = |first: usize| std::array::from_fn(|i| output[first + i]);
        Offset { mean: part(0), rotation: std::array::from_fn(|i| output[3 + i]), scale: part(7) }
    };
    centre.par_iter().map(offset).collect()
}

/// Input of network F.
pub(super) fn deform_encoding(position: [f64; 3], time: f64) -> Vec<f64> {
    let mut encoding = Vec::new();
    encode(&position, POSITION_FREQUENCIES, &mut encoding);
    encode(&[time], TIME_FREQUENCIES, &mut encoding);
    encoding
}

/// Input of network G.
pub(super) fn nonrigid_encoding(centre: DVec3, time: f64) -> Vec<f64> {
    let mut encoding = Vec::new();
    encode(&centre.to_array(), NONRIGID_FREQUENCIES, &mut encoding);
    encode(&[time], NONRIGID_FREQUENCIES, &mut encoding);
    encoding
}

/// Appends `[x, sin(2⁰x), cos(2⁰x), sin(2¹x), …]`, each over all components of x before the next.
pub(super) fn encode(x: &[f64], frequencies: usize, out: &mut Vec<f64>) {
    out.extend_from_slice(x);
    for k in 0..frequencies {
        let scale = f64::from(1u32 << k);
        out.extend(x.iter().map(|x| (scale * x).sin()));
        out.extend(x.iter().map(|x| (scale * x).cos()));
    }
}

/// A dense layer y = W x + b in f64.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Dense {
    pub(super) inputs: usize,
    /// Wᵀ `[inputs, outputs]`: sums over the inputs then go side by side, and inputs that are 0 cost nothing.
    pub(super) weight: Vec<f64>,
    pub(super) bias: Vec<f64>,
}

/// Hidden layers with ReLU, one of which may see the encoding again before its input, then a linear head.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Perceptron {
    /// The hidden layers, then the head.
    pub(super) layers: Vec<Dense>,
    pub(super) skip: Option<usize>,
}

/// What a forward pass leaves for the backward pass.
#[derive(Debug, Clone, Default)]
pub(super) struct Trace {
    /// Input of each layer.
    pub(super) inputs: Vec<Vec<f64>>,
    pub(super) output: Vec<f64>,
}

impl Dense {
    /// Layers side by side: one output after another.
    pub(super) fn joined(layers: &[&Linear]) -> Self {
        let inputs = layers.first().map_or(0, |l| l.inputs);
        let column = |k: usize| layers.iter().flat_map(move |l| l.weight.iter().skip(k).step_by(inputs.max(1)));
        Self {
            inputs,
            weight: (0..inputs).flat_map(column).map(|&w| f64::from(w)).collect(),
            bias: layers.iter().flat_map(|l| &l.bias).map(|&b| f64::from(b)).collect(),
        }
    }

    /// The weights of input `k`, one per output.
    pub(super) fn column(&self, k: usize) -> &[f64] {
        let outputs = self.bias.len();
        &self.weight[k * outputs..(k + 1) * outputs]
    }

    fn apply(&self, x: &[f64]) -> Vec<f64> {
        let mut y = vec![0.0; self.bias.len()];
        for (k, &x) in x.iter().enumerate().filter(|(_, x)| **x != 0.0) {
            y.iter_mut().zip(self.column(k)).for_each(|(y, w)| *y += w * x);
        }
        y.iter_mut().zip(&self.bias).for_each(|(y, b)| *y += b);
        y
    }
}

impl Perceptron {
    /// Network F; its outputs are r, then τ.
    pub(super) fn of_deform(network: &DeformNetwork) -> Self {
        let mut layers: Vec<Dense> = network.linear.iter().map(|l| Dense::joined(&[l])).collect();
        layers.push(Dense::joined(&[&network.rotation, &network.translation]));
        Self { layers, skip: network.size().skip_layer() }
    }

    /// Network G; its outputs are dx, dq, ds.
    pub(super) fn of_nonrigid(network: &NonrigidNetwork) -> Self {
        let mut layers: Vec<Dense> = network.linear.iter().map(|l| Dense::joined(&[l])).collect();
        layers.push(Dense::joined(&network.heads()));
        Self { layers, skip: None }
    }

    pub(super) fn trace(&self, encoding: &[f64]) -> Trace {
        let mut trace = Trace::default();
        let mut values = encoding.to_vec();
        for (i, layer) in self.layers.iter().enumerate() {
            if self.skip == Some(i) {
                values.splice(0..0, encoding.iter().copied());
            }
            let outputs = layer.apply(&values);
            trace.inputs.push(values);
            values = outputs;
            if i + 1 < self.layers.len() {
                values.iter_mut().for_each(|h| *h = relu(*h));
            }
        }
        trace.output = values;
        trace
    }
}
