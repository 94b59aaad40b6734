//! Every table of *Superpoint Gaussian Splatting for Real-Time High-Fidelity Dynamic Scene Reconstruction* (Wan, Lu, Zeng,
//! ICML 2024), as printed, with the places where the paper contradicts itself. One data file: `paper/tables.json`.

use std::sync::OnceLock;

use engine::error::{Error, Result};
use serde::{Deserialize, Serialize};

use super::benchmark::Benchmark;

/// A printed number, or what is printed instead (`<1`, `~1.5`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Figure {
    /// A number.
    Number(f64),
    /// A bound, an approximation or a name.
    Text(String),
}

impl Figure {
    /// The number, if it is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Number(v) => Some(*v),
            Self::Text(_) => None,
        }
    }
}

impl std::fmt::Display for Figure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(v) => write!(f, "{v}"),
            Self::Text(text) => write!(f, "{text}"),
        }
    }
}

/// A row of the main table of a data set: means over its scenes (D-NeRF: without Lego), on a V100.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Average {
    /// Data set.
    pub dataset: Benchmark,
    /// Method.
    pub method: String,
    /// PSNR, dB.
    pub psnr: Option<f64>,
    /// SSIM (D-NeRF, NeRF-DS) or MS-SSIM (HyperNeRF).
    pub similarity: Option<f64>,
    /// LPIPS.
    pub lpips: Option<f64>,
    /// Picture size.
    pub size: String,
    /// Frames per second.
    pub fps: Option<Figure>,
}

/// One scene (or `mean`) of one method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneRow {
    /// Data set.
    pub dataset: Benchmark,
    /// Scene, as its folder is called; `mean`.
    pub scene: String,
    /// Method.
    pub method: String,
    /// PSNR, dB.
    pub psnr: Option<f64>,
    /// See [`Benchmark::similarity`].
    pub similarity: Option<f64>,
    /// LPIPS.
    pub lpips: Option<f64>,
}

/// Frames per second of one method on three devices.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpeedRow {
    /// Data set; D-NeRF without Lego.
    pub dataset: Benchmark,
    /// Method.
    pub method: String,
    /// V100.
    pub v100: Figure,
    /// TITAN Xp.
    pub titan_xp: Figure,
    /// GTX 1060.
    pub gtx_1060: Figure,
}

/// Size, training time and speed of SP-GS on one scene (or `mean`; D-NeRF with Lego), on a V100.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingRow {
    /// Data set.
    pub dataset: Benchmark,
    /// Scene, as its folder is called; `mean`.
    pub scene: String,
    /// Gaussians, thousands.
    pub gaussians_thousand: f64,
    /// Training of SP-GS, minutes.
    pub train_minutes: f64,
    /// Frames per second of SP-GS.
    pub fps: f64,
    /// What training of network G adds, minutes.
    pub ng_extra_minutes: f64,
    /// Frames per second of SP-GS+NG.
    pub ng_fps: f64,
}

/// An ablation, column by name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ablation {
    /// Short name: `superpoints`, `neighbors`, `property-loss`, `distillation`, `weight-position`, `weight-translation`,
    /// `weight-rotation`, `network-size`, `warm-up`, `inference`.
    pub id: String,
    /// What is varied, and on which data.
    pub title: String,
    /// What each column is.
    pub columns: Vec<String>,
    /// `[rows, columns]`.
    pub rows: Vec<Vec<Figure>>,
}

/// A place where the paper contradicts itself or leaves something open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contradiction {
    /// Data set.
    pub dataset: Benchmark,
    /// Metric or fact.
    pub about: String,
    /// What is printed where.
    pub text: String,
}

/// All tables.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tables {
    /// Main tables.
    pub averages: Vec<Average>,
    /// Tables per scene.
    pub scenes: Vec<SceneRow>,
    /// Speed on three devices.
    pub speed: Vec<SpeedRow>,
    /// Training time and speed per scene.
    pub training: Vec<TrainingRow>,
    /// Ablations.
    pub ablations: Vec<Ablation>,
    /// What to beware of.
    pub contradictions: Vec<Contradiction>,
}

/// The tables.
///
/// # Errors
/// [`Error::Corrupt`] when the built-in file does not parse, which a test excludes.
pub fn tables() -> Result<&'static Tables> {
    static TABLES: OnceLock<std::result::Result<Tables, String>> = OnceLock::new();
    let parsed =
        TABLES.get_or_init(|| serde_json::from_str(include_str!("paper/tables.json")).map_err(|e| e.to_string()));
    parsed
        .as_ref()
        .map_err(|e| Error::corrupt("paper/tables.json".as_ref(), "content", e.clone(), "the paper's tables"))
}

impl Tables {
    /// All methods on one scene, in the paper's order; `scene` as written by the user (`T-Rex` is `trex`).
    pub fn scene(&self, dataset: Benchmark, scene: &str) -> Vec<&SceneRow> {
        self.scenes.iter().filter(|r| r.dataset == dataset && same_scene(&r.scene, scene)).collect()
    }

    /// The main table of a data set.
    pub fn averages(&self, dataset: Benchmark) -> Vec<&Average> {
        self.averages.iter().filter(|r| r.dataset == dataset).collect()
    }

