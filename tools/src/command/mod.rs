//! The subcommands of `spgs`.

pub mod compare;
pub mod convert;
pub mod demo;
pub mod devices;
pub mod eval;
pub mod inspect;
pub mod render;
pub mod train;
