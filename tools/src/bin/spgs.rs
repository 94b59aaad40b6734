//! `spgs`: renders and measures dynamic 3D Gaussian scenes.

use std::process::ExitCode;

use engine::error::Result;
use tools::args::{Cli, Command};
use tools::{bench, compare, demo, devices, eval, inspect, output, render, train};

fn main() -> ExitCode {
    match output::parse::<Cli>("spgs") {
        Ok(cli) => output::run_main("spgs", move || run(&cli).map(|()| ExitCode::SUCCESS)),
        Err(code) => code,
    }
}

fn run(cli: &Cli) -> Result<()> {
    match &cli.command {
        Command::Demo(args) => demo::run(args, &cli.global),
        Command::Train(args) => train::run(args, &cli.global),
        Command::Render(args) => render::run(args, &cli.global),
        Command::Bench(args) => bench::run(args, &cli.global),
        Command::Compare(args) => compare::run(args, &cli.global),
        Command::Eval(args) => eval::run(args, &cli.global),
        Command::Inspect(args) => inspect::run(args),
        Command::Devices(args) => devices::run(args),
    }
}
