//! The data sets of the paper: one name each, for presets of training, protocols of evaluation and the paper's tables.

use engine::data::DatasetKind;
use engine::train::config::Preset;
use serde::{Deserialize, Serialize};

/// The four data sets of the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Benchmark {
    /// D-NeRF: synthetic scenes with exact cameras and times.
    #[value(alias = "dnerf")]
    DNerf,
    /// HyperNeRF: hand-held captures.
    #[value(name = "hypernerf")]
    #[serde(rename = "hypernerf")]
    HyperNerf,
    /// NeRF-DS: specular objects.
    #[value(alias = "nerfds")]
    NerfDs,
    /// NVIDIA Dynamic Scene (Yoon et al.).
    Nvidia,
}

impl Benchmark {
    /// The one that has data in this format.
    pub fn of_format(kind: DatasetKind) -> Option<Self> {
        match kind {
            DatasetKind::Blender => Some(Self::DNerf),
            DatasetKind::Nerfies => Some(Self::HyperNerf),
            DatasetKind::NerfDs => Some(Self::NerfDs),
            DatasetKind::Nvidia => Some(Self::Nvidia),
            DatasetKind::Nerfstudio | DatasetKind::Llff | DatasetKind::NonrigidNerf | DatasetKind::Colmap => None,
        }
    }

    /// The paper's settings for training on it.
    pub fn preset(self) -> Preset {
        match self {
            Self::DNerf => Preset::Dnerf,
            Self::HyperNerf => Preset::Hypernerf,
            Self::NerfDs => Preset::Nerfds,
            Self::Nvidia => Preset::Nvidia,
        }
    }

    /// The paper's settings for data of a format: HyperNeRF's for captures that are no benchmark of the paper.
    pub fn preset_of_format(kind: DatasetKind) -> Preset {
        Self::of_format(kind).unwrap_or(Self::HyperNerf).preset()
    }

    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::DNerf => "D-NeRF",
            Self::HyperNerf => "HyperNeRF",
            Self::NerfDs => "NeRF-DS",
            Self::Nvidia => "NVIDIA Dynamic Scene",
        }
    }

    /// What the similarity column of its table per scene is called there.
    pub fn similarity(self) -> &'static str {
        match self {
            Self::DNerf | Self::Nvidia => "SSIM",
            Self::HyperNerf | Self::NerfDs => "MS-SSIM",
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum as _;

    use super::*;

    #[test]
    fn one_spelling_is_shown_and_the_older_ones_are_read() {
        let shown: Vec<String> = Benchmark::value_variants()
            .iter()
            .filter_map(|b| b.to_possible_value().map(|v| v.get_name().into()))
            .collect();
        assert_eq!(shown, ["d-nerf", "hypernerf", "nerf-ds", "nvidia"]);
        for (old, benchmark) in [("dnerf", Benchmark::DNerf), ("nerfds", Benchmark::NerfDs)] {
            assert_eq!(Benchmark::from_str(old, false), Ok(benchmark));
        }
        for (name, benchmark) in shown.iter().zip(Benchmark::value_variants()) {
            assert_eq!(serde_json::to_value(benchmark).ok().as_ref().and_then(|v| v.as_str()), Some(name.as_str()));
        }
    }
}
