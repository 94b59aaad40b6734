//! `spgs`: renders and measures dynamic 3D Gaussian scenes.

use std::process::ExitCode;

use engine::error::Result;
use tools::bench::{frame as bench, hard_cases};
use tools::cli::args::{Cli, Command};
use tools::cli::output;
use tools::command::{compare, convert, demo, devices, eval, inspect, render, train};
use tools::viewer;

fn main() -> ExitCode {
    match output::parse::<Cli>("spgs") {
        Ok(cli) => output::run_main("spgs", move || run(&cli)),
        Err(code) => code,
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
    };
    done.map(|()| ExitCode::SUCCESS)
}
