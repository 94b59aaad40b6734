//! # spgs engine: dynamic 3D Gaussian scenes on raw Vulkan
//!
//! Modules, lowest first; an import may only point downwards (a test enforces it):
//!
//! ```text
//! error                    one error type
//! gpu                      the only module that names `ash` or writes `unsafe`; knows nothing of Gaussians
//! scene                    plain data: Gaussians, superpoint motion, network F, cameras
//! image                    float images and their comparison
//! reference                the f64 image that is the truth
//! file, data               model files, pictures; camera files
//! render                   scene(t) + camera -> image, on the GPU
//! ```

#![deny(unsafe_code)]

pub mod data;
pub mod error;
pub mod file;
#[allow(unsafe_code, reason = "raw Vulkan calls")]
pub mod gpu;
pub mod image;
pub mod reference;
pub mod render;
pub mod scene;

pub use error::{Error, Result};
