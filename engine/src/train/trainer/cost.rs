//! What the kernels of a step cost, to find what is worth running beside what.

use crate::gpu::Kernel;
use crate::gpu::schedule::Cost;

/// Of kernels that are not named.
const OTHER: [u32; 2] = [10, 50];

/// Microseconds on one large GPU (H200, 120,000 Gaussians, 800×800 pixels, 512 superpoints), and a guess at how much of it is busy,
/// percent. Other sizes and devices have other times; the results of a step do not depend on them, and all devices have the same
/// order.
const MEASURED: &[(&str, [u32; 2])] = &[
    ("encode_superpoints", [6, 10]),
    ("linear_forward", [10, 35]),
    ("deform_project", [47, 60]),
    ("scan_tiles", [8, 10]),
    ("emit_tiles", [45, 50]),
    ("sort_tiles", [18, 60]),
    ("blend", [58, 80]),
    ("nearest_superpoints", [103, 60]),
    ("sort_histogram", [8, 40]),
    ("sort_spine", [6, 10]),
    ("sort_scatter", [35, 50]),
    ("property_residual", [45, 60]),
    ("superpoint_sum", [31, 50]),
    ("property_total", [5, 5]),
    ("ssim_forward", [61, 80]),
    ("image_loss", [48, 80]),
    ("image_loss_sum", [5, 5]),
    ("blend_backward", [224, 90]),
    ("blend_backward_native", [224, 90]),
    ("sum_instance_gradients", [40, 60]),
    ("deform_project_backward", [126, 90]),
    ("superpoint_gradient", [6, 10]),
    ("gather_gradient", [4, 10]),
    ("linear_backward_input", [11, 35]),
    ("linear_backward_weight", [16, 35]),
    ("linear_update", [8, 80]),
];

pub(super) fn of(kernel: &Kernel) -> Cost {
    let [time, share] = MEASURED.iter().find(|(name, _)| *name == kernel.name).map_or(OTHER, |(_, cost)| *cost);
    Cost { time, share }
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_kernel_that_is_named_exists() {
        for (name, _) in super::MEASURED {
            let mut all = crate::render::KERNELS.iter().copied().chain(crate::train::kernels());
            assert!(all.any(|k| k.name == *name), "{name}");
        }
    }
}
