//! Network F: superpoint centre and time in, pose out (`notes`: SP-GS appendix; 8 layers of 256, skip before layer 5).

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
}
