//! What was measured: numbers, and how they are shown.

pub mod average;
pub mod benchmark;
pub mod error_image;
pub mod files;
pub mod measure;
pub mod page;
pub mod paper;
pub(crate) mod processor;
pub mod provenance;
pub mod scores;
pub mod summary;
