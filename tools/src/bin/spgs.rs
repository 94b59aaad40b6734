//! `spgs`: renders and measures dynamic 3D Gaussian scenes.

use std::process::ExitCode;

use tools::cli::args::Cli;
use tools::cli::{modes, output};
use tools::command;

fn main() -> ExitCode {
    match output::parse::<Cli>("spgs", modes::advice) {
        Ok(cli) => output::run_main("spgs", move || command::run_on_proven_device(cli)),
        Err(code) => code,
    }
}
