//! The subcommands of `spgs`, one file or folder each; `spgs bench` has a folder of its own, [`mod@crate::bench`], and the window
//! of `spgs view` too.

pub mod compare;
pub mod convert;
pub mod demo;
pub mod devices;
pub mod distill;
pub mod edit;
pub mod eval;
pub mod help;
pub mod inspect;
pub mod pose;
pub mod render;
pub mod train;
pub mod view;

use std::process::ExitCode;

use engine::error::{Error, Result};
use engine::gpu::GpuOptions;

use crate::bench;
use crate::cli::args::{Cli, Command};

/// Does what the command line says, on another device when the first one fails its self-test.
///
/// Some tests of a device are run when a scene first needs what they are about. A device that fails then is known and not
/// taken again, so the command begins anew on the next one. Training does not: it may have gone on for hours.
///
/// # Errors
/// Those of the subcommand.
pub fn run_on_proven_device(mut cli: Cli) -> Result<ExitCode> {
    let named = cli.global.device.is_some() || GpuOptions::default().device.is_some();
    let once = named || matches!(cli.command, Command::Train(_) | Command::Help(_));
    let mut others = if once { 0 } else { engine::gpu::devices().map_or(0, |d| d.len()) };
    loop {
        match run(&cli) {
            Err(error @ Error::SelfTest { .. }) if others > 1 => {
                log::warn!("{error}; trying another device");
                others -= 1;
                cli.global.self_test = false;
            }
            done => return done,
        }
    }
}

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
        Command::Edit(args) => edit::run(args, global),
        Command::Distill(args) => distill::run(args, global),
        Command::Pose(args) => pose::run(args, global),
        Command::Inspect(args) => inspect::run(args),
        Command::Devices(args) => devices::run(args, global),
        Command::Help(args) => help::run(args),
    };
    done.map(|()| ExitCode::SUCCESS)
}
