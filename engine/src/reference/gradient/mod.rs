//! f64 gradients that are the truth for the training kernels; each is checked against central differences of its forward.

pub mod loss;
