//! What every command needs of the command line: its arguments, the terminal, and what the arguments name.

pub mod args;
pub mod camera;
pub mod edited;
pub mod gpu_session;
pub(crate) mod interrupt;
pub mod model;
pub mod modes;
pub mod output;
pub mod progress;
