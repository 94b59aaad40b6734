//! Network F: superpoint centre and time in, pose out (`notes`: SP-GS appendix; 8 layers of 256, skip before layer 5).

use super::synthetic::Random;
use crate::error::{Error, Result};

/// A dense layer y = W x + b.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Linear {
    /// Inputs.
    pub inputs: usize,
    /// Outputs.
    pub outputs: usize,
    /// `[outputs, inputs]`, row-major.
    pub weight: Vec<f32>,
    /// `[outputs]`.
    pub bias: Vec<f32>,
}

/// Frequencies of the positional encoding of the centre (L = 10: 3 + 3·2·10 = 63 values).
pub const POSITION_FREQUENCIES: usize = 10;
/// Frequencies of the encoding of time (L = 6: 1 + 2·6 = 13 values).
pub const TIME_FREQUENCIES: usize = 6;
/// 63 + 13 inputs.
pub const ENCODING_WIDTH: usize = 3 + 6 * POSITION_FREQUENCIES + 1 + 2 * TIME_FREQUENCIES;
/// Width of each hidden layer.
pub const HIDDEN_WIDTH: usize = 256;
/// Number of hidden layers.
pub const HIDDEN_LAYERS: usize = 8;
/// This layer's input is `[encoding, h]`.
pub const SKIP_LAYER: usize = 5;

/// Weights of F. Encoding: `[x, sin(2^k x), cos(2^k x), …]` for the centre, then the same for time, no π, k-major;
/// ReLU after each of the 8 layers; two linear heads.
///
/// Tensors in the model file: `deform.linear.{0..7}.weight`, `deform.linear.{0..7}.bias`, `deform.translation.weight`,
/// `deform.translation.bias`, `deform.rotation.weight`, `deform.rotation.bias`; weights are `[outputs, inputs]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeformNetwork {
    /// The 8 hidden layers.
    pub linear: Vec<Linear>,
    /// 256 → 3, translation τ, world units.
    pub translation: Linear,
    /// 256 → 3, so(3) vector r, radians.
    pub rotation: Linear,
}

impl DeformNetwork {
    /// Inputs of hidden layer `i`.
    pub fn layer_inputs(i: usize) -> usize {
        match i {
            0 => ENCODING_WIDTH,
            SKIP_LAYER => ENCODING_WIDTH + HIDDEN_WIDTH,
            _ => HIDDEN_WIDTH,
        }
    }

    /// A new network by PyTorch's rule for `Linear`: weights and biases uniform in ±1/√inputs. With `zero_heads` both heads
    /// start at 0, so that nothing moves at first (SP-GS, section 3.3).
    pub fn init(seed: u64, zero_heads: bool) -> Self {
        let mut random = Random::new(seed);
        let mut linear = |inputs, outputs| Linear::uniform(inputs, outputs, &mut random);
        let hidden = (0..HIDDEN_LAYERS).map(|i| linear(Self::layer_inputs(i), HIDDEN_WIDTH)).collect();
        let (translation, rotation) = (linear(HIDDEN_WIDTH, 3), linear(HIDDEN_WIDTH, 3));
        let head = |layer: Linear| if zero_heads { layer.zeroed() } else { layer };
        Self { linear: hidden, translation: head(translation), rotation: head(rotation) }
    }

    /// Every layer with its name in the model file, in the order of [`DeformNetwork::flatten`].
    pub fn named_layers(&self) -> Vec<(String, &Linear)> {
        let hidden = self.linear.iter().enumerate().map(|(i, l)| (format!("deform.linear.{i}"), l));
        let heads = [("deform.translation", &self.translation), ("deform.rotation", &self.rotation)];
        hidden.chain(heads.map(|(name, l)| (name.to_owned(), l))).collect()
    }

    /// All weights and biases in one array: layers 0–7, translation, rotation; of each the weights, then the bias.
    pub fn flatten(&self) -> Vec<f32> {
        self.named_layers().iter().flat_map(|(_, l)| l.weight.iter().chain(&l.bias).copied()).collect()
    }

    /// Inverse of [`DeformNetwork::flatten`].
    pub fn from_flat(values: &[f32]) -> Result<Self> {
        let mut made = Self::init(0, true);
        let heads = [&mut made.translation, &mut made.rotation];
        fill_layers(made.linear.iter_mut().chain(heads), values, "network F")?;
        Ok(made)
    }

    /// Refuses layers of other shapes than network F's.
    pub fn check_shapes(&self) -> Result<()> {
        let layers = self.named_layers();
        let expected = |i: usize| match i {
            0..HIDDEN_LAYERS => (Self::layer_inputs(i), HIDDEN_WIDTH),
            _ => (HIDDEN_WIDTH, 3),
        };
        if layers.len() != HIDDEN_LAYERS + 2 {
            let found = self.linear.len().to_string();
            return Err(Error::usage("network F, hidden layers", found, HIDDEN_LAYERS.to_string()));
        }
        layers.iter().enumerate().try_for_each(|(i, (name, l))| l.check_shape(name, expected(i)))
    }
}

impl Linear {
    /// Weights and biases uniform in ±1/√inputs.
    fn uniform(inputs: usize, outputs: usize, random: &mut Random) -> Self {
        let bound = 1.0 / (inputs as f64).sqrt();
        let mut values = |count: usize| (0..count).map(|_| random.range(-bound, bound) as f32).collect();
        Self { inputs, outputs, weight: values(inputs * outputs), bias: values(outputs) }
    }

    /// The same shape, all zero.
    pub fn zeroed(&self) -> Self {
        let (weight, bias) = (vec![0.0; self.weight.len()], vec![0.0; self.bias.len()]);
        Self { inputs: self.inputs, outputs: self.outputs, weight, bias }
    }

    fn check_shape(&self, name: &str, (inputs, outputs): (usize, usize)) -> Result<()> {
        let found = [self.outputs, self.inputs, self.weight.len(), self.bias.len()];
        if found == [outputs, inputs, outputs * inputs, outputs] {
            return Ok(());
        }
        let [o, i, w, b] = found;
        let expected = format!("{outputs} x {inputs}, {} weights, {outputs} biases", outputs * inputs);
        Err(Error::usage(name, format!("{o} x {i}, {w} weights, {b} biases"), expected))
    }
}

/// Weights and bias of one layer after another from `values`, which must hold exactly as many.
fn fill_layers<'a>(layers: impl Iterator<Item = &'a mut Linear>, values: &[f32], what: &str) -> Result<()> {
    let mut rest = values;
    let layers: Vec<&mut Linear> = layers.collect();
    let count: usize = layers.iter().map(|l| l.weight.len() + l.bias.len()).sum();
    if values.len() != count {
        return Err(Error::usage(format!("{what}, values"), values.len().to_string(), count.to_string()));
    }
    for part in layers.into_iter().flat_map(|l| [&mut l.weight, &mut l.bias]) {
        let (head, tail) = rest.split_at(part.len());
        part.copy_from_slice(head);
        rest = tail;
    }
    Ok(())
}
