//! What became of each mutant, in a file, so that an interrupted run goes on where it was.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::error::Result;
use serde::{Deserialize, Serialize};

use super::store;

/// What became of a mutant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Outcome {
    /// A test failed.
    Seen,
    /// All tests passed.
    Survived,
    /// It does not compile: not counted.
    Rejected,
    /// It compiles to the same program: not counted.
    Same,
}

/// What is remembered of a mutant.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Record {
    /// Place and change, for people.
    pub(super) mutant: String,
    pub(super) outcome: Outcome,
    /// The test that saw it, where, and how it ended.
    pub(super) by: Option<String>,
    /// When the tests were built, in seconds: other tests may see what these did not.
    pub(super) tests: u64,
}

/// The file.
pub(super) struct Results {
    path: PathBuf,
    records: BTreeMap<String, Record>,
}

impl Results {
    /// # Errors
    /// `Io`; `Corrupt` when the file is none of ours.
    pub(super) fn open(path: &Path) -> Result<Self> {
        Ok(Self { path: path.to_owned(), records: store::read(path, "results of mutants")? })
    }

    /// What is known of a mutant; nothing of one that survived older tests.
    pub(super) fn get(&self, id: &str, tests: u64) -> Option<&Record> {
        self.records.get(id).filter(|r| r.outcome != Outcome::Survived || r.tests == tests)
    }

    /// Remembers it, in the file too.
    ///
    /// # Errors
    /// `Io` when that cannot be written.
    pub(super) fn insert(&mut self, id: String, record: Record) -> Result<()> {
        self.records.insert(id, record);
        store::write(&self.path, &self.records)
    }
}
