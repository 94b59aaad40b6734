//! Kernel `deform_network`: network F for all M superpoints in one dispatch.
//!
//! Reads the frame's time, `superpoint_position float[M][3]` (world units) and `weights` ([`pack_weights`]); writes
//! `pose vec4[M][2]`: (r, 0) radians and (τ, 0) world units, a one-key table for `deform_project`. Source: SP-GS appendix
//! (8 layers of 256 or smaller, see [`DeformSize`]; encodings of 10 and 6 octaves). Sines of up to 2⁹ x are reduced accurately.

use super::angle::sin_cos;
use super::frame::Frame;
use super::half;
use super::twin::{f32_at, set_vec4, struct_at};
use crate::error::{Error, Result};
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Tolerance, Workload};
use crate::scene::network::{DeformSize, ENCODING_WIDTH, POSITION_FREQUENCIES, relu};
use crate::scene::{DeformNetwork, Linear};

/// Superpoints per workgroup.
pub const DEFORM_NETWORK_SUPERPOINTS: u32 = 8;
/// Slices of the hidden activations, for the heads.
const SLICES: usize = 32;
/// Encoded inputs, padded with zeros to a multiple of 8.
const ENCODING: usize = ENCODING_WIDTH.next_multiple_of(8);
/// Inputs that encode the position.
const POSITION_INPUTS: usize = 3 + 6 * POSITION_FREQUENCIES;

crate::gpu_constants! {
    /// Specialisation constants of [`DEFORM_NETWORK`].
    pub struct DeformNetworkConstants {
        /// 1: hidden matrices are halves.
        fp16_weights,
        /// Hidden layers.
        layers,
        /// Their width.
        width,
        /// The layer that sees the encoding again; `layers` for none.
        skip_layer,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`DEFORM_NETWORK`].
    pub struct DeformNetworkBuffers {
        frame: Read Struct(Frame),
        superpoint_position: Read F32,
        weights: Read U32,
        pose: Write F32,
    }
}

crate::kernel! {
    /// Network F live: pose of every superpoint at the frame's time.
    pub static DEFORM_NETWORK: DeformNetworkKernel = {
        name: "deform_network",
        doc: "network F: superpoint centre and time to so(3) vector and translation",
        local_size: DeformSize::MOST_WIDTH as u32,
        constants: DeformNetworkConstants,
        push: (),
        buffers: DeformNetworkBuffers,
        twin: deform_network_twin,
        // Sums of up to 332 products, contracted to fused multiply-adds or not.
        tolerance: Tolerance { absolute: 2e-5, relative: 2e-5, flips: 0.0 },
        bytes: deform_network_bytes,
    }
}

/// The weights once, each centre and pose once.
fn deform_network_bytes(work: &Workload) -> u64 {
    work.get("network_bytes") + work.get("superpoints") * (12 + 32)
}

/// Workgroups for that many superpoints.
pub fn groups(superpoints: u32) -> u64 {
    superpoints.div_ceil(DEFORM_NETWORK_SUPERPOINTS).into()
}

impl DeformNetworkConstants {
    /// For a network of that size.
    pub fn new(size: DeformSize, fp16: bool) -> Self {
        let skip_layer = size.skip_layer().unwrap_or(size.layers) as u32;
        Self { fp16_weights: fp16.into(), layers: size.layers as u32, width: size.width as u32, skip_layer }
    }
}

/// Inputs of hidden layer `i`, padded.
fn padded_inputs(size: DeformSize, i: usize) -> usize {
    size.layer_inputs(i).next_multiple_of(8)
}

/// 32-bit words of the packed weights.
pub fn weight_words(size: DeformSize, fp16: bool) -> usize {
    let layer = |i: usize| padded_inputs(size, i) * size.width / if fp16 { 2 } else { 1 } + size.width;
    (0..size.layers).map(layer).sum::<usize>() + 8 * (size.width + 1)
}

