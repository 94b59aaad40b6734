//! Whether tests see a mutant: first those that compare its kernels with their twins, on the model of subgroups and on the
//! device, then those that only run them. The first red one ends it.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use engine::error::Result;

use super::cover::{Coverage, Test};
use super::suite::{self, Binary, Environment, Verdict};

/// Seconds of tests that only run a kernel, as measured without a fault.
const INDIRECT_SECONDS: f64 = 120.0;

/// What a process may take beside its tests: a busy machine that compiles kernels is not a mutant that hangs.
const PATIENCE: Duration = Duration::from_secs(300);

/// The device's own subgroup size.
const SMALL: Environment<'static> = &[("SPGS_TEST_SMALL", "1")];

/// Where tests that compare a kernel with its twin run, in this order. The model is first: it interprets, where a software
/// device compiles a mutant for seconds.
const LANES: [(&str, Environment<'static>); 7] = [
    ("model of 32 lanes, small", &[("SPGS_TEST_SMALL", "1"), ("SPGS_TEST_MODEL", "32")]),
    ("model of 4 lanes, small", &[("SPGS_TEST_SMALL", "1"), ("SPGS_TEST_MODEL", "4")]),
    ("model of 16 lanes, small", &[("SPGS_TEST_SMALL", "1"), ("SPGS_TEST_MODEL", "16")]),
    ("model of 128 lanes, small", &[("SPGS_TEST_SMALL", "1"), ("SPGS_TEST_MODEL", "128")]),
    ("model of 64 lanes, small", &[("SPGS_TEST_SMALL", "1"), ("SPGS_TEST_MODEL", "64")]),
    ("model of 32 lanes", &[("SPGS_TEST_MODEL", "32")]),
    ("device, small", SMALL),
];

/// The tests, and what they cover.
pub(super) struct Judge {
    pub(super) binaries: Vec<Binary>,
    pub(super) coverage: Coverage,
}

/// Some tests of a binary and how long they take.
struct Batch {
    binary: Binary,
    tests: Vec<String>,
    seconds: f64,
}

impl Judge {
    /// Which test sees what is planted in `spirv`, and where; `None` when none does.
    ///
    /// # Errors
    /// Those of running tests.
    pub(super) fn seen(&mut self, kernels: &BTreeSet<String>, spirv: &Path) -> Result<Option<String>> {
        let folder = spirv.to_string_lossy().into_owned();
        let direct = self.batches(|b| b.is_of_twins(), |t| !t.compared.is_disjoint(kernels))?;
        for (name, lanes) in LANES {
            if let Some(red) = first_red(&direct, &with(lanes, &folder), name)? {
                return Ok(Some(red));
            }
        }
        let other = |t: &Test| t.compared.is_disjoint(kernels) && !t.kernels.is_disjoint(kernels);
        let mut indirect = self.batches(|_| true, other)?;
        indirect.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
        let mut spent = 0.0;
        indirect.retain(|batch| {
            spent += batch.seconds;
            spent <= INDIRECT_SECONDS
        });
        first_red(&indirect, &with(SMALL, &folder), "device, small")
    }

    /// Tests by binary, cheapest first.
    fn batches(&mut self, binary: impl Fn(&Binary) -> bool, test: impl Fn(&Test) -> bool) -> Result<Vec<Batch>> {
        let mut all = Vec::new();
        for binary in self.binaries.iter().filter(|b| binary(b)) {
            let tests: Vec<&Test> = self.coverage.tests(binary)?.iter().filter(|t| test(t)).collect();
            if !tests.is_empty() {
                let seconds = tests.iter().map(|t| t.seconds).sum();
                let tests = tests.into_iter().map(|t| t.name.clone()).collect();
                all.push(Batch { binary: binary.clone(), tests, seconds });
            }
        }
        all.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
        Ok(all)
    }
}

fn with<'a>(lanes: Environment<'a>, spirv: &'a str) -> Vec<(&'a str, &'a str)> {
    let planted = ("SPGS_TEST_SPIRV", spirv);
    lanes.iter().copied().chain([planted]).collect()
}

fn first_red(batches: &[Batch], set: Environment<'_>, lanes: &str) -> Result<Option<String>> {
    for batch in batches {
        let limit = PATIENCE + Duration::from_secs_f64(10.0 * batch.seconds);
        if let Verdict::Red(how) = suite::run(&batch.binary, &batch.tests, set, limit)? {
            return Ok(Some(format!("{} ({lanes}): {how}", batch.binary.name)));
        }
    }
    Ok(None)
}
