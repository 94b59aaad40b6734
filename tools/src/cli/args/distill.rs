//! Arguments of `spgs distill`.

use std::path::PathBuf;

use clap::Args;

use super::options::MotionArg;

/// `spgs distill`.
#[derive(Debug, Args)]
pub struct DistillArgs {
    /// Model that moves, as `spgs convert` reads it: the folder of a training run of Deformable-3DGS, 4D-GS, SC-GS or SP-GS, or a
    /// .safetensors
    #[arg(value_name = "TEACHER")]
    pub teacher: PathBuf,
    /// Output folder: model.safetensors, report.json, report.html
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Cameras through which pixels are measured; of a data set, also photos to score teacher and student on [default: 12 views of
    /// 800x800 around the scene]
    #[arg(long, value_name = "DATA")]
    pub data: Option<PathBuf>,
    /// Largest displacement of a Gaussian's centre, or of a point two standard deviations from it, at any time, pixels
    #[arg(long, value_name = "PX", default_value_t = 0.25, value_parser = above_zero)]
    pub error: f64,
    /// Most superpoints: where they are not enough, the error is as small as they make it
    #[arg(long, value_name = "M", default_value_t = 2048, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub max_superpoints: u32,
    /// Number of views in which images of teacher and student are compared; 0: none [default: 256, on a CPU device 16]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    pub teacher_views: Option<u32>,
    /// Train the student for so many steps after the fit: its Gaussians and its key poses [default: none]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    pub iterations: Option<u64>,
    /// Images that those steps look at [default: both with photos in --data, else teacher]
    #[arg(long, value_enum, requires = "iterations")]
    pub on: Option<TuneOn>,
    /// Seed of the order of photos, and of random cameras and times
    #[arg(long, value_name = "S", default_value_t = 0, requires = "iterations")]
    pub seed: u64,
    /// Average photos of --data down by this factor, and shrink its cameras
    #[arg(long, value_name = "K", requires = "data", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// Where the teacher's motion comes from [default: the key-time table where it has one]
    #[arg(long, value_enum)]
    pub motion: Option<MotionArg>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Parses a number above 0.
fn above_zero(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0).ok_or_else(|| "expected a number above 0".into())
}

/// Which images a student learns from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TuneOn {
    /// Photos of --data
    Photos,
    /// Images of the teacher from random cameras at random times
    Teacher,
    /// Both in turn
    Both,
}