/// The `weights` buffer, in words of 16 bytes: for each hidden layer the matrix `[inputs/4][width]`, a word holding four
/// successive inputs of one output (with `fp16` `[inputs/8][width]`, eight halves, rounded to nearest even, the first in the
/// lowest bits), and its bias `[width/4]`; then the heads `[width][2]`, (r, 0) and (τ, 0), and their bias `[2]`. The encoding's 76
/// inputs are padded to 80 with zeros. Heads and biases stay f32.
pub fn pack_weights(network: &DeformNetwork, fp16: bool) -> Result<Vec<u32>> {
    network.check_shapes()?;
    check_finite(network)?;
    let size = network.size();
    let mut words = Vec::with_capacity(weight_words(size, fp16));
    for (i, layer) in network.linear.iter().enumerate() {
        let at = |input: usize, output: usize| padded_weight(layer, input, output);
        let per_word = if fp16 { 8 } else { 4 };
        for first in (0..padded_inputs(size, i)).step_by(per_word) {
            for output in 0..size.width {
                if fp16 {
                    for input in (first..first + 8).step_by(2) {
                        let (a, b) = (weight_half(at(input, output), i)?, weight_half(at(input + 1, output), i)?);
                        words.push(u32::from(a) | u32::from(b) << 16);
                    }
                } else {
                    words.extend((first..first + 4).map(|input| at(input, output).to_bits()));
                }
            }
        }
        words.extend(layer.bias.iter().map(|b| b.to_bits()));
    }
    let heads = [&network.rotation, &network.translation];
    for input in 0..size.width {
        for head in heads {
            words.extend((0..3).map(|o| head.weight[o * size.width + input].to_bits()));
            words.push(0);
        }
    }
    for head in heads {
        words.extend(head.bias.iter().map(|b| b.to_bits()));
        words.push(0);
    }
    Ok(words)
}

/// Weight from padded input `input` to `output`; the encoding (and its padding) comes before the hidden inputs.
fn padded_weight(layer: &Linear, input: usize, output: usize) -> f32 {
    let encoded = layer.inputs != layer.outputs;
    let column = match input {
        _ if !encoded => input,
        0..ENCODING_WIDTH => input,
        ENCODING_WIDTH..ENCODING => return 0.0,
        _ => input - (ENCODING - ENCODING_WIDTH),
    };
    layer.weight[output * layer.inputs + column]
}

fn check_finite(network: &DeformNetwork) -> Result<()> {
    for (name, layer) in network.named_layers() {
        if let Some((index, value)) = layer.weight.iter().chain(&layer.bias).enumerate().find(|(_, w)| !w.is_finite()) {
            return Err(Error::NonFinite { what: name, index, value: value.to_string() });
        }
    }
    Ok(())
}

/// Bits of the IEEE half nearest to `x`, ties to even.
fn weight_half(x: f32, layer: usize) -> Result<u16> {
    let magnitude = x.abs();
    if magnitude >= 65_520.0 {
        let what = format!("deform.linear.{layer}.weight in half precision");
        return Err(Error::usage(what, x.to_string(), "a magnitude below 65520"));
    }
    Ok(half::from_f32(x) as u16)
}

/// Element `e` of the encoded input.
fn encoded_input(position: [f32; 3], time: f32, e: usize) -> f32 {
    let (x, k, part) = match e {
        0..3 => (position[e], 0, 0),
        3..POSITION_INPUTS => (position[(e - 3) % 3], (e - 3) / 6, 1 + (e - 3) % 6 / 3),
        POSITION_INPUTS => (time, 0, 0),
        _ => (time, (e - POSITION_INPUTS - 1) / 2, 1 + (e - POSITION_INPUTS - 1) % 2),
    };
    if part == 0 { x } else { sin_cos(x * (1_u32 << k) as f32)[part - 1] }
}

