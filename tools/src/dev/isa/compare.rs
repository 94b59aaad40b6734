//! Golden files: a line per pipeline.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use engine::file::durable::write_atomic;

use super::limits;
use super::statistics::{COLUMNS, Row, Statistics};
use super::target::{GOLDEN, Target};

/// A value may be this share larger than the golden one, or this much.
const SHARE: f64 = 0.1;
const REGISTERS: f64 = 8.0;

/// What a comparison found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Outcome {
    /// What is wrong.
    pub errors: Vec<String>,
    /// What became better than the golden file says.
    pub better: usize,
    /// The compiler that the golden file is of, when it is another one: then only the limits were looked at.
    pub other_compiler: Option<String>,
}

fn path(root: &Path, target: &Target) -> PathBuf {
    root.join(GOLDEN).join(format!("{}.tsv", target.name))
}

/// Replaces the golden file.
///
/// # Errors
/// `Io`.
pub fn write(root: &Path, target: &Target, device: &str, rows: &[Row]) -> Result<()> {
    let folder = root.join(GOLDEN);
    std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, "make folder", e))?;
    let names: Vec<&str> = COLUMNS.iter().map(|c| c.name).collect();
    let mut text = format!("{}\n# kernel\t{}\n", header(target, device), names.join("\t"));
    for row in rows {
        let values: Vec<String> = COLUMNS.iter().map(|c| (c.get)(&row.statistics).to_string()).collect();
        let _ = writeln!(text, "{}\t{}", row.name(), values.join("\t"));
    }
    write_atomic(&path(root, target), |out| out.write_all(text.as_bytes()))
}

/// What the golden file of a target says.
///
/// # Errors
/// `Io` and `Corrupt`.
pub fn golden(root: &Path, target: &Target) -> Result<Vec<Row>> {
    let path = path(root, target);
    let text = read(&path)?;
    let lines = text.lines().enumerate().filter(|(_, l)| !l.starts_with('#'));
    lines
        .map(|(i, line)| {
            let expected = format!("a kernel and {} numbers", COLUMNS.len());
            row(line).ok_or_else(|| Error::corrupt(&path, format!("line {}", i + 1), format!("`{line}`"), expected))
        })
        .collect()
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))
}

/// First line of a golden file.
fn header(target: &Target, device: &str) -> String {
    format!("# {device}; subgroups of {}", target.subgroup_size)
}

/// A line `kernel[constants]` and the values of the columns, divided by tabs.
fn row(line: &str) -> Option<Row> {
    let words: Vec<&str> = line.split('\t').collect();
    let (kernel, constants) = words[0].strip_suffix(']')?.split_once('[')?;
    let constants = constants.split_whitespace().map(str::parse).collect::<std::result::Result<_, _>>().ok()?;
    Some(Row { kernel: kernel.to_owned(), constants, statistics: Statistics::parse(&words[1..])? })
}

/// Compares with the limits and, if that is of the same device and driver, with the golden file.
///
/// # Errors
/// `Io` and `Corrupt` for the golden file.
pub fn check(root: &Path, target: &Target, device: &str, rows: &[Row]) -> Result<Outcome> {
    let found = read(&path(root, target))?.lines().next().unwrap_or_default().to_owned();
    let other_compiler = (found != header(target, device)).then_some(found);
    let rows_before = golden(root, target)?;
    let mut before: BTreeMap<String, &Statistics> = rows_before.iter().map(|r| (r.name(), &r.statistics)).collect();
    let mut outcome = Outcome { other_compiler, ..Outcome::default() };
    for row in rows {
        outcome.errors.extend(limits::broken(target, row));
        let name = row.name();
        match before.remove(&name) {
            None => outcome.errors.push(format!("{}: {name} is not in the golden file", target.name)),
            Some(before) if outcome.other_compiler.is_none() => {
                compare(target, &name, [before, &row.statistics], &mut outcome);
            }
            Some(_) => {}
        }
    }
    outcome.errors.extend(before.keys().map(|name| format!("{}: {name} is in the golden file only", target.name)));
    Ok(outcome)
}

fn compare(target: &Target, name: &str, [before, now]: [&Statistics; 2], outcome: &mut Outcome) {
    for column in &COLUMNS {
        // Fewer subgroups in flight are worse, more of all else.
        let sign = if column.name == "occupancy" { -1.0 } else { 1.0 };
        let (old, new) = ((column.get)(before), (column.get)(now));
        let least = if column.name == "registers" { REGISTERS } else { 0.0 };
        let slack = match column.name {
            "spills" | "scratch" | "shared" => 0.0,
            _ => (SHARE * old).max(least),
        };
        if sign * (new - old) > slack {
            outcome.errors.push(format!("{}: {name}: {} is {new}, golden {old}", target.name, column.name));
        } else if sign * (old - new) > slack {
            outcome.better += 1;
        }
    }
}
