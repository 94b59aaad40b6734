//! f64 gradients that are the truth for the training kernels; each is checked against central differences of its forward.

pub mod image;
pub mod loss;
pub mod motion;
pub mod project;
pub mod sh;
pub mod splats;
#[cfg(test)]
mod tests;
