//! Exposures: what a camera made of each photo's colours (exposure time, white balance), learnt beside the scene so that the scene
//! need not explain it. A photo has an affine map c' = A·c + b of the rendered image's values, background included, as the released code of 3DGS has it since October
//! 2024 (`train_test_exp`); the loss compares what was rendered and then mapped.
//!
//! [`expose`] maps the image, [`exposure_backward`] takes the gradient back to it and to the map, [`learn_exposure`] steps, held to the
//! identity by λ·½‖(A, b) − (1, 0)‖². [`definition`] has the same in f64.

pub mod definition;
pub mod expose;
pub mod exposure_backward;
pub mod learn_exposure;
mod state;

use crate::gpu::kernel::Kernel;
use crate::image::Image;

pub use state::identities;
pub(in crate::train) use state::{ExposureInputs, ExposurePass, ExposureState};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] =
    &[&expose::EXPOSE.kernel, &exposure_backward::EXPOSURE_BACKWARD.kernel, &learn_exposure::LEARN_EXPOSURE.kernel];

/// Numbers of a map: rows of (red, green, blue, 1).
pub const EXPOSURE_VALUES: usize = 12;
/// First moments in a photo's row.
const EXPOSURE_MOMENT_1: usize = 12;
/// Second moments.
const EXPOSURE_MOMENT_2: usize = 24;
/// β₁ᵗ, β₂ᵗ after t updates.
const EXPOSURE_DECAY: usize = 36;
/// Words of a photo's row.
pub const EXPOSURE_WORDS: usize = 40;
/// Threads of a workgroup.
const EXPOSURE_THREADS: u32 = 256;
/// Pixels of a workgroup of [`exposure_backward`].
pub const EXPOSURE_PIXELS: u32 = 2048;
/// Adam's decays: a photo is seen in few of the steps.
const BETA: [f32; 2] = [0.9, 0.99];
const EPSILON: f32 = 1e-12;

/// Maps an image's colours as a photo's row of numbers says.
pub(in crate::train) fn exposed_image(row: &[f32], image: &mut Image) {
    for pixel in image.rgba.as_chunks_mut::<4>().0 {
        let [r, g, b, _] = *pixel;
        for (value, map) in pixel.iter_mut().zip(row[..EXPOSURE_VALUES].as_chunks::<4>().0) {
            *value = map[0] * r + map[1] * g + map[2] * b + map[3];
        }
    }
}

/// Three rows of four of a photo's row of words.
fn matrix(words: &[u32], photo: u32) -> [[f32; 4]; 3] {
    let first = EXPOSURE_WORDS * photo as usize;
    std::array::from_fn(|row| std::array::from_fn(|c| f32::from_bits(words[first + 4 * row + c])))
}
