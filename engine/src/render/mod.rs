//! Scene(t) + camera -> image, on the GPU: kernels with their CPU twins.

pub mod compact;
pub mod ellipse;
pub mod limits;
pub mod radix_sort;
#[cfg(test)]
mod sort_tests;
#[cfg(test)]
mod tile_tests;
pub mod tiles;
pub mod twin;
