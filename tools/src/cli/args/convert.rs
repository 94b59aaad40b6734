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
    /// Gaussians that stand still). Its folder is made where there is none
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Level of detail of a SOG that has several (lod-meta.json), 0 the finest [default: the finest whose files are all there]
    #[arg(long, value_name = "N")]
    pub level: Option<u32>,
    /// The scene as it is at this time, standing still
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = finite, conflicts_with = "times")]
    pub time: Option<f64>,
    /// A sequence over time: N files OUT_00000, OUT_00001, … from the first to the last time of the motion; all of them
    /// or, when one fails, none but those that replaced an older file
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub times: Option<u32>,
    /// Motion as a table of the fewest key times within --bake-error; without networks and association
    #[arg(long, conflicts_with_all = ["time", "times"])]
    pub bake: bool,
    /// Largest displacement in the image that --bake may cause, pixels of 800x800 views around the scene; what falls in
    /// none of them counts as if they were turned to it
    #[arg(long, value_name = "PX", default_value_t = 0.1, requires = "bake", value_parser = positive)]
    pub bake_error: f64,
    /// Where the motion comes from [default: the key-time table where the model has one]
    #[arg(long, value_enum)]
    pub motion: Option<MotionArg>,
    /// Version of a .spz: 3 (gzip), which most viewers read, or 4 (zstd) [default: 3]
    #[arg(long, value_name = "3|4", value_parser = clap::value_parser!(u32).range(3..=4))]
    pub spz_version: Option<u32>,
    /// Views on which renders before and after are compared; 0: none
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