    /// Means over the scenes of a data set, as printed: from the main table, or from the table per scene where there is no
    /// main one (NVIDIA Dynamic Scene).
    pub fn means(&self, dataset: Benchmark) -> Vec<SceneRow> {
        let of = |a: &&Average| SceneRow {
            dataset,
            scene: "mean".into(),
            method: a.method.clone(),
            psnr: a.psnr,
            similarity: a.similarity,
            lpips: a.lpips,
        };
        match self.averages(dataset) {
            main if main.is_empty() => self.scene(dataset, "mean").into_iter().cloned().collect(),
            main => main.iter().map(of).collect(),
        }
    }

    /// Speed on three devices; none for NVIDIA Dynamic Scene.
    pub fn speed(&self, dataset: Benchmark) -> Vec<&SpeedRow> {
        self.speed.iter().filter(|r| r.dataset == dataset).collect()
    }

    /// Size, training time and speed of a scene; D-NeRF and HyperNeRF only.
    pub fn training(&self, dataset: Benchmark, scene: &str) -> Option<&TrainingRow> {
        self.training.iter().find(|r| r.dataset == dataset && same_scene(&r.scene, scene))
    }

    /// An ablation by [`Ablation::id`].
    pub fn ablation(&self, id: &str) -> Option<&Ablation> {
        self.ablations.iter().find(|a| a.id == id)
    }

    /// What to beware of in a data set's tables.
    pub fn contradictions(&self, dataset: Benchmark) -> Vec<&Contradiction> {
        self.contradictions.iter().filter(|c| c.dataset == dataset).collect()
    }

    /// The scene that a folder's name stands for, if the data set has it: `vrig-3dprinter`, `as_novel_view` and `Balloon1-2`
    /// are `3dprinter`, `as` and `balloon1`.
    pub fn find_scene(&self, dataset: Benchmark, folder: &str) -> Option<&str> {
        let plain = plain(folder);
        let names = self.scenes.iter().filter(|r| r.dataset == dataset && r.scene != "mean").map(|r| r.scene.as_str());
        let fits = |name: &&str| plain == self::plain(name) || trimmed(&plain) == self::plain(name);
        names.into_iter().find(fits)
    }
}

/// Letters and digits, lower case.
fn plain(name: &str) -> String {
    name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

/// A plain name without what data sets put around it.
fn trimmed(plain: &str) -> &str {
    let name = plain.strip_prefix("vrig").or_else(|| plain.strip_prefix("dnerf")).unwrap_or(plain);
    let name = name.strip_prefix("nvidia").unwrap_or(name);
    name.strip_suffix("novelview").unwrap_or(name)
}

fn same_scene(ours: &str, asked: &str) -> bool {
    let plain_asked = plain(asked);
    plain(ours) == plain_asked || plain(ours) == trimmed(&plain_asked)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn mean(rows: &[&SceneRow], of: fn(&SceneRow) -> Option<f64>) -> f64 {
        rows.iter().filter_map(|r| of(r)).sum::<f64>() / rows.len() as f64
    }

    #[test]
    fn counts_are_those_of_the_paper() {
        let t = tables().unwrap();
        assert_eq!(t.averages.len(), 11 + 10 + 7);
        assert_eq!(t.scenes.len(), 11 * 8 + 14 * 5 + 7 * 8 + 11 * 8);
        assert_eq!((t.speed.len(), t.training.len(), t.ablations.len()), (4 + 4 + 3, 9 + 5, 10));
        assert_eq!(t.ablation("superpoints").unwrap().rows.len(), 6);
        for a in &t.ablations {
            assert!(a.rows.iter().all(|r| r.len() == a.columns.len()), "{}", a.id);
        }
    }

    #[test]
    fn printed_means_follow_from_the_scenes() {
        let t = tables().unwrap();
        for method in ["SP-GS", "SP-GS+NG"] {
            for dataset in [Benchmark::DNerf, Benchmark::HyperNerf, Benchmark::NerfDs, Benchmark::Nvidia] {
                let lego = |r: &SceneRow| dataset == Benchmark::DNerf && r.scene == "lego";
                let all = t.scenes.iter().filter(|r| r.dataset == dataset && r.method == method && r.scene != "mean");
                let rows: Vec<&SceneRow> = all.filter(|r| !lego(r)).collect();
                let printed = t.means(dataset).iter().find(|r| r.method == method).unwrap().psnr.unwrap();
                assert!((mean(&rows, |r| r.psnr) - printed).abs() < 0.006, "{dataset:?} {method}");
            }
        }
    }

    #[test]
    fn folders_find_their_scene() {
        let t = tables().unwrap();
        let find = |d, f| t.find_scene(d, f);
        assert_eq!(find(Benchmark::DNerf, "T-Rex"), Some("trex"));
        assert_eq!(find(Benchmark::DNerf, "dnerf_lego"), Some("lego"));
        assert_eq!(find(Benchmark::HyperNerf, "vrig-3dprinter"), Some("3dprinter"));
        assert_eq!(find(Benchmark::NerfDs, "as_novel_view"), Some("as"));
        assert_eq!(find(Benchmark::Nvidia, "nvidia_balloon1"), Some("balloon1"));
        assert_eq!(find(Benchmark::DNerf, "robot_dance"), None);
        let row = t.scene(Benchmark::DNerf, "Lego").into_iter().find(|r| r.method == "SP-GS+NG").unwrap();
        assert_eq!(row.psnr, Some(28.58));
    }
}
