//! Where the program keeps what it can make again.

use std::path::PathBuf;

/// The folder for compiled pipelines and the like, where the system keeps caches: `$XDG_CACHE_HOME/spgs` or `~/.cache/spgs`,
/// `%LOCALAPPDATA%\spgs\cache`, `~/Library/Caches/spgs`. It need not exist. `None`: the user has no home.
pub fn cache_folder() -> Option<PathBuf> {
    directories::ProjectDirs::from("", "", "spgs").map(|project| project.cache_dir().to_owned())
}
