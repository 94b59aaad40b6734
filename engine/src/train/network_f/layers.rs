//! What the kernels of all layers share: constants, push constants, and where the layers are.

use super::HEADS;
use crate::scene::network::{DeformSize, ENCODING_WIDTH};
use crate::train::linear::Shape;

/// Threads of a workgroup.
pub(super) const THREADS: u32 = DeformSize::MOST_WIDTH as u32;
/// Rows of a workgroup. With few, many workgroups share the work; with many, fewer read all weights.
const ROWS: u32 = 4;

crate::gpu_constants! {
    /// Specialisation constants of the kernels of all layers.
    pub struct NetworkConstants {
        /// Hidden layers.
        layers,
        /// Their width.
        width,
        /// The layer that sees the encoding again; 0 for none.
        skip_layer,
        /// Rows of a workgroup, 4 or 8.
        rows,
    }
}

crate::gpu_struct! {
    /// Push constants of the kernels of all layers.
    pub struct NetworkPush {
        /// Superpoints.
        pub rows: u32,
        /// Floats from a hidden layer's `[rows, width]` to the next one's.
        pub layer_stride: u32,
    }
}

impl NetworkConstants {
    /// For a network of that size.
    pub fn new(size: DeformSize) -> Self {
        let skip_layer = size.skip_layer().unwrap_or(0) as u32;
        Self { layers: size.layers as u32, width: size.width as u32, skip_layer, rows: ROWS }
    }

    /// Workgroups for that many rows.
    pub fn groups(&self, rows: u32) -> u64 {
        rows.div_ceil(self.rows).into()
    }
}

/// Shapes of the hidden layers and of the heads.
pub(super) fn shapes(size: DeformSize) -> Vec<Shape> {
    let (width, encoding) = (size.width as u32, ENCODING_WIDTH as u32);
    let hidden = (0..size.layers).map(|i| match i {
        0 => Shape { inputs_0: encoding, inputs_1: 0, outputs: width },
        _ if size.skip_layer() == Some(i) => Shape { inputs_0: encoding, inputs_1: width, outputs: width },
        _ => Shape { inputs_0: width, inputs_1: 0, outputs: width },
    });
    hidden.chain([Shape { inputs_0: width, inputs_1: 0, outputs: HEADS }]).collect()
}

/// A layer of the twins: its shape and where its weights start, in floats.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layer {
    pub(super) shape: Shape,
    pub(super) first: usize,
}

/// Twin of `glsl/lib/network_layers.glsl`: the layers up from the first one.
pub(super) fn layers(constants: NetworkConstants) -> Vec<Layer> {
    let size = DeformSize { layers: constants.layers as usize, width: constants.width as usize };
    let mut first = 0;
    let mut place = |shape: Shape| {
        let layer = Layer { shape, first };
        first += shape.padded() as usize;
        layer
    };
    shapes(size).into_iter().map(&mut place).collect()
}
