//! `spgs bench`.

pub mod ablation;
pub mod frame;
pub mod hard_cases;
pub mod paper;
pub mod sweep;
pub mod train;
