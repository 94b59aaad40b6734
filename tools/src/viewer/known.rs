//! How well the poses of superpoints are known, from what `spgs pose` wrote (`--poses`).

use std::path::Path;

use egui::Color32;
use engine::error::{Error, Result};
use engine::pose::Uncertainty;
use serde::Deserialize;

/// From here a centre counts as known, and from there as unknown: standard deviations across the view, pixels.
const KNOWN_PX: f64 = 0.1;
const UNKNOWN_PX: f64 = 1.0;
const KNOWN: Color32 = Color32::from_rgb(90, 220, 110);
const UNKNOWN: Color32 = Color32::from_rgb(255, 70, 60);
/// What no pixel sees.
const UNSEEN: Color32 = Color32::from_gray(150);

/// What was found, in order of time.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct KnownPoses {
    moments: Vec<Moment>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct Moment {
    time: f64,
    /// Into the first photo, world.
    pub(super) direction: [f64; 3],
    pub(super) superpoints: Vec<Uncertainty>,
}

impl KnownPoses {
    /// Reads a record about a model of `superpoints`.
    ///
    /// # Errors
    /// Those of reading; a file that is no such record, or about another model.
    pub(super) fn read(path: &Path, superpoints: usize) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        let expected = "what `spgs pose` writes beside its model (NEW.pose.json)";
        let wrong = |found: String| Error::corrupt(path, "record", found, expected);
        let mut found: Self = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
        found.moments.retain(|moment| !moment.superpoints.is_empty());
        if found.moments.is_empty() {
            return Err(wrong("no uncertainties of superpoints".into()));
        }
        if let Some(moment) = found.moments.iter().find(|moment| moment.superpoints.len() != superpoints) {
            let count = moment.superpoints.len();
            return Err(wrong(format!("{count} superpoints, of a model that has {superpoints}")));
        }
        found.moments.sort_by(|a, b| a.time.total_cmp(&b.time));
        Ok(found)
    }

    /// What was found nearest to a time.
    pub(super) fn at(&self, time: f64) -> Option<&Moment> {
        self.moments.iter().min_by(|a, b| (a.time - time).abs().total_cmp(&(b.time - time).abs()))
    }
}

/// From known to unknown on a logarithmic scale.
pub(super) fn color(known: &Uncertainty) -> Color32 {
    match known.across_px {
        Some(px) => {
            let share = (px / KNOWN_PX).ln() / (UNKNOWN_PX / KNOWN_PX).ln();
            KNOWN.lerp_to_gamma(UNKNOWN, share.clamp(0.0, 1.0) as f32)
        }
        None => UNSEEN,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn records_are_read_and_others_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new.pose.json");
        let read = |text: &str, count: usize| {
            std::fs::write(&path, text).unwrap();
            KnownPoses::read(&path, count)
        };
        let moment = |time: f64, across: &str| {
            format!(
                r#"{{"time": {time}, "direction": [0, 0, 1], "photos": [], "superpoints": [{{"seen": true, "across_px": {across},
                "across": 0.1, "along": null, "degrees": 2}}]}}"#
            )
        };
        let text = format!(r#"{{"model": "a", "moments": [{}, {}]}}"#, moment(0.5, "2.0"), moment(0.2, "0.01"));
        let known = read(&text, 1).unwrap();
        assert_eq!([0.0, 0.3, 0.4, 9.0].map(|t| known.at(t).unwrap().time), [0.2, 0.2, 0.5, 0.5]);
        assert_eq!(color(&known.at(0.0).unwrap().superpoints[0]), KNOWN);
        assert_eq!(color(&known.at(1.0).unwrap().superpoints[0]), UNKNOWN);
        assert_eq!(color(&Uncertainty::default()), UNSEEN);
        for (text, count, word) in
            [(text.as_str(), 3, "3"), ("{}", 1, "moments"), (r#"{"moments": []}"#, 1, "no uncert")]
        {
            let error = read(text, count).unwrap_err();
            assert!(error.exit_code() == 3 && error.to_string().contains(word), "{error}");
        }
    }
}
