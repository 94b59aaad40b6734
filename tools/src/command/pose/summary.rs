//! What was done, for files and for people.

use std::path::PathBuf;

use engine::pose::{Moment, Options, Verdict};
use serde::Serialize;

/// What was done.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// The model read.
    pub model: PathBuf,
    /// The model written; absent with cameras alone.
    pub output: Option<PathBuf>,
    /// The cameras.
    pub cameras: PathBuf,
    /// This summary as a file; absent with cameras alone.
    pub report: Option<PathBuf>,
    /// The same as a page with charts; absent with cameras alone.
    pub page: Option<PathBuf>,
    /// What did the work.
    pub device: String,
    /// How it was searched.
    pub options: Options,
    /// Key times before and after.
    pub key_times: [usize; 2],
    /// What was found at each time.
    pub moments: Vec<Moment>,
}

/// A verdict for people.
pub(super) fn word(verdict: Verdict) -> String {
    match verdict {
        Verdict::Found { apart_px } => format!("found (two starts end {apart_px:.2} px apart)"),
        Verdict::OutOfReach { apart_px: Some(px) } => {
            format!("NOT FOUND: the start is out of reach (two starts end {px:.1} px apart)")
        }
        Verdict::OutOfReach { apart_px: None } => "NOT FOUND: it sees nothing of the scene".into(),
        Verdict::NotChecked => "not checked".into(),
    }
}
