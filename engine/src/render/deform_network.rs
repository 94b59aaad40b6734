//! Network F live (under construction).
use crate::error::*;
use crate::gpu::kernel::*;
/// Under construction.
pub static DEFORM_NETWORK: Kernel = Kernel {
    name: "deform_network",
    doc: "",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "FP16_WEIGHTS"],
    push: &[],
    bindings: &[],
    twin: |_| {},
    tolerance: Tolerance::EXACT,
    bytes: |_| 0,
    spirv: &[],
};
/// Under construction.
pub fn groups(n: u32) -> u64 {
    n.into()
}
/// Under construction.
pub fn pack_weights(_: &crate::scene::DeformNetwork) -> Result<Vec<u32>> {
    Err(Error::usage("network", "", ""))
}
