//! The command: which targets, what is printed, what the exit status says.

use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use serde_json::json;

use super::child::child;
use super::compare::{check, write};
use super::run::{Collected, Run, collect};
use super::table::text;
use super::target::{Target, target, targets};
use crate::cli::output;

/// Options of `spgs-dev isa`.
#[derive(Debug, Default, clap::Args)]
pub struct Options {
    /// Targets (default: those whose drivers are there)
    #[arg(value_name = "TARGET")]
    targets: Vec<String>,
    /// Fail on spills, private memory, too few subgroups in flight, and on what is worse than in tests/golden/isa
    #[arg(long)]
    check: bool,
    /// Replace the files in tests/golden/isa
    #[arg(long, conflicts_with = "check")]
    write: bool,
    /// Every pipeline; else the worst of each kernel
    #[arg(long)]
    all: bool,
    /// One JSON object per pipeline and line
    #[arg(long)]
    json: bool,
    /// The script that knows the drivers (default: ci/drivers)
    #[arg(long, value_name = "FILE")]
    drivers: Option<PathBuf>,
    /// Make every pipeline on this process's device and print its statistics
    #[arg(long, hide = true, value_name = "SUBGROUP SIZE")]
    child: Option<u32>,
}

/// Runs it; whether all is well.
///
/// # Errors
/// `Usage` for an unknown target or one whose driver is not there; those of the drivers and golden files.
pub fn run(root: &Path, options: &Options) -> Result<bool> {
    if let Some(size) = options.child {
        child(size)?.iter().for_each(|line| output::line(line));
        return Ok(true);
    }
    let chosen: Vec<&Target> = match options.targets.as_slice() {
        [] => targets().collect(),
        names => names.iter().map(|n| target(n)).collect::<Result<_>>()?,
    };
    let program = std::env::current_exe().map_err(|e| Error::io(Path::new("spgs-dev"), "find", e))?;
    let script = options.drivers.clone().unwrap_or_else(|| root.join("ci/drivers"));
    let how = Run { program: &program, drivers: &script };
    let mut good = true;
    let at_once = std::thread::available_parallelism().map_or(1, usize::from);
    for some in chosen.chunks(at_once) {
        let collected = std::thread::scope(|scope| {
            let running: Vec<_> = some.iter().map(|t| scope.spawn(|| collect(t, how))).collect();
            running
                .into_iter()
                .map(|r| r.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
                .collect::<Vec<_>>()
        });
        for (target, collected) in some.iter().zip(collected) {
            good &= report(root, options, target, collected?)?;
        }
    }
    Ok(good)
}

fn report(root: &Path, options: &Options, target: &Target, collected: Collected) -> Result<bool> {
    let (device, rows) = match collected {
        Collected::Rows(device, rows) => (device, rows),
        Collected::Absent(why) if options.targets.is_empty() => {
            log::warn!("SKIPPED: {}: {why}", target.name);
            return Ok(true);
        }
        Collected::Absent(why) => return Err(Error::NoDevice { reason: format!("{}: {why}", target.name) }),
    };
    if options.json {
        rows.iter().for_each(|row| output::line(&json!({ "target": target.name, "pipeline": row }).to_string()));
    } else {
        output::line(&format!("== {}: {device}, {} pipelines", target.name, rows.len()));
        if !options.check {
            output::line(&text(&rows, !options.all));
        }
    }
    if options.write {
        write(root, target, &device, &rows)?;
    }
    if !options.check {
        return Ok(true);
    }
    let outcome = check(root, target, &device, &rows)?;
    if let Some(other) = &outcome.other_compiler {
        log::warn!("{}: the golden file is of another compiler ({other}): compared with the limits only", target.name);
    }
    outcome.errors.iter().for_each(|error| output::error_line(&format!("spgs-dev: {error}")));
    if outcome.better > 0 {
        let better = outcome.better;
        output::line(&format!(
            "{}: {better} values are better than golden; spgs-dev isa --write keeps them",
            target.name
        ));
    }
    Ok(outcome.errors.is_empty())
}
