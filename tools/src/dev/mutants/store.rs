//! What a run remembers, in JSON files.

use std::io::ErrorKind;
use std::path::Path;

use engine::error::{Error, Result};
use serde::{Serialize, de::DeserializeOwned};

use crate::report::files::{to_json, write_text};

/// What the file holds; nothing when there is none.
///
/// # Errors
/// `Io`; `Corrupt` when the file is none of ours.
pub(super) fn read<T: DeserializeOwned + Default>(path: &Path, what: &str) -> Result<T> {
    match std::fs::read_to_string(path) {
        Ok(text) => serde_json::from_str(&text)
            .map_err(|e| Error::corrupt(path, format!("line {}", e.line()), e.to_string(), what)),
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(T::default()),
        Err(e) => Err(Error::io(path, "read", e)),
    }
}

/// Replaces the file at once.
///
/// # Errors
/// `Io` when it cannot be written.
pub(super) fn write(path: &Path, value: &impl Serialize) -> Result<()> {
    write_text(path, &to_json(value)?)
}
