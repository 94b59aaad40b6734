//! The GPUs whose compilers are asked.

use engine::error::{Error, Result};

/// Where the golden files are, relative to the folder of the workspace.
pub const GOLDEN: &str = "tests/golden/isa";

/// A GPU whose compiler is asked, at one subgroup size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Stem of its golden file `NAME.tsv`.
    pub name: &'static str,
    /// Driver, as `ci/drivers` names it.
    pub driver: &'static str,
    /// GPU, as `ci/drivers env` takes it.
    pub gpu: &'static str,
    /// Subgroup size of every kernel.
    pub subgroup_size: u32,
    /// Fewest waves per SIMD (warps per SM, …) that are enough to hide the latency of memory.
    pub floor: f64,
}

/// RDNA3, RDNA2 and GCN5 by Mesa's ACO compiler: occupancy is in waves of 32 per SIMD (RDNA), of 64 (GCN).
pub const RADV: [Target; 5] = [
    Target { name: "radv_navi31_32", driver: "shim", gpu: "navi31", subgroup_size: 32, floor: 8.0 },
    Target { name: "radv_navi31_64", driver: "shim", gpu: "navi31", subgroup_size: 64, floor: 8.0 },
    Target { name: "radv_navi21_32", driver: "shim", gpu: "navi21", subgroup_size: 32, floor: 8.0 },
    Target { name: "radv_navi21_64", driver: "shim", gpu: "navi21", subgroup_size: 64, floor: 8.0 },
    Target { name: "radv_vega10_64", driver: "shim", gpu: "vega10", subgroup_size: 64, floor: 3.0 },
];

/// Turing by Mesa's NAK compiler, and Adreno 7xx by its ir3, where the packages of a newer Mesa are there.
pub const SID: [Target; 3] = [
    Target { name: "nvk_turing_32", driver: "shim-sid", gpu: "nvk:0x162", subgroup_size: 32, floor: 16.0 },
    Target { name: "turnip_740_64", driver: "shim-sid", gpu: "turnip:740", subgroup_size: 64, floor: 2.0 },
    Target { name: "turnip_740_128", driver: "shim-sid", gpu: "turnip:740", subgroup_size: 128, floor: 2.0 },
];

/// Every target there is.
pub fn targets() -> impl Iterator<Item = &'static Target> {
    RADV.iter().chain(&SID)
}

/// The target of a name.
///
/// # Errors
/// `Usage` for an unknown one.
pub fn target(name: &str) -> Result<&'static Target> {
    let names: Vec<&str> = targets().map(|t| t.name).collect();
    targets()
        .find(|t| t.name == name)
        .ok_or_else(|| Error::usage("target of spgs-dev isa", name, format!("one of {}", names.join(", "))))
}
