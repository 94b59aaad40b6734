//! Networks F (superpoint centre and time to pose; SP-GS appendix: 8 layers of 256, skip before layer 5) and G (moved
//! Gaussian centre and time to non-rigid offsets).

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

/// max(y, 0) that keeps NaN, as the kernels have it (`glsl/lib/relu.glsl`): a broken weight must not look like a neuron that
/// is off.
pub fn relu(y: f64) -> f64 {
    if y <= 0.0 { 0.0 } else { y }
}

/// The larger of two, or NaN when one is.
pub fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

/// How large network F is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct DeformSize {
    /// Hidden layers, 1 to [`DeformSize::MOST_LAYERS`].
    pub layers: usize,
    /// Outputs of each: a multiple of [`DeformSize::WIDTH_STEP`] up to [`DeformSize::MOST_WIDTH`].
    pub width: usize,
}

impl DeformSize {
    /// That of the paper: 8 layers of 256.
    pub const PAPER: Self = Self { layers: 8, width: 256 };
    /// Most hidden layers.
    pub const MOST_LAYERS: usize = 8;
    /// Widest hidden layer.
    pub const MOST_WIDTH: usize = 256;
    /// Widths are multiples of this.
    pub const WIDTH_STEP: usize = 32;

    /// The layer whose input is `[encoding, h]`: after half of the layers and one (SP-GS code, `skips = [D // 2]`); none in
    /// networks of one or two layers.
    pub fn skip_layer(self) -> Option<usize> {
        Some(self.layers / 2 + 1).filter(|&i| i < self.layers)
    }

    /// Inputs of hidden layer `i`.
    pub fn layer_inputs(self, i: usize) -> usize {
        match i {
            0 => ENCODING_WIDTH,
            _ if self.skip_layer() == Some(i) => ENCODING_WIDTH + self.width,
            _ => self.width,
        }
    }

    /// Products of one evaluation.
    pub fn products(self) -> usize {
        (0..self.layers).map(|i| self.layer_inputs(i) * self.width).sum::<usize>() + 6 * self.width
    }

    /// Refuses sizes that the kernels do not have.
    ///
    /// # Errors
    /// `Usage` naming what was found and what is possible.
    pub fn check(self) -> Result<()> {
        let step = Self::WIDTH_STEP;
        if !(1..=Self::MOST_LAYERS).contains(&self.layers) {
            return Err(Error::usage("network_layers", self.layers.to_string(), "1 to 8"));
        }
        if self.width == 0 || self.width > Self::MOST_WIDTH || !self.width.is_multiple_of(step) {
            let expected = format!("a multiple of {step} up to {}", Self::MOST_WIDTH);
            return Err(Error::usage("network_width", self.width.to_string(), expected));
        }
        Ok(())
    }
}

/// Weights of F. Encoding: `[x, sin(2^k x), cos(2^k x), …]` for the centre, then the same for time, no π, k-major;
/// ReLU after each hidden layer; two linear heads. Its size follows from the layers: see [`DeformSize`].
///
/// Tensors in the model file: `deform.linear.{i}.weight`, `deform.linear.{i}.bias` (i from 0, 8 layers of 256 in the paper),
/// `deform.translation.weight`, `deform.translation.bias`, `deform.rotation.weight`, `deform.rotation.bias`; weights are
/// `[outputs, inputs]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeformNetwork {
    /// The hidden layers.
    pub linear: Vec<Linear>,
    /// Width → 3, translation τ, world units.
    pub translation: Linear,
    /// Width → 3, so(3) vector r, radians.
    pub rotation: Linear,
}

impl DeformNetwork {
    /// Hidden layers and their width, as the layers say.
    pub fn size(&self) -> DeformSize {
        DeformSize { layers: self.linear.len(), width: self.linear.first().map_or(0, |l| l.outputs) }
    }

    /// A new network by PyTorch's rule for `Linear`: weights and biases uniform in ±1/√inputs. With `zero_heads` both heads
    /// start at 0, so that nothing moves at first (SP-GS, section 3.3).
    pub fn init(seed: u64, size: DeformSize, zero_heads: bool) -> Self {
        let mut random = Random::new(seed);
        let mut linear = |inputs, outputs| Linear::uniform(inputs, outputs, &mut random);
        let hidden = (0..size.layers).map(|i| linear(size.layer_inputs(i), size.width)).collect();
        let (translation, rotation) = (linear(size.width, 3), linear(size.width, 3));
        let head = |layer: Linear| if zero_heads { layer.zeroed() } else { layer };
        Self { linear: hidden, translation: head(translation), rotation: head(rotation) }
    }

    /// Every layer with its name in the model file, in the order of [`DeformNetwork::flatten`].
    pub fn named_layers(&self) -> Vec<(String, &Linear)> {
        let hidden = self.linear.iter().enumerate().map(|(i, l)| (format!("deform.linear.{i}"), l));
        let heads = [("deform.translation", &self.translation), ("deform.rotation", &self.rotation)];
        hidden.chain(heads.map(|(name, l)| (name.to_owned(), l))).collect()
    }

