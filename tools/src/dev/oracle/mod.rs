//! `spgs-dev oracle-check`: the f64 reference and the GPU against an independent float64 implementation.

pub mod case;
pub mod check;

pub mod loss;
pub mod superpoint;
