//! Everything that was found, and the paper's rows beside it.

use engine::error::Result;
use engine::metrics::flicker::Flicker;

use super::beside::Beside;
use super::confidence::Summary;
use super::session::{FloatScores, ViewResult};
use super::setting::Setting;
use crate::report::paper::{self, SceneRow};
use crate::report::scores::AllScores;

/// Everything that was found.
#[derive(Debug)]
pub(super) struct Evaluation {
    pub(super) views: Vec<ViewResult>,
    pub(super) mean: AllScores,
    pub(super) mean_float: FloatScores,
    pub(super) mean_masked: Option<AllScores>,
    /// Mean LPIPS as the paper's code computes it, if its network is known and has weights.
    pub(super) mean_lpips_paper: Option<f64>,
    pub(super) flicker: Option<Flicker>,
    pub(super) confidence: Option<Summary>,
    /// Other models.
    pub(super) beside: Vec<Beside>,
    pub(super) notes: Vec<String>,
}

/// Ours in the columns of the paper's table per scene: PSNR, similarity, LPIPS.
pub(super) fn our_row(setting: &Setting, e: &Evaluation) -> [Option<f64>; 3] {
    let similarity = match &setting.protocol {
        Some(p) if p.similarity == "MS-SSIM" => e.mean.pixel.ms_ssim,
        _ => Some(e.mean.pixel.ssim),
    };
    [Some(e.mean.pixel.psnr), similarity, e.mean_lpips_paper]
}

/// The paper's rows of the scene, or of the means where it has no such scene.
pub(super) fn paper_rows(setting: &Setting) -> Result<Vec<SceneRow>> {
    let Some(protocol) = &setting.protocol else { return Ok(Vec::new()) };
    let tables = paper::tables()?;
    Ok(match &setting.scene {
        Some(scene) => tables.scene(protocol.benchmark, scene).into_iter().cloned().collect(),
        None => tables.means(protocol.benchmark),
    })
}

/// What [`paper_rows`] are of.
pub(super) fn paper_title(setting: &Setting) -> String {
    match &setting.scene {
        Some(scene) => format!("scene {scene}"),
        None => "means of its scenes, none of which has this folder's name (--scene)".into(),
    }
}
