//! The part that runs on the driver.

use engine::error::Result;
use engine::gpu::{Gpu, GpuOptions};

use super::{recordings, run};

/// Makes all pipelines on this process's first device and prints their statistics, a JSON
/// object for the device and one per pipeline.
///
/// # Errors
/// Those of the device, and `Usage` when it has no statistics.
pub fn child(subgroup_size: u32) -> Result<Vec<String>> {
    let options = GpuOptions {
        pipeline_cache: false,
        subgroup_size: Some(subgroup_size),
        statistics: true,
        ..GpuOptions::default()
    };
    let gpu = Gpu::new(&options)?;
    for (name, record) in recordings::RECORDINGS {
        log::debug!("{name}");
        record(&gpu)?;
    }
    run::lines(&gpu)
}
