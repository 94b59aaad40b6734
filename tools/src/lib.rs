//! Parts of the command-line programs `spgs` and `spgs-dev`.

pub mod args;
pub mod devices;
pub mod gpu_session;
pub mod measure;
pub mod oracle;
pub mod output;
pub mod progress;
pub mod spirv_task;
pub mod view;
