//! Which tests run which kernels: asked of the tests themselves, once for each build of a test binary. Tests that compare
//! kernels with their twins are asked on the model of subgroups, which is faster than a software device.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use engine::error::{Error, Result};
use serde::{Deserialize, Serialize};

use super::store;
use super::suite::{self, Binary, Verdict};

/// What one test does.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Test {
    pub(super) name: String,
    /// Kernels that it compares with their twins.
    pub(super) compared: BTreeSet<String>,
    /// Kernels that it runs on a device in any way.
    pub(super) kernels: BTreeSet<String>,
    /// How long it has a device open.
    pub(super) seconds: f64,
}

/// What is known of a build of a binary.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Known {
    built: u64,
    tests: Vec<Test>,
}

/// A file of what is known, by name of binary.
pub(super) struct Coverage {
    path: PathBuf,
    known: BTreeMap<String, Known>,
}

/// Longest time that the tests of a binary may take without a fault.
const LIMIT: Duration = Duration::from_secs(1800);

impl Coverage {
    /// # Errors
    /// `Io`; `Corrupt` when the file is none of ours.
    pub(super) fn open(path: &Path) -> Result<Self> {
        Ok(Self { path: path.to_owned(), known: store::read(path, "coverage")? })
    }

    /// The tests of a binary that open a device. Runs them if that is not known of this build.
    ///
    /// # Errors
    /// `Usage` when a test fails without a fault.
    pub(super) fn tests(&mut self, binary: &Binary) -> Result<&[Test]> {
        let built = built(&binary.path)?;
        if self.known.get(&binary.name).is_none_or(|known| known.built != built) {
            let tests = ask(binary)?;
            self.known.insert(binary.name.clone(), Known { built, tests });
            store::write(&self.path, &self.known)?;
        }
        Ok(self.known.get(&binary.name).map_or(&[], |known| &known.tests))
    }
}

/// When a binary was built, in seconds.
pub(super) fn built(path: &Path) -> Result<u64> {
    let modified = path.metadata().and_then(|m| m.modified()).map_err(|e| Error::io(path, "look at", e))?;
    Ok(modified.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs()))
}

fn ask(binary: &Binary) -> Result<Vec<Test>> {
    let folder = tempfile::tempdir().map_err(|e| Error::io(&binary.path, "make a temporary file for", e))?;
    let log = folder.path().join("coverage");
    let log_name = log.to_string_lossy();
    let mut set = vec![("SPGS_TEST_COVERAGE", &*log_name), ("SPGS_TEST_SMALL", "1")];
    if binary.is_of_twins() {
        set.push(("SPGS_TEST_MODEL", "32"));
    }
    if let Verdict::Red(how) = suite::run(binary, &[], &set, LIMIT)? {
        return Err(Error::usage(format!("the tests of {}", binary.name), how, "that they pass without a fault"));
    }
    let text = std::fs::read_to_string(&log).unwrap_or_default();
    let mut tests = BTreeMap::<String, Test>::new();
    for line in text.lines() {
        let one: serde_json::Value = serde_json::from_str(line)
            .map_err(|e| Error::corrupt(&log, "a line", e.to_string(), "what a test wrote"))?;
        // A test on the main thread of a program has no name.
        let Some(name) = one["test"].as_str() else { continue };
        let test = tests.entry(name.to_owned()).or_insert_with(|| Test { name: name.to_owned(), ..Test::default() });
        test.compared.extend(names(&one["compared"]));
        test.kernels.extend(names(&one["kernels"]));
        test.seconds += one["seconds"].as_f64().unwrap_or(0.0);
    }
    Ok(tests.into_values().collect())
}

fn names(list: &serde_json::Value) -> impl Iterator<Item = String> + '_ {
    list.as_array().into_iter().flatten().filter_map(|name| name.as_str().map(str::to_owned))
}
