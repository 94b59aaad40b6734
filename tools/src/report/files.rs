//! Writing results.

use std::path::Path;

use engine::error::{Error, Result};
use engine::file::durable::write_atomic;

/// Makes a folder and those above it.
///
/// # Errors
/// A folder that cannot be made.
pub fn create_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "make folder", e))
}

/// Writes a text file into a folder that exists.
///
/// # Errors
/// `Usage` where there is no such folder; a file that cannot be written.
pub fn write_text(path: &Path, text: &str) -> Result<()> {
    if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty())
        && !folder.is_dir()
    {
        return Err(Error::usage(format!("{}", path.display()), "a folder that does not exist", "an existing folder"));
    }
    write_atomic(path, |out| out.write_all(text.as_bytes()))
}

/// A value as indented JSON. Numbers that are not finite become `null`.
///
/// # Errors
/// `Usage` for what JSON cannot hold.
pub fn to_json(value: &impl serde::Serialize) -> Result<String> {
    serde_json::to_string_pretty(value).map_err(|e| Error::usage("JSON output", e.to_string(), "serialisable values"))
}
