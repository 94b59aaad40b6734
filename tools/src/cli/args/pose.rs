//! Arguments of `spgs pose`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use engine::pose::Solve;

use super::options::{color, finite, near};

/// `spgs pose`.
#[derive(Debug, Args)]
pub struct PoseArgs {
    /// Model: .safetensors with superpoints and a key-time table; for --solve camera also one that stands still, in any format
    pub model: PathBuf,
    /// Photos with cameras and times: a data set as for `spgs train`
    #[arg(long, value_name = "DATA")]
    pub images: PathBuf,
    /// What is searched for
    #[arg(long, value_enum)]
    pub solve: SolveArg,
    /// What to write: a .safetensors model with the new key times; with --solve camera only the cameras, a .json
    #[arg(long, value_name = "NEW")]
    pub out: PathBuf,
    /// Part of the data set: train, test, val or all [default: test, or train where there is no test]
    #[arg(long, value_name = "NAME")]
    pub split: Option<String>,
    /// Take photos from this time on
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = finite)]
    pub from: Option<f64>,
    /// Take photos up to this time
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = finite)]
    pub to: Option<f64>,
    /// Take every N-th of these photos
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub every: u32,
    /// Begin with the superpoints as the model has them at T [default: at the photo's time]
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = finite)]
    pub init: Option<f64>,
    /// Divide superpoints before the search until there are N, so that what was rigid can bend
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub superpoints: Option<u32>,
    /// Average photos down by this factor [default: as the model was trained]
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// Iterations per time, over all sizes of its photos
    #[arg(long, value_name = "N", default_value_t = 600, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub iterations: u32,
    /// Most rounds of Gauss-Newton after them, where photos fit to 37 dB or so; with --solve superpoints
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(..=1000))]
    pub rounds: u32,
    /// How much superpoints hold on to their neighbours
    #[arg(long, value_name = "X", default_value_t = 3.0, value_parser = weight)]
    pub coupling: f64,
    /// How much they go on as they went, after the model's last key time
    #[arg(long, value_name = "X", default_value_t = 0.003, value_parser = weight)]
    pub smoothness: f64,
    /// Colour behind the scene and behind photos with alpha [default: as the model was trained, else black]
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true, value_parser = color)]
    pub background: Option<[f32; 3]>,
    /// Near plane, world units [default: as the model was trained, else 0.2]
    #[arg(long, value_name = "Z", value_parser = near)]
    pub near: Option<f32>,
    /// The same bits on every run on this device
    #[arg(long)]
    pub deterministic: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `--solve`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SolveArg {
    /// How superpoints stand; cameras are right.
    Superpoints,
    /// Where photos were taken from; the model is right.
    Camera,
    /// Both.
    Both,
}

impl From<SolveArg> for Solve {
    fn from(arg: SolveArg) -> Self {
        match arg {
            SolveArg::Superpoints => Self::Superpoints,
            SolveArg::Camera => Self::Camera,
            SolveArg::Both => Self::Both,
        }
    }
}

/// Parses a weight.
fn weight(text: &str) -> Result<f64, String> {
    let fits = |v: &f64| v.is_finite() && *v >= 0.0;
    text.parse().ok().filter(fits).ok_or_else(|| "expected a number of at least 0".into())
}
