//! `spgs-dev isa`: what the compilers of GPUs make of every kernel, without a GPU.
//!
//! Mesa's drivers run on kernel drivers that compute nothing (`ci/drivers`). For each [`Target`] this program starts itself
//! anew with such a driver, runs [`recordings`] and reads the compiler's statistics of each pipeline that they made. Golden
//! files keep them from growing unnoticed; [`limits`] says what is never right.

mod compare;
mod fields;
pub mod limits;
pub mod recordings;
mod run;
mod statistics;
mod table;
mod target;
pub mod task;

use engine::error::Result;
use engine::gpu::{Gpu, GpuOptions};

pub use compare::{Outcome, check, golden, write};
pub use run::{Collected, Run, collect};
pub use statistics::{Row, Statistics};
pub use table::text;
pub use target::{GOLDEN, RADV, SID, Target, target, targets};

/// The part that runs on the driver: makes all pipelines on this process's first device and prints their statistics, a JSON
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
