//! Durable writes: a reader sees the old file or the new one, whole, whatever happens in between.
//!
//! Temporary file in the same directory → write → fsync(file) → rename → fsync(directory), or, on systems without the
//! last, fsync of the renamed file. Every return code is checked. A failure before the rename leaves the old file untouched and no temporary behind; a failure of the last
//! step (the directory's fsync) leaves the complete new file.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// A point at which the system may refuse. Tests fail each of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Creating the temporary file.
    Create,
    /// One `write` call to the system.
    Write,
    /// Flushing file contents to the device.
    SyncFile,
    /// Putting the temporary in the file's place.
    Rename,
    /// Flushing the directory entry.
    SyncDirectory,
}

impl Step {
    fn action(self) -> &'static str {
        match self {
            Self::Create => "create a temporary file beside it",
            Self::Write => "write",
            Self::SyncFile => "fsync",
            Self::Rename => "rename",
            Self::SyncDirectory => "fsync its directory",
        }
    }
}

/// Size of the write buffer, bytes: large enough that system calls do not show in profiles.
const BUFFER: usize = 1 << 20;

/// Replaces `path` with what `write` produces, durably and all at once.
///
/// # Errors
/// [`Error::Usage`] if `path` is something other than a regular file or has no directory; [`Error::Io`] naming the step
/// that failed.
pub fn write_atomic(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    write_atomic_with(path, write, &mut |_| Ok(()))
}

/// [`write_atomic`] with a fault seam: `before` is called before each [`Step`] and its error is treated as the system's.
///
/// # Errors
/// As [`write_atomic`].
pub fn write_atomic_with(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    before: &mut dyn FnMut(Step) -> io::Result<()>,
) -> Result<()> {
    let target = resolve(path)?;
    let directory = directory_of(&target);
    let failed = |step: Step| move |source: io::Error| Error::io(path, step.action(), source);

    before(Step::Create).map_err(failed(Step::Create))?;
    // Dropping the temporary removes it, so every early return below cleans up.
    let mut temporary = create_beside(&target, directory).map_err(failed(Step::Create))?;
    {
        let seam = Seam { file: temporary.as_file_mut(), before: &mut *before };
        let mut buffered = BufWriter::with_capacity(BUFFER, seam);
        write(&mut buffered).and_then(|()| buffered.flush()).map_err(failed(Step::Write))?;
    }
    before(Step::SyncFile).and_then(|()| temporary.as_file().sync_all()).map_err(failed(Step::SyncFile))?;
    before(Step::Rename).map_err(failed(Step::Rename))?;
    let renamed = temporary.persist(&target).map_err(|e| failed(Step::Rename)(e.error))?;
    before(Step::SyncDirectory).and_then(|()| sync_entry(directory, &renamed)).map_err(failed(Step::SyncDirectory))
}

/// Whether [`write_atomic`] may replace or make `path`, by what is there: nothing or a regular file.
///
/// # Errors
/// [`Error::Usage`], [`Error::Io`].
pub fn check_name(path: &Path) -> Result<()> {
    resolve(path).map(|_| ())
}

/// [`check_name`], and whether a file can be made in its folder: for programs that work long before they write.
///
/// # Errors
/// [`Error::Usage`], [`Error::Io`].
pub fn check_target(path: &Path) -> Result<()> {
    let target = resolve(path)?;
    let folder = directory_of(&target);
    let refused = |e: io::Error| {
        let found = format!("a folder where no file can be made ({e})");
        Error::usage(format!("output {}", path.display()), found, "a folder that can be written")
    };
    create_beside(&target, folder).map(drop).map_err(refused)
}

