//! Read-only memory mapping of whole files. Here because it takes `unsafe`, which only this module may write.

use std::fs::File;
use std::ops::Deref;
use std::path::Path;

use crate::error::{Error, Result};

/// A file's bytes, paged in by the system when touched.
#[derive(Debug)]
pub struct MappedFile(memmap2::Mmap);

impl Deref for MappedFile {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}

/// Maps the regular file at `path`. An empty file gives empty bytes.
///
/// # Errors
/// [`Error::Io`]; [`Error::Usage`] for anything but a regular file (a pipe cannot be mapped).
pub fn map_file(path: &Path) -> Result<MappedFile> {
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let metadata = file.metadata().map_err(|e| Error::io(path, "read the size", e))?;
    if !metadata.is_file() {
        let found = if metadata.is_dir() { "a directory" } else { "a device or pipe" };
        return Err(Error::usage(path.display().to_string(), found, "a regular file"));
    }
    // SAFETY: the mapping is private and read-only. What cannot be ruled out is that another process changes the file
    // while it is mapped: changed bytes are plain integers and floats, for which every value is valid, and every number
    // taken from the map is range-checked where it is used; truncation ends the process with SIGBUS, as for every
    // program that maps files. Our own writer never changes a file in place (temporary file, then rename).
    let map = unsafe { memmap2::Mmap::map(&file) }.map_err(|e| Error::io(path, "map", e))?;
    Ok(MappedFile(map))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn maps_files_and_refuses_the_rest() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        std::fs::write(&path, b"abc").unwrap();
        assert_eq!(&map_file(&path).unwrap()[..], b"abc");
        std::fs::write(&path, b"").unwrap();
        assert!(map_file(&path).unwrap().is_empty());
        assert!(matches!(map_file(folder.path()), Err(Error::Usage { .. })));
        assert!(matches!(map_file(&folder.path().join("none")), Err(Error::Io { .. })));
    }
}
