//! Scene(t) + camera -> image, on the GPU: kernels with their CPU twins.

pub mod angle;
pub mod blend;
pub mod deform_network;
pub mod deform_project;
pub mod ellipse;
pub mod frame;
pub mod limits;
pub mod quaternion;
pub mod twin;