/// Where a file is.
fn directory_of(target: &Path) -> &Path {
    target.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Follows a symbolic link, so that the link survives; refuses devices, pipes and directories, which a rename would
/// replace.
fn resolve(path: &Path) -> Result<PathBuf> {
    let not_a_file = |found: &str| Error::usage(format!("output {}", path.display()), found, "a regular file name");
    if path.file_name().is_none() {
        return Err(not_a_file("no file name"));
    }
    match fs::metadata(path) {
        Ok(existing) if existing.is_file() => {
            fs::canonicalize(path).map_err(|e| Error::io(path, "resolve the path", e))
        }
        Ok(existing) if existing.is_dir() => Err(not_a_file("a directory")),
        Ok(_) => Err(not_a_file("a device, pipe or socket")),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(path.to_path_buf()),
        Err(e) => Err(Error::io(path, "open", e)),
    }
}

/// A temporary file with the permissions the final file shall have (the old file's, or the usual for new files).
fn create_beside(target: &Path, directory: &Path) -> io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".spgs-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let file = builder.tempfile_in(directory)?;
    if let Ok(existing) = fs::metadata(target) {
        file.as_file().set_permissions(existing.permissions())?;
    }
    Ok(file)
}

#[cfg(unix)]
fn sync_entry(directory: &Path, _renamed: &File) -> io::Result<()> {
    match File::open(directory)?.sync_all() {
        // Some file systems (network, FUSE) have no such operation and say so; there is nothing else to be done there.
        Err(e) if matches!(e.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
        other => other,
    }
}

#[cfg(not(unix))]
fn sync_entry(_directory: &Path, renamed: &File) -> io::Result<()> {
    // Directories cannot be flushed (Windows); flushing a file there takes the journal of the file system along, and so its
    // new name. Its handle is the one that wrote it: flushing needs the right to write.
    renamed.sync_all()
}

/// The file behind the fault seam.
struct Seam<'a> {
    file: &'a mut File,
    before: &'a mut dyn FnMut(Step) -> io::Result<()>,
}

impl Write for Seam<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        (self.before)(Step::Write)?;
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn entries(directory: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(directory).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_failure_at_any_step_leaves_the_old_or_the_new_file_and_no_temporary() {
        // 3 MiB in one go plus a tail: several system writes.
        let new: Vec<u8> = (0..3 * BUFFER + 17).map(|i| i as u8).collect();
        let mut steps = 0;
        for fail_at in 0.. {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("model.bin");
            fs::write(&path, b"old").unwrap();
            let mut failed = None;
            let mut step_index = 0;
            let outcome = write_atomic_with(
                &path,
                |w| new.chunks(BUFFER / 2).try_for_each(|chunk| w.write_all(chunk)),
                &mut |step| {
                    step_index += 1;
                    if step_index - 1 == fail_at {
                        failed = Some(step);
                        return Err(io::Error::from(io::ErrorKind::StorageFull));
                    }
                    Ok(())
                },
            );
            assert_eq!(entries(directory.path()), ["model.bin"], "temporary left when failing at step {fail_at}");
            let content = fs::read(&path).unwrap();
            match failed {
                None => {
                    outcome.unwrap();
                    assert!(content == new);
                    steps = fail_at;
                    break;
                }
                Some(Step::SyncDirectory) => assert!(outcome.is_err() && content == new),
                Some(step) => {
                    let message = outcome.unwrap_err().to_string();
                    assert!(message.contains(step.action()) && message.contains("model.bin"), "{message}");
                    assert_eq!(content, b"old", "old file lost at step {fail_at} ({step:?})");
                }
            }
        }
        assert!(steps >= 7, "only {steps} steps were failed");
    }

    #[test]
    fn a_failing_producer_leaves_nothing_behind() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("new.bin");
        let outcome = write_atomic(&path, |w| {
            w.write_all(b"half")?;
            Err(io::Error::other("producer"))
        });
        assert!(outcome.is_err());
        assert!(entries(directory.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn links_survive_and_devices_are_refused() {
        let directory = tempfile::tempdir().unwrap();
        let (real, link) = (directory.path().join("real"), directory.path().join("link"));
        fs::write(&real, b"old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        write_atomic(&link, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(matches!(write_atomic(Path::new("/dev/null"), |_| Ok(())), Err(Error::Usage { .. })));
        assert!(matches!(write_atomic(directory.path(), |_| Ok(())), Err(Error::Usage { .. })));
        assert!(matches!(write_atomic(&directory.path().join("no/such"), |_| Ok(())), Err(Error::Io { .. })));
    }
}
