//! Kernels with planted faults, for `spgs-dev mutants`: each file `NAME.spv` in the folder `SPGS_TEST_SPIRV` takes the place of
//! that kernel, on the devices that tests open and on the model of subgroups.

use std::path::Path;
use std::sync::LazyLock;

use engine::gpu::kernel::Kernel;

static PLANTED: LazyLock<Vec<(&'static str, Vec<u32>)>> =
    LazyLock::new(|| std::env::var_os("SPGS_TEST_SPIRV").map_or_else(Vec::new, |folder| read(Path::new(&folder))));

/// Names and SPIR-V words of the kernels that the environment replaces.
///
/// # Panics
/// When the folder holds none, or a file that is no SPIR-V.
pub fn planted() -> &'static [(&'static str, Vec<u32>)] {
    &PLANTED
}

/// The words of a kernel, or those planted in its place.
///
/// # Panics
/// When either are no SPIR-V.
pub fn words(kernel: &Kernel) -> Vec<u32> {
    let found = planted().iter().find(|(name, _)| *name == kernel.name);
    found.map_or_else(|| engine::gpu::spirv::words(kernel).unwrap(), |(_, words)| words.clone())
}

fn read(folder: &Path) -> Vec<(&'static str, Vec<u32>)> {
    let of_kernel = |kernel: &Kernel| {
        let bytes = std::fs::read(folder.join(format!("{}.spv", kernel.name))).ok()?;
        assert!(bytes.len().is_multiple_of(4), "{} in SPGS_TEST_SPIRV is no SPIR-V", kernel.name);
        let words = bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        Some((kernel.name, words))
    };
    let planted: Vec<_> = engine::kernels().filter_map(of_kernel).collect();
    assert!(!planted.is_empty(), "SPGS_TEST_SPIRV={} holds no kernel", folder.display());
    planted
}
