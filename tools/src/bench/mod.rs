//! `spgs bench`: one file or folder for each of its modes.

pub mod ablation;
pub mod frame;
pub mod gpu_day;
pub mod hard_cases;
pub mod paper;
mod prediction;
mod scene;
pub mod sort;
pub mod sweep;
pub mod train;

use std::process::ExitCode;

use engine::error::Result;

use crate::cli::args::{BenchArgs, BenchMode, Global};

/// Measures and reports.
///
/// # Errors
/// Those of the mode.
pub fn run(args: &BenchArgs, global: &Global) -> Result<ExitCode> {
    let done = match &args.mode {
        None => frame::run(&args.frame, global),
        Some(BenchMode::Frame(args)) => frame::run(args, global),
        Some(BenchMode::Train(args)) => train::run(args, global),
        Some(BenchMode::Sweep(args)) => sweep::run(args, global),
        Some(BenchMode::Paper(args)) => paper::run(args, global),
        Some(BenchMode::Ablation(args)) => ablation::run(args, global),
        Some(BenchMode::Sort(args)) => sort::run(args, global),
        Some(BenchMode::GpuDay(args)) => return gpu_day::run(args, global),
        Some(BenchMode::HardCases(args)) => return hard_cases::run(args, global),
    };
    done.map(|()| ExitCode::SUCCESS)
}
