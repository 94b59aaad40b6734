//! Where the files go: looked at before any work, cleared when it fails.

use std::fs;
use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use engine::file::durable;
use serde::Serialize;

/// A file written.
#[derive(Debug, Serialize)]
pub struct Written {
    /// Its name.
    pub file: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// The time that it shows; absent for the whole model.
    pub time: Option<f64>,
}

/// The names of the files. What was newly made goes when this is dropped, unless it is [kept](Self::keep).
#[derive(Debug)]
pub(crate) struct Targets {
    files: Vec<PathBuf>,
    /// Folders and files that were not there before, in the order in which they were made.
    made: Vec<PathBuf>,
}

impl Targets {
    /// Makes the folder of the files where there is none, and looks whether all of them can be written there. All are in one
    /// folder.
    ///
    /// # Errors
    /// [`Error::Usage`] where one cannot.
    pub(crate) fn prepare(files: Vec<PathBuf>) -> Result<Self> {
        let mut targets = Self { files, made: Vec::new() };
        let Some(first) = targets.files.first().cloned() else { return Ok(targets) };
        if let Some(folder) = first.parent() {
            targets.make_folder(folder)?;
        }
        durable::check_target(&first)?;
        targets.files.iter().try_for_each(|file| durable::check_name(file))?;
        Ok(targets)
    }

    pub(crate) fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// To be called before file `index` is written.
    pub(crate) fn begin(&mut self, index: usize) {
        let file = &self.files[index];
        // A file that was there is not removed: it may be the model that was read.
        if fs::symlink_metadata(file).is_err() {
            self.made.push(file.clone());
        }
    }

    /// Everything is written and stays.
    pub(crate) fn keep(mut self) {
        self.made.clear();
    }

    fn make_folder(&mut self, folder: &Path) -> Result<()> {
        let is_missing = |f: &&Path| !f.as_os_str().is_empty() && fs::symlink_metadata(f).is_err();
        let missing: Vec<PathBuf> = folder.ancestors().take_while(is_missing).map(PathBuf::from).collect();
        for folder in missing.into_iter().rev() {
            let refused = |e: std::io::Error| {
                Error::usage(
                    format!("folder of the output, {}", folder.display()),
                    e.to_string(),
                    "one that can be made",
                )
            };
            fs::create_dir(&folder).map_err(refused)?;
            self.made.push(folder);
        }
        if folder.as_os_str().is_empty() || folder.is_dir() {
            return Ok(());
        }
        Err(Error::usage(format!("folder of the output, {}", folder.display()), "something else", "a folder"))
    }
}

impl Drop for Targets {
    fn drop(&mut self) {
        for path in self.made.iter().rev() {
            // A folder in which something else was put meanwhile stays, and a file that was not reached is not there.
            let _ = if path.is_dir() { fs::remove_dir(path) } else { fs::remove_file(path) };
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn what_was_made_goes_and_what_was_there_stays() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("a/b");
        let names = vec![folder.join("0.ply"), folder.join("1.ply")];
        let mut targets = Targets::prepare(names.clone()).unwrap();
        assert!(folder.is_dir());
        targets.begin(0);
        fs::write(&names[0], b"new").unwrap();
        drop(targets);
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);

        fs::create_dir_all(&folder).unwrap();
        fs::write(&names[0], b"old").unwrap();
        let mut targets = Targets::prepare(names.clone()).unwrap();
        for (i, name) in names.iter().enumerate() {
            targets.begin(i);
            fs::write(name, b"new").unwrap();
        }
        drop(targets);
        assert_eq!((names[0].exists(), names[1].exists()), (true, false));

        let mut targets = Targets::prepare(names.clone()).unwrap();
        targets.begin(1);
        fs::write(&names[1], b"new").unwrap();
        targets.keep();
        assert!(names[1].exists());
    }

    #[test]
    fn what_cannot_be_written_is_a_mistake_of_the_command_line() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("file");
        fs::write(&file, b"x").unwrap();
        fs::create_dir(place.path().join("1.ply")).unwrap();
        let error = |names: &[&str]| {
            let names = names.iter().map(|n| place.path().join(n)).collect();
            Targets::prepare(names).unwrap_err()
        };
        for (names, word) in [
            (&["file/b/x.ply"][..], "folder of the output"),
            (&["file/x.ply"], "found something else, expected a folder"),
            (&["0.ply", "1.ply"], "a directory"),
        ] {
            let error = error(names);
            assert!(error.to_string().contains(word) && error.exit_code() == 2, "{error}");
        }
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 2);
    }
}
