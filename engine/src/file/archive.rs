//! Named files in a folder or in a zip archive, each read whole and within a limit.

use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// Begins a zip archive.
pub(crate) const ZIP: [u8; 4] = *b"PK\x03\x04";

/// A zip archive in memory.
pub(crate) struct Archive<'a> {
    zip: zip::ZipArchive<Cursor<&'a [u8]>>,
    path: &'a Path,
    bytes: &'a [u8],
}

impl<'a> Archive<'a> {
    pub(crate) fn open(bytes: &'a [u8], path: &'a Path) -> Result<Self> {
        let corrupt = |e| Error::corrupt(path, "zip directory", format!("{e}"), "a zip archive");
        Ok(Self { zip: zip::ZipArchive::new(Cursor::new(bytes)).map_err(corrupt)?, path, bytes })
    }

    /// Names of all entries that have a readable one.
    pub(crate) fn names(&self) -> Vec<String> {
        self.zip.file_names().filter_map(|name| name.ok().map(|n| n.into_owned())).collect()
    }

    /// Where the bytes of an entry that is not compressed lie in the file; its checksum is checked.
    pub(crate) fn stored(&mut self, name: &str) -> Result<std::ops::Range<usize>> {
        let path = self.path;
        let at = format!("zip entry `{name}`");
        let entry = self.zip.by_name(name).map_err(|e| unreadable(path, name, e))?;
        if entry.compression() != zip::CompressionMethod::Stored {
            return Err(Error::corrupt(path, at, entry.compression().to_string(), "no compression, as PyTorch writes"));
        }
        let start = entry.data_start().unwrap_or(u64::MAX);
        let end = start.saturating_add(entry.size());
        let (Ok(start), Ok(end)) = (usize::try_from(start), usize::try_from(end)) else {
            return Err(Error::corrupt(path, at, "no place", "one in the file"));
        };
        let Some(content) = self.bytes.get(start..end) else {
            return Err(Error::corrupt(path, at, format!("bytes {start} to {end}"), "a place in the file"));
        };
        let mut crc = flate2::Crc::new();
        crc.update(content);
        // PyTorch can be told to leave checksums out; they are 0 then.
        if entry.crc32() != 0 && crc.sum() != entry.crc32() {
            let expected = format!("{:08x}", entry.crc32());
            return Err(Error::corrupt(path, at, format!("checksum {:08x}", crc.sum()), expected));
        }
        Ok(start..end)
    }

    /// Whether there is such an entry.
    fn has(&self, name: &str) -> bool {
        self.zip.index_for_name(name).is_some()
    }

    /// The content of an entry, at most `limit` bytes.
    pub(crate) fn read(&mut self, name: &str, limit: u64) -> Result<Vec<u8>> {
        let path = self.path;
        let at = format!("zip entry `{name}`");
        let entry = self.zip.by_name(name).map_err(|e| unreadable(path, name, e))?;
        let mut content = Vec::new();
        let read = entry.take(limit.saturating_add(1)).read_to_end(&mut content);
        read.map_err(|e| Error::corrupt(path, at.clone(), e.to_string(), "an undamaged entry"))?;
        if content.len() as u64 > limit {
            return Err(Error::Limit {
                what: format!("{}: {at}, bytes", path.display()),
                need: u128::from(limit) + 1,
                have: limit.into(),
            });
        }
        Ok(content)
    }
}

/// An entry that is not there, or cannot be read.
fn unreadable(path: &Path, name: &str, error: zip::result::ZipError) -> Error {
    match error {
        zip::result::ZipError::FileNotFound => {
            Error::corrupt(path, "zip directory", format!("no entry `{name}`"), "one, which the others need")
        }
        other => Error::corrupt(path, format!("zip entry `{name}`"), other.to_string(), "a readable entry"),
    }
}

/// Where a format of several files keeps them.
pub(crate) enum Files<'a> {
    /// A folder.
    Folder(PathBuf),
    /// A zip archive; the names begin with this.
    Zip(Archive<'a>, String),
}

impl Files<'_> {
    /// Bytes of these files together; of a zip, its size.
    pub(crate) fn total_bytes(&self, names: &[&str]) -> u64 {
        match self {
            Self::Zip(archive, _) => archive.bytes.len() as u64,
            Self::Folder(folder) => {
                names.iter().filter_map(|n| std::fs::metadata(folder.join(n)).ok()).map(|m| m.len()).sum()
            }
        }
    }

    /// Whether there is such a file.
    pub(crate) fn has(&self, name: &str) -> bool {
        match self {
            Self::Zip(archive, prefix) => archive.has(&format!("{prefix}{name}")),
            Self::Folder(folder) => is_inside(name) && folder.join(name).is_file(),
        }
    }

    /// The content of a file, at most `limit` bytes.
    pub(crate) fn read(&mut self, name: &str, limit: u64) -> Result<Vec<u8>> {
        match self {
            Self::Zip(archive, prefix) => archive.read(&format!("{prefix}{name}"), limit),
            Self::Folder(folder) => {
                if !is_inside(name) {
                    return Err(Error::corrupt(
                        folder,
                        "meta.json",
                        format!("file name `{name}`"),
                        "a plain file name",
                    ));
                }
                read_file(&folder.join(name), limit)
            }
        }
    }
}

/// Whether a name in a file is that of another file in its folder, or in a folder within: it may not lead out.
pub(crate) fn is_inside(name: &str) -> bool {
    let normal = |c| matches!(c, std::path::Component::Normal(_));
    !name.is_empty() && !name.ends_with('/') && Path::new(name).components().all(normal)
}

/// Reads a regular file of at most `limit` bytes.
pub(crate) fn read_file(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let size = file.metadata().map_err(|e| Error::io(path, "read the size", e))?.len();
    if size > limit {
        return Err(Error::Limit { what: format!("{}: bytes", path.display()), need: size.into(), have: limit.into() });
    }
    let mut content = Vec::new();
    file.take(limit).read_to_end(&mut content).map_err(|e| Error::io(path, "read", e))?;
    Ok(content)
}