    /// All weights and biases in one array: hidden layers, translation, rotation; of each the weights, then the bias.
    pub fn flatten(&self) -> Vec<f32> {
        self.named_layers().iter().flat_map(|(_, l)| l.weight.iter().chain(&l.bias).copied()).collect()
    }

    /// Inverse of [`DeformNetwork::flatten`].
    pub fn from_flat(values: &[f32], size: DeformSize) -> Result<Self> {
        let mut made = Self::init(0, size, true);
        let heads = [&mut made.translation, &mut made.rotation];
        fill_layers(made.linear.iter_mut().chain(heads), values, "network F")?;
        Ok(made)
    }

    /// Refuses layers whose shapes are not those of a network of one width.
    pub fn check_shapes(&self) -> Result<()> {
        let size = self.size();
        size.check()?;
        let layers = self.named_layers();
        let expected = |i: usize| if i < size.layers { (size.layer_inputs(i), size.width) } else { (size.width, 3) };
        layers.iter().enumerate().try_for_each(|(i, (name, l))| l.check_shape(name, expected(i)))
    }

    /// [`DeformNetwork::check_shapes`], and finite numbers.
    pub(super) fn check(&self) -> Result<()> {
        self.check_shapes()?;
        self.named_layers().iter().try_for_each(|(name, l)| l.check_finite(name))
    }
}

/// Octaves of both encodings of network G.
pub const NONRIGID_FREQUENCIES: usize = 10;
/// Inputs of network G: 63 of the moved centre and 21 of time.
pub const NONRIGID_ENCODING: usize = 3 + 6 * NONRIGID_FREQUENCIES + 1 + 2 * NONRIGID_FREQUENCIES;
/// Width of its hidden layers.
pub const NONRIGID_WIDTH: usize = 64;
/// Its hidden layers.
pub const NONRIGID_LAYERS: usize = 3;
/// Outputs of its heads: translation, rotation, scaling.
pub const NONRIGID_HEADS: [usize; 3] = [3, 4, 3];
/// Rows of weights that the kernels hold for the heads: 10, padded to a multiple of 4.
pub const NONRIGID_ROWS: usize = 12;

/// Weights of G, the non-rigid stage (SP-GS, section 3.5): the rigidly moved centre and the time, each encoded with 10
/// octaves as in network F, through 84 → 64 → 64 → 64 with ReLU to three linear heads, whose values are added to the moved
/// centre, to the moved rotation (quaternion w,x,y,z, before it is normalised) and to the scale.
///
/// Tensors in the model file: `nonrigid.linear.{0..2}`, `nonrigid.translation`, `nonrigid.rotation`, `nonrigid.scaling`,
/// each with `.weight` (`[outputs, inputs]`) and `.bias`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NonrigidNetwork {
    /// The 3 hidden layers.
    pub linear: Vec<Linear>,
    /// 64 → 3, world units.
    pub translation: Linear,
    /// 64 → 4, w,x,y,z.
    pub rotation: Linear,
    /// 64 → 3, world units.
    pub scaling: Linear,
}

impl NonrigidNetwork {
    /// Inputs of hidden layer `i`.
    pub fn layer_inputs(i: usize) -> usize {
        if i == 0 { NONRIGID_ENCODING } else { NONRIGID_WIDTH }
    }

    /// A new network: hidden layers as [`DeformNetwork::init`], heads normal with deviation 10⁻⁶ and bias 0, so that the
    /// scene hardly changes at first.
    pub fn init(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let hidden =
            (0..NONRIGID_LAYERS).map(|i| Linear::uniform(Self::layer_inputs(i), NONRIGID_WIDTH, &mut random)).collect();
        let [translation, rotation, scaling] = NONRIGID_HEADS.map(|outputs| Linear {
            inputs: NONRIGID_WIDTH,
            outputs,
            weight: (0..NONRIGID_WIDTH * outputs).map(|_| (1e-6 * random.normal()) as f32).collect(),
            bias: vec![0.0; outputs],
        });
        Self { linear: hidden, translation, rotation, scaling }
    }

    /// Every layer with its name in the model file, in the order of [`NonrigidNetwork::flatten`].
    pub fn named_layers(&self) -> Vec<(String, &Linear)> {
        let hidden = self.linear.iter().enumerate().map(|(i, l)| (format!("nonrigid.linear.{i}"), l));
        let heads = ["translation", "rotation", "scaling"].into_iter().zip(self.heads());
        hidden.chain(heads.map(|(name, l)| (format!("nonrigid.{name}"), l))).collect()
    }

    /// Translation, rotation, scaling.
    pub fn heads(&self) -> [&Linear; 3] {
        [&self.translation, &self.rotation, &self.scaling]
    }

