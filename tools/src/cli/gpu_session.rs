//! Opening the device that the command line names.

use std::collections::BTreeSet;

use engine::error::Result;
use engine::gpu::{Gpu, GpuOptions, Kernel, SelfTest};

use crate::cli::args::Global;

/// The device of `--device`, of `SPGS_DEVICE`, or the fastest kind there is.
pub fn open(global: &Global) -> Result<Gpu> {
    open_with(global, GpuOptions::default())
}

/// [`open`] for training: the training kernels have proven themselves too.
pub fn open_to_train(global: &Global) -> Result<Gpu> {
    open_with(global, GpuOptions { training: true, ..GpuOptions::default() })
}

/// Options with the device of the command line.
pub fn options(global: &Global) -> GpuOptions {
    with_device(global, GpuOptions::default())
}

/// The same without any test of the device, for all that there is to measure: who calls it tests by itself.
pub fn open_untested(global: &Global) -> Result<Gpu> {
    let options = GpuOptions { training: true, self_test: SelfTest::Skip, ..GpuOptions::default() };
    Gpu::open(&with_device(global, options))
}

fn open_with(global: &Global, options: GpuOptions) -> Result<Gpu> {
    Gpu::new(&with_device(global, options))
}

fn with_device(global: &Global, mut options: GpuOptions) -> GpuOptions {
    if global.device.is_some() {
        options.device.clone_from(&global.device);
    }
    if global.self_test {
        options.self_test = SelfTest::Again;
    }
    options
}

/// One line that says which device and driver do the work.
pub fn describe(gpu: &Gpu) -> String {
    let info = gpu.info();
    format!(
        "{} ({}, {}, Vulkan {}, subgroups of {})",
        info.name,
        info.kind,
        info.driver,
        info.vulkan,
        subgroup_sizes(|kernel| gpu.subgroup_size_of(kernel))
    )
}

/// The subgroup sizes that kernels have, as `32 and 64`.
pub fn subgroup_sizes(of: impl Fn(&Kernel) -> u32) -> String {
    let sizes: BTreeSet<u32> = engine::kernels().map(of).collect();
    sizes.iter().map(u32::to_string).collect::<Vec<_>>().join(" and ")
}

/// Prints the messages of the validation layer, if it is on and said anything.
pub fn report_validation(gpu: &Gpu) {
    for message in gpu.take_validation_messages() {
        log::warn!("validation layer: {message}");
    }
}