/// Weight from padded input `offset` to output `o`, of a matrix that starts at 32-bit word `at`.
fn packed_weight(words: &[u32], at: usize, width: usize, fp16: bool, offset: usize, o: usize) -> f32 {
    if fp16 {
        let word = words[at + 4 * (offset / 8 * width + o) + offset % 8 / 2];
        half::to_f32(word >> (16 * (offset % 2)) & 0xFFFF)
    } else {
        f32_at(words, at + 4 * (offset / 4 * width + o) + offset % 4)
    }
}

/// (r, τ) of one superpoint.
fn evaluate(weights: &[u32], size: DeformSize, fp16: bool, position: [f32; 3], time: f32) -> [f32; 6] {
    let width = size.width;
    let mut activations = [0.0_f32; ENCODING + DeformSize::MOST_WIDTH];
    for e in 0..ENCODING_WIDTH {
        activations[e] = encoded_input(position, time, e);
    }
    let mut base = 0;
    for layer in 0..size.layers {
        let first = if layer == 0 || size.skip_layer() == Some(layer) { 0 } else { ENCODING };
        let end = if layer == 0 { ENCODING } else { ENCODING + width };
        let words = (end - first) * width / if fp16 { 2 } else { 1 };
        let mut sums: Vec<f32> = (0..width).map(|o| f32_at(weights, base + words + o)).collect();
        for i in first..end {
            for (o, sum) in sums.iter_mut().enumerate() {
                *sum += packed_weight(weights, base, width, fp16, i - first, o) * activations[i];
            }
        }
        base += words + width;
        (0..width).for_each(|o| activations[ENCODING + o] = relu(sums[o].into()) as f32);
    }
    std::array::from_fn(|o| {
        let column = |i: usize| f32_at(weights, base + 8 * i + o / 3 * 4 + o % 3);
        let slice = |k: usize| {
            (k * width / SLICES..(k + 1) * width / SLICES)
                .fold(0.0, |sum, i| sum + activations[ENCODING + i] * column(i))
        };
        (0..SLICES).fold(column(width), |total, k| total + slice(k))
    })
}

