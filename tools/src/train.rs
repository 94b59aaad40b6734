//! `spgs train`: posed images → model.

pub mod log;
pub mod report;
