//! `spgs` as a process, and pictures for it.

use std::path::Path;
use std::process::{Command, Stdio};

use clap::Parser as _;
use engine::file::picture::{self, Alpha};
use engine::image::Image;
use serde_json::Value;
use tests_harness::render_case::Random;
use tools::cli::args::Cli;

/// Environment variable that makes a test process a `spgs` process: its arguments, one per line.
const ARGUMENTS: &str = "SPGS_TEST_ARGUMENTS";
/// File that the process's standard output goes to, without what the test framework prints.
const MARK: &str = "=== spgs ===";

/// The body of `spgs`; does nothing in an ordinary test run.
#[test]
fn spgs_process() {
    let Ok(arguments) = std::env::var(ARGUMENTS) else { return };
    println!("{MARK}");
    let code = tools::cli::output::run_main("spgs", move || {
        let cli = Cli::try_parse_from(std::iter::once("spgs").chain(arguments.lines())).unwrap();
        tools::command::run(&cli)
    });
    std::process::exit((0..=9).find(|&k| code == std::process::ExitCode::from(k)).unwrap_or(1).into());
}

/// What a `spgs` process did.
#[derive(Debug)]
pub struct Outcome {
    pub code: i32,
    pub out: String,
    pub error: String,
}

/// Runs `spgs` with these arguments to its end.
pub fn spgs(arguments: &[&str]) -> Outcome {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "common::spgs_process", "--nocapture", "--test-threads=1"]);
    let output = command.env(ARGUMENTS, arguments.join("\n")).stdin(Stdio::null()).output().unwrap();
    let out = String::from_utf8(output.stdout).unwrap();
    let out = out.split_once(&format!("{MARK}\n")).unwrap().1.to_owned();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!error.contains("validation layer"), "{error}");
    Outcome { code: output.status.code().unwrap_or(-1), out, error }
}

/// A run that must end well; its standard output.
pub fn ok(arguments: &[&str]) -> String {
    let outcome = spgs(arguments);
    assert_eq!(outcome.code, 0, "{arguments:?}: {outcome:?}");
    outcome.out
}

/// Standard output as JSON.
pub fn ok_json(arguments: &[&str]) -> Value {
    serde_json::from_str(&ok(arguments)).unwrap()
}

/// The one line that bad data get, with exit code 3 and nothing on standard output.
pub fn bad_data(arguments: &[&str]) -> String {
    let outcome = spgs(arguments);
    assert_eq!(outcome.code, 3, "{arguments:?}: {outcome:?}");
    assert!(outcome.out.trim().is_empty(), "{outcome:?}");
    let lines: Vec<&str> = outcome.error.lines().filter(|l| !l.starts_with("spgs: warning: ")).collect();
    assert_eq!(lines.len(), 1, "{outcome:?}");
    assert!(lines[0].starts_with("spgs: ") && !lines[0].contains("panicked"), "{outcome:?}");
    lines[0].to_owned()
}

/// A number of the JSON, but for the last bit that reading it may lose.
pub fn assert_close(found: &Value, expected: f64) {
    assert!(found.as_f64().is_some_and(|v| (v - expected).abs() <= 1e-12 * expected.abs()), "{found}, {expected}");
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A smooth picture with some noise.
pub fn picture(size: [u32; 2], seed: u64) -> Image {
    let mut random = Random(seed);
    let mut rgba = Vec::new();
    for i in 0..size[0] * size[1] {
        let (x, y) = ((i % size[0]) as f32, (i / size[0]) as f32);
        let wave = |f: f32| 0.5 + 0.3 * (f * x + 0.05 * y).sin();
        rgba.extend([0.05, 0.11, 0.02].map(|f| wave(f) + random.range(-0.1, 0.1)));
        rgba.push(1.0);
    }
    Image { width: size[0], height: size[1], rgba, depth: Vec::new() }
}

/// Writes a PNG.
pub fn write(path: &Path, image: &Image) {
    picture::write_png(path, image, Alpha::Drop).unwrap();
}
