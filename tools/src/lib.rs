//! Parts of the command-line programs `spgs` and `spgs-dev`.

pub mod output;
pub mod spirv_task;
