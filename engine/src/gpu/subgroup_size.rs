//! Which subgroup size each kernel gets.
//!
//! A device whose subgroup size is fixed, and every software device, has one size for all kernels. Where the driver can pin a
//! size per pipeline, [`CHOICES`] says which one a kernel is compiled for. Whoever computes with the size on the host (groups,
//! pixels per lane, twins) asks [`Gpu::subgroup_size_of`] for the same kernel.

use super::capability::DeviceInfo;
use super::device::Gpu;
use super::kernel::Kernel;

/// Smallest and largest size that the kernels work with.
pub const SIZES: std::ops::RangeInclusive<u32> = 4..=128;

/// A choice for the GPUs of one vendor.
#[derive(Debug, Clone, Copy)]
pub struct Choice {
    /// `VkPhysicalDeviceProperties::vendorID`.
    pub vendor: u32,
    /// Kernels by name; empty: all that no earlier line of the vendor names.
    pub kernels: &'static [&'static str],
    /// Invocations of a subgroup.
    pub size: u32,
    /// What speaks for it.
    pub why: &'static str,
}

/// `vendorID` of AMD.
pub const AMD: u32 = 0x1002;
/// `vendorID` of Intel.
pub const INTEL: u32 = 0x8086;
/// `vendorID` of NVIDIA.
pub const NVIDIA: u32 = 0x10DE;
/// `vendorID` of Qualcomm.
pub const QUALCOMM: u32 = 0x5143;

const BLENDING: &[&str] = &[
    "blend",
    "blend_packed",
    "blend_rgba8",
    "blend_rgba16f",
    "blend_rgba32f",
    "blend_states",
    "blend_backward",
    "blend_backward_native",
];

/// The choices, first match first. Estimates are busy cycles per 64 invocations and the same work, by Mesa's ACO compiler
/// (`spgs-dev isa`, whose golden files a test compares with this table); nothing here was measured on a GPU.
///
/// NVIDIA has 32 only. Apple, ARM and others fix their size or are left at the driver's.
pub const CHOICES: &[Choice] = &[
    Choice {
        vendor: AMD,
        kernels: BLENDING,
        size: 32,
        why: "two pixels per lane share a splat's arithmetic: 20 to 40 % less per pixel than one pixel on each of 64 lanes",
    },
    Choice {
        vendor: AMD,
        kernels: &["sort_scatter"],
        size: 32,
        why: "a ballot is one word instead of two: 15 to 35 % less",
    },
    Choice {
        vendor: AMD,
        kernels: &["deform_network", "image_loss"],
        size: 32,
        why: "reads of shared memory are the larger part and are not cheaper at 64: 20 to 35 % less, 3 to 8 % less",
    },
    Choice { vendor: AMD, kernels: &["density_decide"], size: 32, why: "9 % less" },
    Choice { vendor: AMD, kernels: &["sort_tiles"], size: 32, why: "6 % less" },
    Choice {
        vendor: AMD,
        kernels: &["nearest_superpoints"],
        size: 32,
        why: "fewer lanes wait for the one with the most close superpoints: 10 % less",
    },
    Choice {
        vendor: AMD,
        kernels: &[],
        size: 64,
        why: "one instruction for 64 invocations and scalar work done once: at most as dear as at 32, within 3 %",
    },
    Choice {
        vendor: INTEL,
        kernels: &[],
        size: 16,
        why: "a thread has 4 KiB of registers: 32 lanes have 32 each, and kernels that need more are spilled; 8 lanes leave \
              half of each instruction's width idle on Xe2",
    },
    Choice {
        vendor: QUALCOMM,
        kernels: BLENDING,
        size: 64,
        why: "subtiles of 8x8 px instead of 16x8: fewer pixels that a surviving splat does not reach, and 4 % fewer \
              instructions by ir3; elsewhere as many invocations are in flight either way, and the driver's 128 stays",
    },
];

impl DeviceInfo {
    /// Whether a pipeline with workgroups of `local_size` can be pinned to full subgroups of `size`.
    pub fn can_pin(&self, size: u32, local_size: u32) -> bool {
        let c = &self.capabilities;
        size.is_power_of_two()
            && SIZES.contains(&size)
            && c.min_subgroup_size < c.max_subgroup_size
            && (c.min_subgroup_size..=c.max_subgroup_size).contains(&size)
            && local_size.is_multiple_of(size)
            && local_size / size <= c.max_workgroup_subgroups
    }

    /// Subgroup size of a kernel; `forced`: that one where the device can pin it.
    pub fn subgroup_size_of(&self, kernel: &Kernel, forced: Option<u32>) -> u32 {
        let chosen = CHOICES
            .iter()
            .filter(|c| c.vendor == self.vendor && !self.is_cpu())
            .find(|c| c.kernels.is_empty() || c.kernels.contains(&kernel.name));
        let wanted = [forced, chosen.map(|c| c.size)];
        let fit = wanted.into_iter().flatten().find(|size| self.can_pin(*size, kernel.local_size));
        fit.unwrap_or(self.capabilities.subgroup_size)
    }
}

impl Gpu {
    /// The subgroup size that a kernel is specialised for, specialisation constant 0 of all its pipelines.
    pub fn subgroup_size_of(&self, kernel: &Kernel) -> u32 {
        self.0.info.subgroup_size_of(kernel, self.0.options.subgroup_size)
    }
}
