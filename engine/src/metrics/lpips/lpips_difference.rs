//! Kernel `lpips_difference`: weighted squared difference of two feature maps, each pixel's features divided by their length.

use super::{EPSILON, SUMS, THREADS, value};
use crate::gpu::interface::Call;

crate::gpu_struct! {
    /// Push constants of [`LPIPS_DIFFERENCE`].
    pub struct LpipsDifferencePush {
        /// Channels.
        pub channels: u32,
        /// Pixels.
        pub pixels: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`LPIPS_DIFFERENCE`].
    pub struct LpipsDifferenceBuffers {
        /// `[channels, pixels]`
        first: Read F32,
        /// `[channels, pixels]`
        second: Read F32,
        /// `[channels]`
        head: Read F32,
        /// `[pixels]`
        distance_of_pixel: Write F32,
    }
}

crate::kernel! {
    /// Normalised, weighted difference.
    pub static LPIPS_DIFFERENCE: LpipsDifference = {
        name: "lpips_difference",
        doc: "LPIPS: weighted squared difference of normalised features",
        local_size: THREADS,
        constants: (),
        push: LpipsDifferencePush,
        buffers: LpipsDifferenceBuffers,
        twin: lpips_difference_twin,
        tolerance: SUMS,
        bytes: |work| 4 * (2 * work.get("inputs") + work.get("pixels")),
    }
}

fn lpips_difference_twin(call: Call<'_, LpipsDifference>) {
    let p = call.push;
    let LpipsDifferenceBuffers { first, second, head, distance_of_pixel } = call.buffers;
    for pixel in 0..p.pixels {
        let at = |words: &[u32], c: u32| value(words, c * p.pixels + pixel);
        let length = |words: &[u32]| (0..p.channels).map(|c| at(words, c).powi(2)).sum::<f64>().sqrt() + EPSILON;
        let (a, b) = (length(first), length(second));
        let term = |c| value(head, c) * (at(first, c) / a - at(second, c) / b).powi(2);
        distance_of_pixel[pixel as usize] = ((0..p.channels).map(term).sum::<f64>() as f32).to_bits();
    }
}
