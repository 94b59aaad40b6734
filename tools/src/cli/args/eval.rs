//! Arguments of `spgs eval`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::options::{MotionArg, ResultArgs, color};
use crate::report::benchmark::Benchmark;

/// `spgs eval`.
#[derive(Debug, Args)]
pub struct EvalArgs {
    /// Model: .safetensors, 3DGS .ply, or anything that `spgs convert` reads
    pub model: PathBuf,
    /// Data set: a folder as for `spgs train`
    #[arg(long, value_name = "DATA")]
    pub data: PathBuf,
    /// Part of the data set
    #[arg(long, value_enum, default_value_t = SplitArg::Test)]
    pub split: SplitArg,
    /// The paper's protocol to follow [default: by the data set's format]
    #[arg(long, value_enum)]
    pub protocol: Option<Benchmark>,
    /// Scene of the paper to compare with [default: by the data folder's name]
    #[arg(long, value_name = "NAME")]
    pub scene: Option<String>,
    /// Average images down by this factor [default: as the model was trained, else the protocol's]
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// Colour behind the scene and behind images with alpha [default: as the model was trained, else the protocol's black]
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true, value_parser = color)]
    pub background: Option<[f32; 3]>,
    /// Where the motion comes from [default: the key-time table where the model has one]
    #[arg(long, value_enum)]
    pub motion: Option<MotionArg>,
    /// Weights for LPIPS: .safetensors with AlexNet, VGG-16 or both; repeatable [default: none, LPIPS is null]
    #[arg(long, value_name = "FILE")]
    pub lpips_weights: Vec<PathBuf>,
    /// Also score the moving parts, by the data set's masks
    #[arg(long)]
    pub masks: bool,
    /// Map the colours of each rendering as its photo was exposed first (affine, least squares): for captures whose exposure
    /// changes from photo to photo
    #[arg(long)]
    pub fit_exposure: bool,
    /// Also say how far off each pixel may be, by what the training views show of each Gaussian, and how well that foretells
    /// the true error; with --out also NNNNN_expected.png, as bright as NNNNN_error.png
    #[arg(long)]
    pub confidence: bool,
    /// Also keep what --confidence found of each Gaussian, for `spgs render --confidence` and `spgs view --confidence`
    #[arg(long, value_name = "FILE", requires = "confidence")]
    pub save_confidence: Option<PathBuf>,
    /// Other models to draw and compare with: what `spgs eval --json` wrote of them on the same views; repeatable
    #[arg(long, value_name = "FILE")]
    pub beside: Vec<PathBuf>,
    /// Where the results go
    #[command(flatten)]
    pub results: ResultArgs,
    /// Folder for images of every view: NNNNN.png, NNNNN_truth.png, NNNNN_flip.png, NNNNN_error.png
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// `--split` of `spgs eval`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SplitArg {
    /// Held-out views.
    Test,
    /// Further held-out views.
    Val,
    /// Views that were trained on.
    Train,
}

impl SplitArg {
    /// Name in JSON and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Test => "test",
            Self::Val => "val",
            Self::Train => "train",
        }
    }
}
