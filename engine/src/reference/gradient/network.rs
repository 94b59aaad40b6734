//! Gradients of networks F and G towards their weights, in f64.

use glam::DVec3;

use crate::reference::network::{Dense, Perceptron, deform_encoding, nonrigid_encoding};
use crate::scene::network::NONRIGID_LAYERS;
use crate::scene::{DeformNetwork, NonrigidNetwork};

/// Gradient of a dense layer.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LinearGradient {
    /// `[outputs, inputs]`.
    pub weight: Vec<f64>,
    /// `[outputs]`.
    pub bias: Vec<f64>,
}

/// Gradient of network F.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeformNetworkGradient {
    /// The 8 hidden layers.
    pub linear: Vec<LinearGradient>,
    /// Head of τ.
    pub translation: LinearGradient,
    /// Head of r.
    pub rotation: LinearGradient,
}

/// Gradient of network G.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NonrigidNetworkGradient {
    /// The 3 hidden layers.
    pub linear: Vec<LinearGradient>,
    /// Head of dx.
    pub translation: LinearGradient,
    /// Head of dq.
    pub rotation: LinearGradient,
    /// Head of ds.
    pub scaling: LinearGradient,
}

/// Gradient towards the weights of network F of a loss whose gradients towards the poses' so(3) vectors r and translations τ
/// at `time` are `d_rotation` and `d_translation`, one per superpoint of `positions`.
pub fn network_gradient(
    network: &DeformNetwork,
    positions: &[[f32; 3]],
    time: f64,
    d_rotation: &[DVec3],
    d_translation: &[DVec3],
) -> DeformNetworkGradient {
    let layers = network.linear.len();
    let network = Perceptron::of_deform(network);
    let mut sum = zero(&network);
    for ((position, r), t) in positions.iter().zip(d_rotation).zip(d_translation) {
        let upstream = [r.to_array(), t.to_array()].concat();
        accumulate(&network, &deform_encoding(position.map(f64::from), time), &upstream, &mut sum);
    }
    let heads = split(sum.pop(), &[3, 3]);
    let [rotation, translation] = heads.try_into().unwrap_or_default();
    sum.truncate(layers);
    DeformNetworkGradient { linear: sum, translation, rotation }
}

/// Gradient towards the weights of network G of a loss whose gradients towards the offsets (dx, dq w,x,y,z, ds) are
/// `d_offset`, one per rigidly moved centre of `centres`.
pub fn nonrigid_network_gradient(
    network: &NonrigidNetwork,
    centres: &[DVec3],
    time: f64,
    d_offset: &[[f64; 10]],
) -> NonrigidNetworkGradient {
    let network = Perceptron::of_nonrigid(network);
    let mut sum = zero(&network);
    for (centre, upstream) in centres.iter().zip(d_offset) {
        accumulate(&network, &nonrigid_encoding(*centre, time), upstream, &mut sum);
    }
    let heads = split(sum.pop(), &[3, 4, 3]);
    let [translation, rotation, scaling] = heads.try_into().unwrap_or_default();
    sum.truncate(NONRIGID_LAYERS);
    NonrigidNetworkGradient { linear: sum, translation, rotation, scaling }
}

fn zero(network: &Perceptron) -> Vec<LinearGradient> {
    let zero = |l: &Dense| LinearGradient { weight: vec![0.0; l.weight.len()], bias: vec![0.0; l.bias.len()] };
    network.layers.iter().map(zero).collect()
}

/// Rows of a layer as layers of their own, with these many outputs each.
fn split(layer: Option<LinearGradient>, outputs: &[usize]) -> Vec<LinearGradient> {
    let layer = layer.unwrap_or_default();
    let inputs = layer.weight.len() / layer.bias.len().max(1);
    let mut first = 0;
    let mut part = |&count: &usize| {
        let rows = first..first + count;
        first += count;
        let weight = layer.weight[rows.start * inputs..rows.end * inputs].to_vec();
        LinearGradient { weight, bias: layer.bias[rows].to_vec() }
    };
    outputs.iter().map(&mut part).collect()
}

