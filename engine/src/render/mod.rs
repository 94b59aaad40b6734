//! Scene(t) + camera -> image, on the GPU: kernels with their CPU twins.

pub mod ellipse;
pub mod limits;
pub mod twin;
