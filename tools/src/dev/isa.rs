//! `spgs-dev isa`: what the compilers of GPUs make of every kernel, without a GPU.
//!
//! Mesa's drivers run on kernel drivers that compute nothing (`ci/drivers`). For each [`Target`] this program starts itself
//! anew with such a driver, runs [`recordings`] and reads the compiler's statistics of each pipeline that they made. Golden
//! files keep them from growing unnoticed; [`limits`] says what is never right.

mod child;
mod compare;
mod fields;
pub mod limits;
pub mod recordings;
mod run;
mod statistics;
mod table;
mod target;
pub mod task;

pub use child::child;
pub use compare::{Outcome, check, golden, write};
pub use run::{Collected, Run, collect};
pub use statistics::{Row, Statistics};
pub use table::text;
pub use target::{GOLDEN, RADV, SID, Target, target, targets};
