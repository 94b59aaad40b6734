//! The command: which mutants are drawn, what is printed, what the exit status says.

use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use serde_json::json;

use super::cover::{self, Coverage};
use super::equivalent::Equivalents;
use super::judge::Judge;
use super::plant::{self, Mutant, Planted, Workshop};
use super::results::{Outcome, Record, Results};
use super::sites::FAULTS;
use super::suite;
use crate::cli::{output, progress};
use crate::dev::spirv;

/// Share of mutants that tests must see.
const WANTED_SHARE: f64 = 0.95;
/// Test binaries that compare kernels with their twins.
const TWIN_TESTS: &str = "kernels_*";

/// Options of `spgs-dev mutants`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Mutants to judge; those that do not compile, compile to the same program or are listed as meaning the same are
    /// replaced by others
    #[arg(long, default_value_t = 200)]
    count: usize,
    /// Which mutants are drawn
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Only this kernel and what it includes (repeatable)
    #[arg(long, value_name = "NAME")]
    kernel: Vec<String>,
    /// Only tests that compare kernels with their twins, not those that run them in frames and training
    #[arg(long)]
    twins: bool,
    /// Print the mutants that are drawn, and run nothing
    #[arg(long)]
    list: bool,
    /// One JSON object per mutant and line
    #[arg(long)]
    json: bool,
    /// No progress bar
    #[arg(long)]
    quiet: bool,
    /// Where results are kept: what is in it is not run again (default: target/mutants in the workspace)
    #[arg(long, value_name = "DIR")]
    results: Option<PathBuf>,
}

/// Runs it; whether enough mutants are seen.
///
/// # Errors
/// `Usage` for an unknown kernel, without a shader compiler, or when tests fail without a fault.
pub fn run(root: &Path, options: &Options) -> Result<bool> {
    let root = &root.canonicalize().map_err(|e| Error::io(root, "find", e))?;
    if let Some(unknown) = options.kernel.iter().find(|name| engine::kernels().all(|k| k.name != **name)) {
        return Err(Error::usage("--kernel", format!("`{unknown}`"), "the name of a kernel, as in spgs-dev docs"));
    }
    let wanted = |name: &str| options.kernel.is_empty() || options.kernel.iter().any(|k| k == name);
    let drawn = draw(plant::mutants(root, wanted)?, options.seed);
    if options.list {
        drawn.iter().take(options.count).for_each(|mutant| output::line(&mutant.describe()));
        return Ok(true);
    }
    let folder = options.results.clone().unwrap_or_else(|| root.join("target/mutants"));
    std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, "make", e))?;
    let mut run = Run::new(root, &folder, if options.twins { TWIN_TESTS } else { "*" })?;
    let equivalents = Equivalents::new()?;
    let (mut seen, mut survivors, mut passed_over) = (0, Vec::new(), 0);
    let bar = progress::sweep(options.count as u64, options.quiet);
    for mutant in &drawn {
        if seen + survivors.len() == options.count {
            break;
        }
        if equivalents.reason(mutant).is_some() {
            passed_over += 1;
            continue;
        }
        bar.set_message(mutant.file.display().to_string());
        let record = run.record(mutant)?;
        match record.outcome {
            Outcome::Seen => seen += 1,
            Outcome::Survived => survivors.push(record.mutant.clone()),
            Outcome::Rejected | Outcome::Same => continue,
        }
        bar.inc(1);
        if options.json {
            bar.suspend(|| output::line(&json!(record).to_string()));
        } else if record.outcome == Outcome::Survived {
            bar.suspend(|| output::line(&format!("survived: {}", record.mutant)));
        }
    }
    bar.finish_and_clear();
    let total = seen + survivors.len();
    output::line(&summary(seen, total, passed_over, options.json));
    Ok(total > 0 && seen as f64 >= WANTED_SHARE * total as f64)
}

fn summary(seen: usize, total: usize, passed_over: usize, as_json: bool) -> String {
    if as_json {
        return json!({ "mutants": total, "seen": seen, "equivalent": passed_over, "wanted_share": WANTED_SHARE })
            .to_string();
    }
    let percent = 100.0 * seen as f64 / total.max(1) as f64;
    let wanted = 100.0 * WANTED_SHARE;
    format!(
        "{seen} of {total} mutants seen, {percent:.1} %, expected {wanted:.0} %; {passed_over} passed over, which change \
         nothing (tools/src/dev/mutants/equivalent.json)"
    )
}

/// All mutants in the order of drawing: each kind of fault in turn, at random within a kind. An edit of one file leaves the
/// order of the others as it is.
fn draw(mutants: Vec<Mutant>, seed: u64) -> Vec<Mutant> {
    let mut kinds = FAULTS.map(|_| Vec::new());
    for mutant in mutants {
        let rank = spirv::sha256(format!("{seed} {}", mutant.id()).as_bytes());
        if let Some(kind) = FAULTS.iter().position(|fault| *fault == mutant.site.fault) {
            kinds[kind].push((rank, mutant));
        }
    }
    let mut turns = Vec::new();
    for kind in &mut kinds {
        kind.sort_by(|a, b| a.0.cmp(&b.0));
        turns.extend(kind.drain(..).enumerate().map(|(turn, (_, mutant))| (turn, mutant)));
    }
    turns.sort_by_key(|(turn, _)| *turn);
    turns.into_iter().map(|(_, mutant)| mutant).collect()
}

/// What a run works with.
struct Run {
    workshop: Workshop,
    judge: Judge,
    results: Results,
    /// When the newest test binary was built.
    tests: u64,
}

impl Run {
    fn new(root: &Path, folder: &Path, tests: &str) -> Result<Self> {
        let binaries = suite::build(root, tests)?;
        let mut tests = 0;
        for binary in &binaries {
            tests = tests.max(cover::built(&binary.path)?);
        }
        let coverage = Coverage::open(&folder.join("coverage.json"))?;
        let results = Results::open(&folder.join("results.json"))?;
        Ok(Self { workshop: Workshop::new(root)?, judge: Judge { binaries, coverage }, results, tests })
    }

    /// What becomes of a mutant, if it is not known already.
    fn record(&mut self, mutant: &Mutant) -> Result<Record> {
        let id = mutant.id();
        if let Some(known) = self.results.get(&id, self.tests) {
            return Ok(known.clone());
        }
        let (outcome, by) = match self.workshop.plant(mutant)? {
            Planted::Rejected => (Outcome::Rejected, None),
            Planted::Same => (Outcome::Same, None),
            Planted::Kernels(kernels) => match self.judge.seen(&kernels, &self.workshop.spirv())? {
                Some(by) => (Outcome::Seen, Some(by)),
                None => (Outcome::Survived, None),
            },
        };
        let record = Record { mutant: mutant.describe(), outcome, by, tests: self.tests };
        self.results.insert(id, record.clone())?;
        Ok(record)
    }
}
