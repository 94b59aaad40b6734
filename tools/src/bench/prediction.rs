//! Predicted times: what a frame or a training step that was recorded here would take on named GPUs, before anybody has run it
//! there.
//!
//! ```text
//! measured here      operations, barriers, workgroups, bytes, counts of instances and keys      report::measure::Recorded
//! counted            instructions by the tables of `spgs-dev isa`; splats blended per subtile    instructions, subtiles
//! assumed, stated    rounds of loops, atomics, what a data sheet does not say                   loops, profile
//! ────────────────►  demand of each operation ──► model ──► time on each GPU of `profile`
//! ```
//!
//! `spgs bench frame`, `spgs bench train` and `spgs bench gpu-day` print it beside what they measured, and put all inputs into their JSON.
//! Nothing is fitted: where a GPU shows a figure wrong, the constant that is wrong is replaced by the measured one, with its source.

mod demand;
mod instructions;
mod loops;
mod model;
mod profile;
pub(crate) mod report;
mod subtiles;
mod times;

pub(crate) use subtiles::Subtiles;
pub(crate) use times::{Kind, Predicted, predict};
