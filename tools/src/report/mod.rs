//! What was measured: numbers, and how they are shown.

pub mod error_image;
pub mod measure;
pub mod page;
pub mod paper;
pub(crate) mod processor;
pub mod scores;
pub mod summary;
