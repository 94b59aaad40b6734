//! LPIPS v0.1 (Zhang, Isola, Efros, Shechtman, Wang: *The Unreasonable Effectiveness of Deep Features as a Perceptual
//! Metric*, CVPR 2018; the `lpips` package), with AlexNet or VGG-16 and the linear heads.
//!
//! A picture in [0, 1] is scaled to [−1, 1], then (x − shift)/scale per channel. A network of convolutions gives five
//! feature maps, each after its ReLU. Every pixel's features are divided by their length (+ 1e-10); the squared difference
//! of the two pictures is weighted by the linear head, averaged over the pixels, and summed over the five maps.
//!
//! The SP-GS code (and others of the 3DGS family) feeds [0, 1] where the package expects [−1, 1]; [`Range::ZeroToOne`]
//! reproduces that, to be compared with the paper's figures. The default is the package's own range.
//!
//! # Weights
//! They belong to their publishers and are not part of this project: a `.safetensors` file from the user. Tensors are f32,
//! row-major, convolutions `[out, in, height, width]`, biases `[out]`, heads `[1, channels, 1, 1]`, by the names of the
//! package's `state_dict()`: `net.slice{1..5}.{layer}.weight` and `.bias` (the layer is the index in torchvision's
//! `features`: 0, 3, 6, 8, 10 in AlexNet; 0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28 in VGG-16) and
//! `lin{0..4}.model.1.weight`. The aliases `lins.{0..4}.model.1.weight` are read in preference where both are there; other
//! tensors are ignored. Torchvision's own names (`features.{layer}.weight`) are taken too. Which network a file holds
//! follows from the shape of its first convolution; a file may hold both, with `alex.` and `vgg.` before each name. To
//! convert the published files, where Python, `lpips` and `safetensors` are at hand:
//!
//! ```text
//! python -c "import lpips, safetensors.torch as s
//! for net in ('alex', 'vgg'): s.save_file({k: v.clone().contiguous() for k, v in
//!     lpips.LPIPS(net=net).state_dict().items()}, f'lpips_{net}.safetensors')"
//! ```

mod device;
#[doc(hidden)]
pub mod lpips_conv;
#[doc(hidden)]
pub mod lpips_difference;
#[doc(hidden)]
pub mod lpips_pool;
mod network;
mod reference;
mod weights;

pub use device::Lpips;
pub use network::Network;
pub use reference::lpips;
pub use weights::{Weights, WeightsFile};

use super::planes::Planes;
use crate::error::{Error, Result};
use crate::gpu::kernel::{Kernel, Tolerance};
use crate::gpu::product::PRODUCT_THREADS;

/// Kernels of this module.
#[doc(hidden)]
pub static KERNELS: &[&Kernel] =
    &[&lpips_conv::LPIPS_CONV.kernel, &lpips_pool::LPIPS_POOL.kernel, &lpips_difference::LPIPS_DIFFERENCE.kernel];

/// Threads per workgroup.
const THREADS: u32 = PRODUCT_THREADS;
/// Sums of up to 4608 products of numbers around 1, fused or not, in another order than the twin's.
const SUMS: Tolerance = Tolerance { absolute: 1e-4, relative: 2e-5, flips: 0.0 };

/// What range of values a picture in [0, 1] is fed in.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub enum Range {
    /// [−1, 1], as the package expects.
    #[default]
    MinusOneToOne,
    /// [0, 1], as the SP-GS code feeds it.
    ZeroToOne,
}

/// Added to the length of a feature vector.
const EPSILON: f64 = 1.0e-10;
/// Subtracted from R, G, B.
const SHIFT: [f64; 3] = [-0.030, -0.088, -0.188];
/// Then divided by.
const SCALE: [f64; 3] = [0.458, 0.448, 0.450];

/// The network's input `[3, height, width]`.
fn input(planes: &Planes, range: Range) -> Vec<f64> {
    let stretch = |v: f64| match range {
        Range::MinusOneToOne => 2.0 * v - 1.0,
        Range::ZeroToOne => v,
    };
    (0..3).flat_map(|c| planes.rgb[c].iter().map(move |&v| (stretch(v) - SHIFT[c]) / SCALE[c])).collect()
}

/// A picture that the network's windows and pools leave something of.
fn check_size(network: Network, planes: &Planes) -> Result<()> {
    let smallest = network.smallest_side();
    if planes.width.min(planes.height) >= smallest {
        return Ok(());
    }
    let found = format!("{} x {} pixels", planes.width, planes.height);
    Err(Error::usage(format!("image for LPIPS ({})", network.name()), found, format!("{smallest} pixels a side")))
}

/// Word `i` as a float, for twins, whose sums are in f64.
fn value(words: &[u32], i: u32) -> f64 {
    f32::from_bits(words[i as usize]).into()
}