fn deform_network_twin(call: Call<'_, DeformNetworkKernel>) {
    let reached = call.group_count() * DEFORM_NETWORK_SUPERPOINTS;
    let Call { constants, buffers: b, .. } = call;
    let frame: Frame = struct_at(b.frame, 0);
    let fp16 = constants.fp16_weights == 1;
    let size = DeformSize { layers: constants.layers as usize, width: constants.width as usize };
    for m in 0..frame.superpoints.min(reached) as usize {
        let position = std::array::from_fn(|c| f32_at(b.superpoint_position, 3 * m + c));
        let [r0, r1, r2, t0, t1, t2] = evaluate(b.weights, size, fp16, position, frame.time);
        set_vec4(b.pose, 2 * m, [r0, r1, r2, 0.0]);
        set_vec4(b.pose, 2 * m + 1, [t0, t1, t2, 0.0]);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn linear(inputs: usize, outputs: usize, seed: &mut u32) -> Linear {
        let mut next = || {
            *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (*seed >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        let scale = 2.0 * (3.0 / inputs as f32).sqrt();
        Linear {
            inputs,
            outputs,
            weight: (0..inputs * outputs).map(|_| scale * next()).collect(),
            bias: (0..outputs).map(|_| 0.2 * next()).collect(),
        }
    }

    fn network(size: DeformSize) -> DeformNetwork {
        let mut seed = 7;
        DeformNetwork {
            linear: (0..size.layers).map(|i| linear(size.layer_inputs(i), size.width, &mut seed)).collect(),
            translation: linear(size.width, 3, &mut seed),
            rotation: linear(size.width, 3, &mut seed),
        }
    }

    /// F as the paper writes it, in f64.
    fn truth(network: &DeformNetwork, position: [f32; 3], time: f32) -> [f64; 6] {
        let mut encoding: Vec<f64> = position.iter().map(|&x| x.into()).collect();
        for k in 0..10 {
            encoding.extend(position.map(|x| (f64::from(x) * f64::from(1 << k)).sin()));
            encoding.extend(position.map(|x| (f64::from(x) * f64::from(1 << k)).cos()));
        }
        encoding.push(time.into());
        for k in 0..6 {
            encoding.push((f64::from(time) * f64::from(1 << k)).sin());
            encoding.push((f64::from(time) * f64::from(1 << k)).cos());
        }
        let apply = |l: &Linear, x: &[f64]| -> Vec<f64> {
            (0..l.outputs)
                .map(|o| {
                    let row = &l.weight[o * l.inputs..(o + 1) * l.inputs];
                    f64::from(l.bias[o]) + row.iter().zip(x).map(|(&w, x)| f64::from(w) * x).sum::<f64>()
                })
                .collect()
        };
        let mut h = encoding.clone();
        for (i, layer) in network.linear.iter().enumerate() {
            if network.size().skip_layer() == Some(i) {
                h = [encoding.clone(), h].concat();
            }
            h = apply(layer, &h).into_iter().map(relu).collect();
        }
        [apply(&network.rotation, &h), apply(&network.translation, &h)].concat().try_into().unwrap()
    }

    #[test]
    fn twin_agrees_with_f64() {
        for size in [DeformSize::PAPER, DeformSize { layers: 3, width: 96 }, DeformSize { layers: 1, width: 32 }] {
            check_twin(size);
        }
    }

    fn check_twin(size: DeformSize) {
        let network = network(size);
        let weights = pack_weights(&network, false).unwrap();
        assert_eq!(weights.len(), weight_words(size, false));
        let half_weights = pack_weights(&network, true).unwrap();
        assert_eq!(half_weights.len(), weight_words(size, true));
        for (position, time) in [([0.1, -0.7, 1.3], 0.0), ([9.7, -8.1, 3.3], 0.613), ([0.0; 3], 1.0)] {
            let truth = truth(&network, position, time);
            let norm: f64 = truth.iter().map(|v| v * v).sum::<f64>().sqrt();
            for (words, fp16, bound) in [(&weights, false, 5e-6), (&half_weights, true, 5e-3)] {
                let ours = evaluate(words, size, fp16, position, time);
                let error = ours.iter().zip(truth).map(|(&a, b)| (f64::from(a) - b).powi(2)).sum::<f64>().sqrt();
                assert!(error <= bound * norm, "fp16 {fp16}: {error:e} of {norm}");
            }
        }
    }

    #[test]
    fn halves_round_to_nearest_even() {
        for (x, bits) in [
            (0.0, 0),
            (-0.0, 0x8000),
            (1.0, 0x3C00),
            (-2.0, 0xC000),
            (65_504.0, 0x7BFF),
            (1.0 + 1.0 / 2048.0, 0x3C00),
            (1.0 + 3.0 / 2048.0, 0x3C02),
            (5.960_464_5e-8, 1),
            (2.980_232_2e-8, 0),
            (6.1e-5, 0x03FF),
        ] {
            assert_eq!(weight_half(x, 0).unwrap(), bits, "{x}");
        }
        for bits in 0..0x7C00_u32 {
            assert_eq!(u32::from(weight_half(half::to_f32(bits), 0).unwrap()), bits);
        }
        assert!(weight_half(65_520.0, 3).unwrap_err().to_string().contains("linear.3"));
    }

    #[test]
    fn wrong_shapes_and_values_are_named() {
        let mut n = network(DeformSize::PAPER);
        n.linear[5].inputs = 256;
        assert!(pack_weights(&n, false).unwrap_err().to_string().contains("deform.linear.5"));
        let mut n = network(DeformSize::PAPER);
        n.rotation.weight[9] = f32::NAN;
        assert!(pack_weights(&n, false).unwrap_err().to_string().contains("deform.rotation"));
        n.linear.pop();
        assert!(pack_weights(&n, true).is_err());
    }
}
