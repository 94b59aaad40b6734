//! `spgs bench hard-cases`: numerical stability on small scenes, each of which has broken some renderer. For every one: the
//! input, what the f64 truth says, the error of the device, its bound, whether it holds, and the time.
//!
//! One definition for the program and the tests: [`cases`] lists them, [`Case::run`] judges one.

mod blend;
mod capacity;
mod case;
mod checkpoint;
mod compare;
mod drift;
mod gradients;
mod images;
mod keys;
mod layers;
mod list;
mod motion;
pub mod poison;
mod repeat;
mod report;
mod steady;
mod views;

pub use case::{Bound, Case, Check, Context, GROUPS, Outcome, Row};
pub use list::cases;
pub use report::run;
