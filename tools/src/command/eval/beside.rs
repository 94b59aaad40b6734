//! Other models, scored before on the same views.

use std::collections::BTreeMap;
use std::path::Path;

use engine::error::{Error, Result};
use serde::Deserialize;

use super::session::ViewResult;
use crate::report::page::Series;

/// What an earlier evaluation wrote.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Beside {
    /// Name of its file.
    #[serde(skip)]
    pub(super) name: String,
    images: Vec<Image>,
}

#[derive(Debug, Clone, Deserialize)]
struct Image {
    name: String,
    time: f64,
    psnr: f64,
}

impl Beside {
    /// Reads what `spgs eval --json` wrote.
    ///
    /// # Errors
    /// Those of reading; a file that is no such record.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        let wrong =
            |e: serde_json::Error| Error::corrupt(path, "record", e.to_string(), "what `spgs eval --json` writes");
        let name = path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Self { name, ..serde_json::from_str(&text).map_err(wrong)? })
    }

    /// PSNR over time.
    pub(super) fn series(&self) -> Series {
        let mut points: Vec<(f64, f64)> = self.images.iter().map(|i| (i.time, i.psnr)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Series::line(&self.name, points)
    }

    /// Views that both have, and mean PSNR on them, dB: of the other model, then of this one.
    pub(super) fn means(&self, views: &[ViewResult]) -> (usize, [Option<f64>; 2]) {
        let other: BTreeMap<&str, f64> = self.images.iter().map(|i| (i.name.as_str(), i.psnr)).collect();
        let both: Vec<[f64; 2]> =
            views.iter().filter_map(|v| Some([*other.get(v.name.as_str())?, v.scores.pixel.psnr])).collect();
        let mean = |k: usize| (!both.is_empty()).then(|| both.iter().map(|b| b[k]).sum::<f64>() / both.len() as f64);
        (both.len(), [mean(0), mean(1)])
    }

    /// For people.
    pub(super) fn line(&self, views: &[ViewResult]) -> String {
        let name = &self.name;
        match self.means(views) {
            (n, [Some(other), Some(own)]) => {
                format!("{name}: {other:.2} dB on {n} of these views, this model {own:.2} dB ({:+.2})", own - other)
            }
            _ => format!("{name}: none of these views"),
        }
    }
}
