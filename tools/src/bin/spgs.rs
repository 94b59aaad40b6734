//! `spgs`: renders and measures dynamic 3D Gaussian scenes.

use std::process::ExitCode;

use engine::error::{Error, Result};
use engine::gpu::{GpuOptions, devices};
use tools::args::{Cli, Command};
use tools::{bench, compare, convert, demo, devices, eval, hard_cases, help, inspect, output, render, train, viewer};

fn main() -> ExitCode {
    match output::parse::<Cli>("spgs") {
        Ok(cli) => output::run_main("spgs", move || run_on_proven_device(cli)),
        Err(code) => code,
    }
}

/// Some tests of a device are run when a scene first needs what they are about. A device that fails then is known and not
/// taken again, so the command begins anew on the next one. Training does not: it may have gone on for hours.
fn run_on_proven_device(mut cli: Cli) -> Result<ExitCode> {
    let named = cli.global.device.is_some() || GpuOptions::default().device.is_some();
    let mut others = if named || matches!(cli.command, Command::Train(_) | Command::Help(_)) {
        0
    } else {
        devices().map_or(0, |d| d.len())
    };
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

fn run(cli: &Cli) -> Result<ExitCode> {
    let done = match &cli.command {
        Command::Bench(args) if args.hard_cases => return hard_cases::run(args, &cli.global),
        Command::Demo(args) => demo::run(args, &cli.global),
        Command::Train(args) => train::run(args, &cli.global),
        Command::Render(args) => render::run(args, &cli.global),
        Command::View(args) => viewer::run(args, &cli.global),
        Command::Bench(args) => bench::run(args, &cli.global),
        Command::Compare(args) => compare::run(args, &cli.global),
        Command::Eval(args) => eval::run(args, &cli.global),
        Command::Convert(args) => convert::run(args, &cli.global),
        Command::Inspect(args) => inspect::run(args),
        Command::Devices(args) => devices::run(args, &cli.global),
        Command::Help(args) => help::run(args),
    };
    done.map(|()| ExitCode::SUCCESS)
}
