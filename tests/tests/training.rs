//! Training as a whole, on scenes of a few dozen Gaussians: the same bits from run to run and through interruptions, bad
//! numbers and bad files, odd data sets, limits, the non-rigid stage, what is exported and logged.

#[path = "training/common.rs"]
mod common;
#[path = "training/determinism.rs"]
mod determinism;
#[path = "training/edges.rs"]
mod edges;
#[path = "training/export.rs"]
mod export;
#[path = "training/files.rs"]
mod files;
#[path = "training/interrupted.rs"]
mod interrupted;
#[path = "training/limits.rs"]
mod limits;
#[path = "training/nonrigid.rs"]
mod nonrigid;
#[path = "training/numbers.rs"]
mod numbers;
#[path = "training/quality.rs"]
mod quality;
