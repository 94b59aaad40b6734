//! The subcommands of `spgs`, one file or folder each; `spgs bench` has a folder of its own, [`mod@crate::bench`], and the window
//! of `spgs view` too.

pub mod compare;
pub mod convert;
pub mod demo;
pub mod devices;
pub mod eval;
pub mod inspect;
pub mod render;
pub mod train;
pub mod view;

use std::process::ExitCode;

use engine::error::Result;

use crate::bench;
use crate::cli::args::{Cli, Command};

/// Does what the command line says.
///
/// # Errors
/// Those of the subcommand.
pub fn run(cli: &Cli) -> Result<ExitCode> {
    let global = &cli.global;
    let done = match &cli.command {
        Command::Demo(args) => demo::run(args, global),
        Command::Train(args) => train::run(args, global),
        Command::Render(args) => render::run(args, global),
        Command::View(args) => view::run(args, global),
        Command::Bench(args) => return bench::run(args, global),
        Command::Compare(args) => compare::run(args, global),
        Command::Eval(args) => eval::run(args, global),
        Command::Convert(args) => convert::run(args, global),
        Command::Inspect(args) => inspect::run(args),
        Command::Devices(args) => devices::run(args, global),
    };
    done.map(|()| ExitCode::SUCCESS)
}
