//! `run.jsonl`: one JSON object per line, appended while a run goes on. A line is a step (`loss` …), an evaluation
//! (`evaluation`), or a change of the number of Gaussians (`density`); every one has `iteration`,
//! `stage` and `seconds`. An evaluation is scored while the run goes on: its line comes after those of some later steps, and
//! before the checkpoint of its iteration.

use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use engine::error::{Error, Result};
use engine::file::durable::write_atomic;
use engine::train::schedule::Stage;
use serde_json::{Value, json};

/// The log of a run.
#[derive(Debug)]
pub struct RunLog {
    path: PathBuf,
    file: File,
    start: Instant,
    stage: Stage,
    /// Seconds of the run before this process.
    before: f64,
}

/// A log that several threads write to, line by line.
#[derive(Debug, Clone)]
pub struct SharedLog(Arc<Mutex<RunLog>>);

impl SharedLog {
    /// Shares a log.
    pub fn new(log: RunLog) -> Self {
        Self(Arc::new(Mutex::new(log)))
    }

    fn lock(&self) -> MutexGuard<'_, RunLog> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// [`RunLog::seconds`].
    pub fn seconds(&self) -> f64 {
        self.lock().seconds()
    }

    /// [`RunLog::line`].
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn line(&self, iteration: u64, value: Value) -> Result<()> {
        self.lock().line(iteration, value)
    }

    /// [`RunLog::line`] of what was so at `seconds`.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn line_at(&self, iteration: u64, seconds: f64, value: Value) -> Result<()> {
        self.lock().line_at(iteration, seconds, value)
    }
}

/// Lines of an earlier process that stay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kept {
    /// None: a new run.
    Nothing,
    /// Those of earlier stages, and of this one up to an iteration.
    UpTo(u64),
}

impl RunLog {
    /// Opens the log in `folder` for a stage of the run.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn open(folder: &Path, kept: Kept, stage: Stage) -> Result<Self> {
        let path = folder.join("run.jsonl");
        let own = json!(stage);
        let stays = |v: &Value, last: u64| v["stage"] != own || number(v, "iteration") <= last as f64;
        let kept: Vec<Value> = match kept {
            Kept::Nothing => Vec::new(),
            Kept::UpTo(last) => read(&path)?.into_iter().filter(|v| stays(v, last)).collect(),
        };
        let before = kept.iter().map(|v| number(v, "seconds")).fold(0.0, f64::max);
        write_atomic(&path, |out| kept.iter().try_for_each(|v| writeln!(out, "{v}")))?;
        let file = OpenOptions::new().append(true).open(&path).map_err(|e| Error::io(&path, "open", e))?;
        Ok(Self { path, file, start: Instant::now(), stage, before })
    }

    /// Seconds that the run has taken, earlier processes included.
    pub fn seconds(&self) -> f64 {
        self.before + self.start.elapsed().as_secs_f64()
    }

    /// Appends a line; `iteration`, `stage` and `seconds` are added.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn line(&mut self, iteration: u64, value: Value) -> Result<()> {
        self.line_at(iteration, self.seconds(), value)
    }

    fn line_at(&mut self, iteration: u64, seconds: f64, value: Value) -> Result<()> {
        let seconds = (seconds * 1e3).round() / 1e3;
        let mut line = json!({ "iteration": iteration, "stage": self.stage, "seconds": seconds });
        if let (Value::Object(line), Value::Object(value)) = (&mut line, value) {
            line.extend(value);
        }
        writeln!(self.file, "{line}").map_err(|e| Error::io(&self.path, "write", e))
    }
}

/// All lines of a log; a last line that was cut off is left out.
///
/// # Errors
/// [`Error::Io`]; [`Error::Corrupt`] naming the line.
pub fn read(path: &Path) -> Result<Vec<Value>> {
    let file = match File::open(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => other.map_err(|e| Error::io(path, "open", e))?,
    };
    let lines: Vec<String> =
        BufReader::new(file).lines().collect::<std::io::Result<_>>().map_err(|e| Error::io(path, "read", e))?;
    let mut values = Vec::with_capacity(lines.len());
    for (i, line) in lines.iter().enumerate() {
        match serde_json::from_str(line) {
            Ok(value) => values.push(value),
            Err(_) if i + 1 == lines.len() => {}
            Err(e) => return Err(Error::corrupt(path, format!("line {}", i + 1), e.to_string(), "a JSON object")),
        }
    }
    Ok(values)
}

/// A number of a line; 0 when it is not there.
pub fn number(value: &Value, key: &str) -> f64 {
    value.get(key).and_then(Value::as_f64).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn a_resumed_log_goes_on_where_the_checkpoint_is() {
        let folder = tempfile::tempdir().unwrap();
        let mut log = RunLog::open(folder.path(), Kept::Nothing, Stage::Rigid).unwrap();
        for i in 1..=5 {
            log.line(i, json!({ "loss": 0.5 })).unwrap();
        }
        drop(log);
        // A crash cut the last line off.
        let path = folder.path().join("run.jsonl");
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 4]).unwrap();
        let mut log = RunLog::open(folder.path(), Kept::UpTo(3), Stage::Rigid).unwrap();
        log.line(4, json!({ "loss": 0.25 })).unwrap();
        let lines = read(&path).unwrap();
        assert_eq!(lines.iter().map(|v| number(v, "iteration")).collect::<Vec<_>>(), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(number(&lines[3], "loss"), 0.25);
    }
}
