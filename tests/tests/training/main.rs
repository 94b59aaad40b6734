//! Training as a whole, on scenes of a few dozen Gaussians: the same bits from run to run and through interruptions, bad
//! numbers and bad files, odd data sets, limits, the non-rigid stage, what is exported and logged.

mod antialiased;
mod captures;
mod common;
mod determinism;
mod edges;
mod export;
mod files;
mod flight;
#[cfg(unix)] // It sends signals.
mod interrupted;
mod lifespan;
mod limits;
mod lost;
mod mean;
mod nonrigid;
mod numbers;
mod quality;
mod refit;
mod soft;
mod table;
mod window_trial;
