//! Gradients in f64, by the chain rule written out: the truth for the backward kernels.

pub mod network;
