//! Arguments of `spgs train`.

use std::path::PathBuf;

use clap::Args;

use crate::report::benchmark::Benchmark;

/// `spgs train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// Data set: a folder with transforms_train.json, dataset.json, poses_bounds.npy, precomputed.json or a COLMAP model
    #[arg(required_unless_present = "print_config")]
    pub data: Option<PathBuf>,
    /// Folder for everything the run writes: model.safetensors, config.toml, run.jsonl, report.html, images/, checkpoints/
    #[arg(long, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// Length of the run; the schedule scales with it [default: the configuration's, 40000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    pub iterations: Option<u64>,
    /// Values of the paper for a kind of data [default: by the data set's format]
    #[arg(long, value_enum)]
    pub preset: Option<Benchmark>,
    /// Hyper-parameters that differ from the preset (see --print-config)
    #[arg(long, value_name = "F.toml")]
    pub config: Option<PathBuf>,
    /// Print the whole configuration as TOML and stop
    #[arg(long)]
    pub print_config: bool,
    /// Go on from the newest checkpoint in DIR, with its configuration
    #[arg(long, conflicts_with_all = ["config", "preset", "init"])]
    pub resume: bool,
    /// Images are averaged down by this factor [default: the data set's rule, mostly 1]
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// The same bits on every run: no float atomics, fixed orders of sums
    #[arg(long)]
    pub deterministic: bool,
    /// Train the non-rigid network G on top of the trained model in DIR
    #[arg(long)]
    pub nonrigid: bool,
    /// First Gaussians: a model (.safetensors or 3DGS .ply) [default: the data set's points, or random ones]
    #[arg(long, value_name = "FILE")]
    pub init: Option<PathBuf>,
    /// Train as a static scene, without superpoints
    #[arg(long)]
    pub no_motion: bool,
    /// Seed of every random choice
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Watch: opens `spgs view` on DIR, which shows the scene anew with every checkpoint
    #[arg(long)]
    pub view: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}
