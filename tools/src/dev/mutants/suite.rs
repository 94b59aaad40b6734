//! Test binaries, run from outside: what counts is what they say and how they end.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use engine::error::{Error, Result};

/// A test binary that cargo has built.
#[derive(Debug, Clone)]
pub(super) struct Binary {
    /// Name of the target.
    pub(super) name: String,
    pub(super) path: PathBuf,
}

impl Binary {
    /// Its tests compare kernels with their twins.
    pub(super) fn is_of_twins(&self) -> bool {
        self.name.starts_with("kernels_")
    }
}

/// How tests ended.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// All passed.
    Green,
    /// A test failed, or the process crashed or hung: which and how.
    Red(String),
}

/// Variables of the environment.
pub(super) type Environment<'a> = &'a [(&'a str, &'a str)];

/// Variables that change what tests do; a run has only those that it sets.
const CLEARED: [&str; 9] = [
    "SPGS_VALIDATION",
    "SPGS_TEST_SPIRV",
    "SPGS_TEST_COVERAGE",
    "SPGS_TEST_MODEL",
    "SPGS_TEST_MODEL_MODE",
    "SPGS_TEST_MODEL_LOG",
    "SPGS_TEST_SMALL",
    "SPGS_TEST_LANES",
    "LP_NATIVE_VECTOR_WIDTH",
];

/// Builds the test binaries of the package `spgs-tests` whose names match and lists them.
///
/// # Errors
/// `Io` when cargo cannot be started; `Usage` when it fails.
pub(super) fn build(root: &Path, names: &str) -> Result<Vec<Binary>> {
    let ran = Command::new("cargo")
        .current_dir(root)
        .args(["test", "--package=spgs-tests", "--no-run", "--message-format=json", "--test", names])
        .stderr(Stdio::inherit())
        .output()
        .map_err(|e| Error::io(Path::new("cargo"), "run", e))?;
    if !ran.status.success() {
        return Err(Error::usage("the tests", "they do not compile", "tests to run"));
    }
    let messages = String::from_utf8_lossy(&ran.stdout);
    let built = messages.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    Ok(built.filter_map(|message| binary(&message)).collect())
}

fn binary(message: &serde_json::Value) -> Option<Binary> {
    let is_test = message["target"]["kind"][0].as_str()? == "test";
    let path = message["executable"].as_str().filter(|_| is_test)?;
    Some(Binary { name: message["target"]["name"].as_str()?.to_owned(), path: path.into() })
}

/// Runs some tests of a binary (none named: all) and stops at the first that fails.
///
/// # Errors
/// `Io` when the binary cannot be started.
pub(super) fn run(binary: &Binary, tests: &[String], set: Environment<'_>, limit: Duration) -> Result<Verdict> {
    let mut command = Command::new(&binary.path);
    for name in CLEARED {
        command.env_remove(name);
    }
    command.envs(set.iter().copied()).args(tests).stdout(Stdio::piped()).stderr(Stdio::null());
    if !tests.is_empty() {
        command.arg("--exact");
    }
    // Tests of the package find their files from its folder, as under cargo.
    let mut child =
        command.current_dir(package_folder(&binary.path)).spawn().map_err(|e| Error::io(&binary.path, "run", e))?;
    let lines = lines(&mut child);
    let verdict = listen(&lines, Instant::now() + limit);
    if verdict.is_some() {
        drop(child.kill());
    }
    let status = child.wait().map_err(|e| Error::io(&binary.path, "wait for", e))?;
    Ok(verdict.unwrap_or_else(|| if status.success() { Verdict::Green } else { Verdict::Red(format!("{status}")) }))
}

/// `tests/` of the workspace whose `target/debug/deps` holds the binary.
fn package_folder(binary: &Path) -> PathBuf {
    binary.ancestors().nth(4).unwrap_or(Path::new(".")).join("tests")
}

fn lines(child: &mut Child) -> Receiver<String> {
    let (send, receive) = channel();
    if let Some(stdout) = child.stdout.take() {
        std::thread::spawn(move || {
            BufReader::new(stdout).lines().map_while(std::result::Result::ok).all(|line| send.send(line).is_ok())
        });
    }
    receive
}

/// The first failure that is told before the output ends.
fn listen(lines: &Receiver<String>, end: Instant) -> Option<Verdict> {
    loop {
        match lines.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok(line) => {
                if let Some(name) = line.strip_prefix("test ").and_then(|l| l.strip_suffix(" ... FAILED")) {
                    return Some(Verdict::Red(name.to_owned()));
                }
            }
            Err(RecvTimeoutError::Timeout) => return Some(Verdict::Red("past the time limit".to_owned())),
            Err(RecvTimeoutError::Disconnected) => return None,
        }
    }
}

#[cfg(all(test, unix))] // The programs are shell scripts.
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn of(script: &str, limit_ms: u64) -> Verdict {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("target/debug/deps/fake");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::create_dir(folder.path().join("tests")).unwrap();
        std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        let mut mode = std::fs::metadata(&path).unwrap().permissions();
        std::os::unix::fs::PermissionsExt::set_mode(&mut mode, 0o755);
        std::fs::set_permissions(&path, mode).unwrap();
        run(&Binary { name: "fake".into(), path }, &[], &[], Duration::from_millis(limit_ms)).unwrap()
    }

    #[test]
    fn a_failure_a_crash_and_a_hang_are_seen() {
        assert_eq!(of("echo 'test a ... ok'", 60_000), Verdict::Green);
        assert_eq!(of("echo 'test b::c ... FAILED'; exec sleep 600", 60_000), Verdict::Red("b::c".into()));
        assert!(matches!(of("kill -9 $$", 60_000), Verdict::Red(how) if how.contains("signal: 9")));
        assert!(matches!(of("exec sleep 600", 300), Verdict::Red(how) if how.contains("limit")));
    }
}
