//! Mutants that no test can see, each with its reason, in `equivalent.json`: they are not judged.

use std::path::PathBuf;

use engine::error::{Error, Result};
use serde::Deserialize;

use super::plant::Mutant;

const LIST: &str = include_str!("equivalent.json");

/// A mutant that changes nothing, by its place in the source.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    /// Relative to the folder of the workspace.
    file: PathBuf,
    /// The line as it is and with the fault, without the space around it.
    before: String,
    after: String,
    /// Which of several lines with the same text, from 1.
    line: Option<usize>,
    reason: String,
}

/// The list.
pub(super) struct Equivalents(Vec<Entry>);

impl Equivalents {
    /// # Errors
    /// `Corrupt` when the list is not JSON as described.
    pub(super) fn new() -> Result<Self> {
        let corrupt = |e: serde_json::Error| {
            let place = format!("line {}", e.line());
            Error::corrupt("equivalent.json".as_ref(), place, e.to_string(), "entries with file, before, after, reason")
        };
        Ok(Self(serde_json::from_str(LIST).map_err(corrupt)?))
    }

    /// Why a mutant changes nothing, if it is listed.
    pub(super) fn reason(&self, mutant: &Mutant) -> Option<&str> {
        self.0.iter().find(|entry| entry.names(mutant)).map(|entry| entry.reason.as_str())
    }
}

impl Entry {
    fn names(&self, mutant: &Mutant) -> bool {
        let (line, before, after) = mutant.lines();
        self.file == mutant.file && self.line.is_none_or(|l| l == line) && before == self.before && after == self.after
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::Equivalents;
    use crate::dev::mutants::plant;

    #[test]
    fn every_entry_names_one_place_and_says_why() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap();
        let mutants = plant::mutants(&root, |_| true).unwrap();
        let list = Equivalents::new().unwrap();
        for entry in &list.0 {
            assert_eq!(mutants.iter().filter(|m| entry.names(m)).count(), 1, "{entry:?}");
            assert!(entry.reason.len() > 20, "{entry:?}");
        }
        let listed = mutants.iter().filter(|m| list.reason(m).is_some()).count();
        assert_eq!(listed, list.0.len());
    }
}
