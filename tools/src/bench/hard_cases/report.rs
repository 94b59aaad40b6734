//! `spgs bench hard-cases`: runs the cases; a table on the terminal, everything as JSON, a page.

use std::process::ExitCode;

use engine::error::Result;
use serde_json::{Value, json};

use super::case::{Bound, Check, Context, GROUPS, Row};
use super::list::cases;
use crate::cli::args::{Global, HardCasesArgs};
use crate::cli::{gpu_session, output, progress};
use crate::report::page::{Align, Page, Standing, Table};
use crate::report::provenance;

/// Exit code when a bound does not hold, and when a number is not finite.
const MISSED: u8 = 1;
const NOT_FINITE: u8 = 6;

/// Judges every case and reports. Exit code 0: all hold; 6: a number is not finite; 1: a bound does not hold.
///
/// # Errors
/// No device, a lost device, a file that cannot be written.
pub fn run(args: &HardCasesArgs, global: &Global) -> Result<ExitCode> {
    let gpu = gpu_session::open(global)?;
    let context = Context { gpu: &gpu, runs: args.runs, frames: args.frames };
    let cases = cases();
    let bar = progress::bar(cases.len() as u64, global.quiet);
    let mut rows = Vec::with_capacity(cases.len());
    for case in &cases {
        rows.push(case.run(&context)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    gpu_session::report_validation(&gpu);
    let failed: Vec<&str> = rows.iter().filter(|r| !r.pass).map(|r| r.name.as_str()).collect();
    let numbers = json!({
        "runs": context.runs,
        "drift_frames": context.frames,
        "groups": GROUPS,
        "cases": rows,
        "passed": rows.len() - failed.len(),
        "failed": failed,
        "ms": rows.iter().map(|r| r.ms).sum::<f64>(),
    });
    let record = provenance::record(Some("hard_cases"), &gpu, numbers);
    args.results.write(&record, || Ok(html(&record, &rows)))?;
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(text(&rows).trim_end());
    }
    for row in rows.iter().filter(|r| !r.pass) {
        output::error_line(&format!("spgs: case {} `{}`: {}", row.number, row.name, why(row)));
    }
    Ok(ExitCode::from(match &rows {
        rows if rows.iter().any(|r| !r.finite) => NOT_FINITE,
        rows if rows.iter().any(|r| !r.pass) => MISSED,
        _ => 0,
    }))
}

/// Why a row fails: the engine's error, or the bounds that do not hold.
fn why(row: &Row) -> String {
    let missed: Vec<String> = row.checks.iter().filter(|c| !c.passes()).map(describe).collect();
    row.error.clone().unwrap_or_else(|| missed.join("; "))
}

/// A value with its bound.
fn describe(check: &Check) -> String {
    match check.bound {
        Bound::Shown => value(check),
        _ => format!("{} ({})", value(check), bound(check)),
    }
}

/// Short and without loss of what matters: integers as such, large and small numbers with an exponent.
fn number(value: f64) -> String {
    match value {
        v if v == v.trunc() && v.abs() < 1.0e7 => format!("{v:.0}"),
        v if (0.01..1.0e4).contains(&v.abs()) => format!("{v:.3}"),
        v => format!("{v:.1e}"),
    }
}

/// One line per case: verdict, time, and the most telling number.
fn text(rows: &[Row]) -> String {
    let mut lines = Vec::new();
    for (i, title) in GROUPS.iter().enumerate() {
        lines.push(format!("{:2}  {title}", i + 1));
        for row in rows.iter().filter(|r| r.number == i + 1) {
            let verdict = if row.pass { "pass" } else { "FAIL" };
            let shown = if row.pass { headline(row) } else { why(row) };
            lines.push(format!("    {verdict}  {:34} {:8.1} ms  {shown}", row.name, row.ms));
        }
    }
    let passed = rows.iter().filter(|r| r.pass).count();
    let seconds = rows.iter().map(|r| r.ms).sum::<f64>() / 1e3;
    lines.push(format!("{passed} of {} cases hold, {seconds:.1} s", rows.len()));
    lines.join("\n")
}

/// The first number, and the first with a bound.
fn headline(row: &Row) -> String {
    let bounded = row.checks.iter().find(|c| c.bound != Bound::Shown);
    let first = row.checks.first().filter(|c| c.bound == Bound::Shown);
    first.into_iter().chain(bounded).map(describe).collect::<Vec<_>>().join(", ")
}

/// The page: a table of all cases, failures first, then every number of every case.
fn html(record: &Value, rows: &[Row]) -> String {
    let mut page = Page::new("spgs bench hard-cases");
    page.provenance(record);
    let passed = rows.iter().filter(|r| r.pass).count();
    page.note(&format!("{passed} of {} cases hold.", rows.len()));
    page.text(
        "Each case is a small scene that has broken some renderer. The truth is a 64-bit reference of the same definition, \
         so an error is the device's arithmetic, not a choice of method; numbers without a bound describe the method or the \
         input.",
    );
    let columns = ["case", "input", "what the truth says", "error", "bound", "verdict", "ms"];
    for (i, title) in GROUPS.iter().enumerate() {
        page.subheading(&format!("{} {title}", i + 1));
        let align = |name: &'static str| (name, if name == "ms" { Align::Right } else { Align::Left });
        let mut table = Table::new(&columns.map(align));
        for row in rows.iter().filter(|r| r.number == i + 1) {
            let standing = if row.pass { Standing::Good } else { Standing::Bad };
            let verdict = if row.pass { "pass" } else { "FAIL" };
            let lead = [row.name.clone(), row.input.clone(), row.truth.clone()];
            let first = row.checks.first();
            let (error, limit) = match (&row.error, first) {
                (Some(error), _) => (error.clone(), String::new()),
                (None, first) => (first.map_or(String::new(), value), first.map_or(String::new(), bound)),
            };
            let tail = [error, limit, verdict.to_owned(), format!("{:.1}", row.ms)];
            table.marked(standing, lead.into_iter().chain(tail));
            for check in row.checks.iter().skip(1) {
                let standing = if check.passes() { Standing::Plain } else { Standing::Bad };
                let blank = || String::new();
                table.marked(standing, [blank(), blank(), blank(), value(check), bound(check), blank(), blank()]);
            }
        }
        page.table(&table);
    }
    page.finish()
}

/// What was measured.
fn value(check: &Check) -> String {
    format!("{} {}", check.what, number(check.value))
}

/// What it is held against.
fn bound(check: &Check) -> String {
    match check.bound {
        Bound::AtMost(bound) => format!("at most {}", number(bound)),
        Bound::AtLeast(bound) => format!("at least {}", number(bound)),
        Bound::Exactly(expected) => format!("exactly {}", number(expected)),
        Bound::Shown => "–".into(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn row(pass: bool) -> Row {
        let checks =
            vec![Check::shown("largest", 1.5e-7), Check::at_least("PSNR, dB", if pass { 70.0 } else { 60.0 }, 65.0)];
        let (name, input, truth) = ("a".to_owned(), "b.".to_owned(), "c".to_owned());
        Row { number: 3, name, input, truth, checks, error: None, pass, finite: true, ms: 12.0 }
    }

    #[test]
    fn a_row_says_what_was_missed() {
        assert_eq!(why(&row(false)), "PSNR, dB 60 (at least 65)");
        let refused = Row { error: Some("device says no".into()), ..row(false) };
        assert_eq!(why(&refused), "device says no");
        let table = text(&[row(true), row(false)]);
        assert!(
            table.contains("pass  a") && table.contains("FAIL  a") && table.contains("1 of 2 cases hold"),
            "{table}"
        );
        assert!(table.contains("largest 1.5e-7, PSNR, dB 70 (at least 65)"), "{table}");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!([0.0, 3.0, 65.25, 1.23e-7, 5.0e9].map(number), ["0", "3", "65.250", "1.2e-7", "5.0e9"]);
    }
}
