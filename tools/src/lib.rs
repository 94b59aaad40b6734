//! Parts of the command-line programs `spgs` and `spgs-dev`.

pub mod args;
pub mod bench;
pub mod bench_train;
pub mod dataset;
pub mod demo;
pub mod devices;
pub mod gpu_session;
pub mod inspect;
pub mod kernel_docs;
pub mod measure;
pub mod model;
pub mod oracle;
pub mod oracle_loss;
pub mod oracle_superpoint;
pub mod oracle_task;
pub mod output;
pub mod page;
pub mod plan_task;
pub mod progress;
pub mod render;
pub mod report;
pub mod spirv_task;
pub mod sweep;
pub mod train;
pub mod view;