/// Adds the gradients of one row, dL/d(output) = `upstream`.
fn accumulate(network: &Perceptron, encoding: &[f64], upstream: &[f64], sum: &mut [LinearGradient]) {
    let trace = network.trace(encoding);
    let mut d = upstream.to_vec();
    for (i, layer) in network.layers.iter().enumerate().rev() {
        let x = &trace.inputs[i];
        for (o, d) in d.iter().enumerate() {
            sum[i].bias[o] += d;
            let row = &mut sum[i].weight[o * layer.inputs..(o + 1) * layer.inputs];
            row.iter_mut().zip(x).for_each(|(w, x)| *w += d * x);
        }
        if i == 0 {
            return;
        }
        // The layer below made the last inputs; the encoding before them has no parameters.
        let first = layer.inputs - network.layers[i - 1].bias.len();
        d = (first..layer.inputs)
            .map(|k| {
                let through = || d.iter().zip(layer.column(k)).map(|(d, w)| d * w).sum();
                if x[k] > 0.0 { through() } else { 0.0 }
            })
            .collect();
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "tests")]
    use super::*;
    use crate::scene::DeformSize;
    use crate::scene::synthetic::Random;

    /// Σ upstream · output over the rows, and which neurons are on.
    fn loss(network: &Perceptron, rows: &[(Vec<f64>, Vec<f64>)]) -> (f64, Vec<bool>) {
        let (mut sum, mut on) = (0.0, Vec::new());
        for (encoding, upstream) in rows {
            let trace = network.trace(encoding);
            sum += trace.output.iter().zip(upstream).map(|(y, d)| y * d).sum::<f64>();
            on.extend(trace.inputs.iter().skip(1).flatten().map(|h| *h > 0.0));
        }
        (sum, on)
    }

    /// Central differences at `pairs` random weights and as many biases; pairs whose step crosses a kink are drawn again.
    fn check(mut network: Perceptron, rows: &[(Vec<f64>, Vec<f64>)], pairs: usize) {
        let mut gradient = zero(&network);
        rows.iter().for_each(|(encoding, upstream)| accumulate(&network, encoding, upstream, &mut gradient));
        let norm = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
        let mut random = Random::new(17);
        for bias in [false, true] {
            let (mut done, mut worst, mut crossed) = (0, 0.0_f64, 0);
            while done < pairs {
                let layer = random.below(network.layers.len());
                let analytic = if bias { &gradient[layer].bias } else { &gradient[layer].weight };
                let k = random.below(analytic.len());
                let (expected, scale) = (analytic[k], norm(analytic));
                let h = 1e-5;
                let l = &network.layers[layer];
                let at = k % l.inputs * l.bias.len() + k / l.inputs;
                let mut moved = |delta: f64| {
                    let l = &mut network.layers[layer];
                    let value = if bias { &mut l.bias[k] } else { &mut l.weight[at] };
                    let old = *value;
                    *value = old + delta;
                    let result = loss(&network, rows);
                    let l = &mut network.layers[layer];
                    *(if bias { &mut l.bias[k] } else { &mut l.weight[at] }) = old;
                    result
                };
                let ((high, on_high), (low, on_low)) = (moved(h), moved(-h));
                if on_high != on_low {
                    crossed += 1;
                    assert!(crossed < pairs, "{crossed} steps crossed a kink");
                    continue;
                }
                let error = ((high - low) / (2.0 * h) - expected).abs() / expected.abs().max(scale);
                worst = worst.max(error);
                assert!(error <= 1e-6, "layer {layer}, bias {bias}, {k}: {error:e} of {expected}");
                done += 1;
            }
            println!("bias {bias}: {done} pairs, worst {worst:.1e}, {crossed} crossed a kink");
        }
    }

    fn rows(count: usize, outputs: usize, encoding: impl Fn(DVec3) -> Vec<f64>) -> Vec<(Vec<f64>, Vec<f64>)> {
        let mut random = Random::new(5);
        let mut row = || {
            let x = encoding(random.normal3());
            (x, (0..outputs).map(|_| random.normal()).collect())
        };
        (0..count).map(|_| row()).collect()
    }

    #[test]
    fn network_f_agrees_with_central_differences() {
        for size in [DeformSize::PAPER, DeformSize { layers: 4, width: 64 }, DeformSize { layers: 1, width: 32 }] {
            let network = Perceptron::of_deform(&DeformNetwork::init(3, size, false));
            check(network, &rows(2, 6, |p| deform_encoding(p.to_array(), 0.3)), 500);
        }
    }

    #[test]
    fn network_g_agrees_with_central_differences() {
        let mut network = NonrigidNetwork::init(3);
        let mut random = Random::new(8);
        for head in [&mut network.translation, &mut network.rotation, &mut network.scaling] {
            head.weight.iter_mut().for_each(|w| *w = random.range(-0.1, 0.1) as f32);
        }
        check(Perceptron::of_nonrigid(&network), &rows(5, 10, |p| nonrigid_encoding(p, 0.3)), 500);
    }

    #[test]
    fn heads_are_told_apart() {
        let network = DeformNetwork::init(3, DeformSize::PAPER, false);
        let d = [DVec3::new(1.0, 2.0, 3.0)];
        let g = network_gradient(&network, &[[0.1, 0.2, 0.3]], 0.5, &d, &[DVec3::ZERO]);
        assert_eq!((g.linear.len(), g.rotation.bias.as_slice()), (8, [1.0, 2.0, 3.0].as_slice()));
        assert!(g.translation.weight.iter().chain(&g.translation.bias).all(|v| *v == 0.0));
        let offset = [[0.0, 0.0, 0.0, 4.0, 5.0, 6.0, 7.0, 0.0, 0.0, 0.0]];
        let g = nonrigid_network_gradient(&NonrigidNetwork::init(1), &[DVec3::ONE], 0.5, &offset);
        assert_eq!(g.rotation.bias, [4.0, 5.0, 6.0, 7.0]);
        assert!(g.scaling.bias.iter().chain(&g.translation.bias).all(|v| *v == 0.0));
    }
}
