//! Gradients of the reference, analytic, in f64: the truth for the backward kernels. Each is checked against central
//! differences of the reference itself.

pub mod association;
pub mod image;
pub mod loss;
pub mod motion;
pub mod network;
pub mod project;
pub mod property;
pub mod sh;
pub mod splats;
#[cfg(test)]
mod test_numbers;
#[cfg(test)]
mod tests;
