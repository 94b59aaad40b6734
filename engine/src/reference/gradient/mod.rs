//! Gradients of the reference, analytic, in f64: the truth for the backward kernels. Each is checked against central
//! differences of the reference itself.

pub mod association;
pub mod network;
pub mod property;
#[cfg(test)]
mod test_numbers;
