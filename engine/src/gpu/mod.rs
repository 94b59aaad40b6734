//! The GPU layer: raw Vulkan through `ash`. The only module that may name `ash` or write `unsafe`.

pub mod kernel;
pub mod mmap;