    /// Weights and bias of each layer as the kernels hold them: the three heads are one layer of 12 outputs, two of them 0.
    pub fn device_layers(&self) -> Result<Vec<Vec<f32>>> {
        self.check_shapes()?;
        let mut all: Vec<Vec<f32>> = self.linear.iter().map(|l| [l.weight.as_slice(), &l.bias].concat()).collect();
        let padding = NONRIGID_ROWS - NONRIGID_HEADS.iter().sum::<usize>();
        let mut head: Vec<f32> = self.heads().iter().flat_map(|l| l.weight.iter().copied()).collect();
        head.resize(NONRIGID_ROWS * NONRIGID_WIDTH, 0.0);
        head.extend(self.heads().iter().flat_map(|l| l.bias.iter().copied()).chain((0..padding).map(|_| 0.0)));
        all.push(head);
        Ok(all)
    }

    /// Inverse of [`NonrigidNetwork::device_layers`].
    pub fn from_device_layers(layers: &[Vec<f32>]) -> Result<Self> {
        let mut made = Self::init(0);
        for (layer, values) in made.linear.iter_mut().zip(layers) {
            fill_layers(std::iter::once(layer), values, "network G")?;
        }
        let expected = NONRIGID_ROWS * (NONRIGID_WIDTH + 1);
        let found = layers.get(NONRIGID_LAYERS).map_or(0, Vec::len);
        let (Some(head), true) = (layers.get(NONRIGID_LAYERS), found == expected) else {
            return Err(Error::usage("network G, values of the heads", found.to_string(), expected.to_string()));
        };
        let (weights, biases) = head.split_at(NONRIGID_ROWS * NONRIGID_WIDTH);
        let mut first = 0;
        for layer in [&mut made.translation, &mut made.rotation, &mut made.scaling] {
            let end = first + layer.outputs;
            layer.weight.copy_from_slice(&weights[first * NONRIGID_WIDTH..end * NONRIGID_WIDTH]);
            layer.bias.copy_from_slice(&biases[first..end]);
            first = end;
        }
        Ok(made)
    }

    /// All weights and biases in one array, in the order of the named layers; of each the weights, then the bias.
    pub fn flatten(&self) -> Vec<f32> {
        self.named_layers().iter().flat_map(|(_, l)| l.weight.iter().chain(&l.bias).copied()).collect()
    }

    /// Inverse of [`NonrigidNetwork::flatten`].
    pub fn from_flat(values: &[f32]) -> Result<Self> {
        let mut made = Self::init(0);
        let heads = [&mut made.translation, &mut made.rotation, &mut made.scaling];
        fill_layers(made.linear.iter_mut().chain(heads), values, "network G")?;
        Ok(made)
    }

    /// Refuses layers of other shapes than network G's.
    pub fn check_shapes(&self) -> Result<()> {
        if self.linear.len() != NONRIGID_LAYERS {
            let found = self.linear.len().to_string();
            return Err(Error::usage("network G, hidden layers", found, NONRIGID_LAYERS.to_string()));
        }
        let expected = |i: usize| match i {
            0..NONRIGID_LAYERS => (Self::layer_inputs(i), NONRIGID_WIDTH),
            _ => (NONRIGID_WIDTH, NONRIGID_HEADS[i - NONRIGID_LAYERS]),
        };
        let layers = self.named_layers();
        layers.iter().enumerate().try_for_each(|(i, (name, l))| l.check_shape(name, expected(i)))
    }

    /// [`NonrigidNetwork::check_shapes`], and finite numbers.
    pub(super) fn check(&self) -> Result<()> {
        self.check_shapes()?;
        self.named_layers().iter().try_for_each(|(name, l)| l.check_finite(name))
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

    /// Of this shape, `[inputs, outputs]`, and finite.
    pub(super) fn check(&self, name: &str, [inputs, outputs]: [usize; 2]) -> Result<()> {
        self.check_shape(name, (inputs, outputs))?;
        self.check_finite(name)
    }

    fn check_finite(&self, name: &str) -> Result<()> {
        finite(&format!("{name}.weight"), &self.weight)?;
        finite(&format!("{name}.bias"), &self.bias)
    }

    pub(super) fn check_shape(&self, name: &str, (inputs, outputs): (usize, usize)) -> Result<()> {
        let found = [self.outputs, self.inputs, self.weight.len(), self.bias.len()];
        if found == [outputs, inputs, outputs * inputs, outputs] {
            return Ok(());
        }
        let [o, i, w, b] = found;
        let expected = format!("{outputs} x {inputs}, {} weights, {outputs} biases", outputs * inputs);
        Err(Error::usage(name, format!("{o} x {i}, {w} weights, {b} biases"), expected))
    }
}

/// Refuses numbers that are not finite, naming the first.
pub(super) fn finite(name: &str, values: &[f32]) -> Result<()> {
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(i) => Err(Error::usage(name, format!("{} at element {i}", values[i]), "finite numbers")),
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
