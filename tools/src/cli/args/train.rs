//! Arguments of `spgs train`.

use std::path::PathBuf;

use clap::Args;
use engine::data::dataset::DatasetKind;
use engine::train::config::{Base, Method, Preset};

use crate::report::benchmark::Benchmark;

/// Values that a configuration starts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PresetName {
    /// The paper's for the data set's format, but for what measured better (see `spgs help training`)
    Best,
    /// The paper's for the data set's format, exactly
    Paper,
    /// The paper's for D-NeRF: synthetic scenes with exact cameras and times
    #[value(alias = "dnerf")]
    DNerf,
    /// The paper's for HyperNeRF: hand-held captures
    #[value(name = "hypernerf")]
    HyperNerf,
    /// The paper's for NeRF-DS: specular objects
    #[value(alias = "nerfds")]
    NerfDs,
    /// The paper's for NVIDIA Dynamic Scene (Yoon et al.)
    Nvidia,
}

impl PresetName {
    /// What it names, for data in this format; D-NeRF's where there is none.
    pub fn base(self, kind: Option<DatasetKind>) -> Base {
        let of_format = kind.map(Benchmark::preset_of_format).unwrap_or_default();
        match self {
            Self::Best => Base { preset: of_format, method: Method::Best, ..Base::default() },
            Self::Paper => of_format.into(),
            Self::DNerf => Preset::Dnerf.into(),
            Self::HyperNerf => Preset::Hypernerf.into(),
            Self::NerfDs => Preset::Nerfds.into(),
            Self::Nvidia => Preset::Nvidia.into(),
        }
    }
}

/// `spgs train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// Data set: a folder with transforms_train.json, transforms.json, dataset.json, poses_bounds.npy, precomputed.json or a
    /// COLMAP model (see `spgs help data`)
    #[arg(required_unless_present = "print_config")]
    pub data: Option<PathBuf>,
    /// Output folder: model.safetensors, config.toml, run.jsonl, report.html, images/, checkpoints/
    #[arg(long, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// Number of iterations; the schedule scales with it [default: the configuration's, 40000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    pub iterations: Option<u64>,
    /// Whose values for the hyper-parameters
    #[arg(long, value_enum, default_value = "best")]
    pub preset: PresetName,
    /// File with hyper-parameters that override the preset (see --print-config)
    #[arg(long, value_name = "F.toml")]
    pub config: Option<PathBuf>,
    /// Print the whole configuration, with DATA the one for its format, as TOML and exit
    #[arg(long)]
    pub print_config: bool,
    /// Continue from the newest checkpoint in DIR, with its configuration
    #[arg(long, conflicts_with_all = ["config", "preset", "init"])]
    pub resume: bool,
    /// Average images down by this factor [default: the data set's rule, mostly 1]
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// Give the same bits on every run: no float atomics, fixed order of sums
    #[arg(long)]
    pub deterministic: bool,
    /// Train network G (motion that is not rigid) on top of the model in DIR, half as long as its run [or --iterations]
    #[arg(long)]
    pub nonrigid: bool,
    /// Start from this model (.safetensors or 3DGS .ply) [default: the data set's points, or random ones]
    #[arg(long, value_name = "FILE")]
    pub init: Option<PathBuf>,
    /// Train a static scene, without superpoints
    #[arg(long)]
    pub no_motion: bool,
    /// Seed of all random choices
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Open `spgs view` on DIR; it shows every new checkpoint
    #[arg(long)]
    pub view: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}
