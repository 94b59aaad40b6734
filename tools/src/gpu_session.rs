//! Opening the device that the command line names.

use engine::error::Result;
use engine::gpu::{Gpu, GpuOptions};

use crate::args::Global;

/// The device of `--device`, of `SPGS_DEVICE`, or the fastest kind there is.
pub fn open(global: &Global) -> Result<Gpu> {
    let mut options = GpuOptions::default();
    if global.device.is_some() {
        options.device.clone_from(&global.device);
    }
    Gpu::new(&options)
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
        gpu.subgroup_size()
    )
}

/// Prints the messages of the validation layer, if it is on and said anything.
pub fn report_validation(gpu: &Gpu) {
    for message in gpu.take_validation_messages() {
        log::warn!("validation layer: {message}");
    }
}
