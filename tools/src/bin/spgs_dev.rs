//! `spgs-dev`: the project's own tasks.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use engine::error::Result;
use tools::{output, spirv_task};

/// The project's own tasks: shaders, barrier plan, checks against the oracle.
#[derive(Parser)]
#[command(name = "spgs-dev", version)]
struct Cli {
    /// Folder of the workspace
    #[arg(long, global = true, default_value = ".", value_name = "DIR")]
    root: PathBuf,
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Compile glsl/ to spirv_cache/ and write its manifest
    Spirv {
        /// Change nothing; fail when spirv_cache/ is not what glsl/ compiles to
        #[arg(long)]
        check: bool,
    },
}

fn main() -> ExitCode {
    match output::parse::<Cli>("spgs-dev") {
        Ok(cli) => output::run_main("spgs-dev", move || run(&cli)),
        Err(code) => code,
    }
}

fn run(cli: &Cli) -> Result<ExitCode> {
    match &cli.task {
        Task::Spirv { check } => {
            let outcome = if *check { spirv_task::check(&cli.root)? } else { spirv_task::write(&cli.root)? };
            for line in &outcome.lines {
                output::line(line);
            }
            let verdict = if outcome.stale { "stale" } else { "fresh" };
            output::line(&format!("spirv_cache: {} kernels, {verdict}", outcome.kernels));
            Ok(ExitCode::from(u8::from(outcome.stale)))
        }
    }
}
