//! Scenes made by formula: no files needed. Same arguments, same scene, on every machine up to the last bit of the
//! platform's `sin` and `exp`.

mod cloud;
mod demo;
mod hard;
mod random;

pub use cloud::{moving_scene, random_blend, random_gaussians, random_network, random_optional, random_scene};
pub use demo::{DEMO_BACKGROUND, demo_camera, demo_scene};
pub use hard::{HardCase, hard_cases};
pub use random::Random;
