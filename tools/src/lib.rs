//! Parts of the command-line programs `spgs` and `spgs-dev`.
//!
//! Folders, lowest first. Each imports only from those below it, and no files import each other in a circle;
//! `tests/tests/layers` fails where one does:
//!
//! 0. [`manual`]: the pages that `spgs help TOPIC` prints
//! 1. [`report`]: what was measured, as text, JSON, tables, plots and pages; the paper's figures beside it
//! 2. [`cli`]: arguments, terminal, progress, interrupts, and opening what the command line names
//! 3. [`mod@bench`]: everything of `spgs bench`; [`viewer`]: the window of `spgs view`
//! 4. [`command`]: the subcommands of `spgs`, one file or folder each; [`dev`]: everything of `spgs-dev`

pub mod bench;
pub mod cli;
pub mod command;
pub mod dev;
pub mod manual;
pub mod report;
pub mod viewer;
