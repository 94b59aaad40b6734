//! `spgs view`: the window is in [`crate::viewer`].

use engine::error::Result;

use crate::cli::args::{Global, ViewerArgs};
use crate::viewer;

/// Opens the window and runs until it is closed.
///
/// # Errors
/// `Usage` without a graphical session; those of reading and drawing.
pub fn run(args: &ViewerArgs, global: &Global) -> Result<()> {
    viewer::run(args, global)
}
