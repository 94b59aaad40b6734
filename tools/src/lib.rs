//! Shared parts of the command-line programs.

pub mod oracle;
