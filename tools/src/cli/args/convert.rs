//! Arguments of `spgs convert`.

use std::path::PathBuf;

use clap::Args;

use super::options::{MotionArg, finite};

/// `spgs convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// Model: .safetensors, 3DGS .ply, compressed .ply, .splat, .spz, SOG (folder, meta.json, lod-meta.json or .sog), .glb,
    /// .gltf, or the folder of a training run of SP-GS, Deformable-3DGS, 4D-GS, SC-GS or 3DGS
    #[arg(value_name = "IN")]
    pub input: PathBuf,
    /// What to write, by its ending: .safetensors (everything), .ply, .compressed.ply, .splat, .spz, .sog, .glb (these hold
    /// Gaussians that stand still). Its folder is made if it does not exist
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Level of detail of a SOG with lod-meta.json; 0 is the finest [default: the finest whose files are all there]
    #[arg(long, value_name = "N")]
    pub level: Option<u32>,
    /// Write the scene at this time, standing still
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = finite, conflicts_with = "times")]
    pub time: Option<f64>,
    /// Write a sequence: N files OUT_00000, OUT_00001, … from the first to the last time of the motion. If one fails, new
    /// files are removed again
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub times: Option<u32>,
    /// Write the motion as a table of the fewest key times within --bake-error, without networks and association
    #[arg(long, conflicts_with_all = ["time", "times"])]
    pub bake: bool,
    /// Largest displacement that --bake may cause, in pixels of 800x800 views around the scene; a point outside all of them
    /// counts as if they were turned towards it
    #[arg(long, value_name = "PX", default_value_t = 0.1, requires = "bake", value_parser = positive)]
    pub bake_error: f64,
    /// Where the motion comes from [default: the key-time table where the model has one]
    #[arg(long, value_enum)]
    pub motion: Option<MotionArg>,
    /// Version of a .spz: 3 (gzip), which most viewers read, or 4 (zstd) [default: 3]
    #[arg(long, value_name = "3|4", value_parser = clap::value_parser!(u32).range(3..=4))]
    pub spz_version: Option<u32>,
    /// Number of views on which the models before and after are compared; 0: none
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub views: u32,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Parses a number above 0.
fn positive(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0).ok_or_else(|| "expected a number above 0".into())
}
