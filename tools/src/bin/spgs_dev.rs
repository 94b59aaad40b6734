//! `spgs-dev`: the project's own tasks.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use engine::error::{Error, Result};
use engine::gpu::{Gpu, GpuOptions};
use tools::cli::output;
use tools::dev::oracle::check;
use tools::dev::{isa, kernel_docs, measurements, mutants, pictures, plan, spirv};

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
        /// (either way: fail when a barrier or subgroup operation sits in flow that is not uniform)
        #[arg(long)]
        check: bool,
    },
    /// Print the barrier plan of every kind of frame
    Plan {
        /// Fail when one is not that in tests/golden
        #[arg(long)]
        check: bool,
        /// Replace those in tests/golden
        #[arg(long, conflicts_with = "check")]
        write: bool,
    },
    /// Compare the f64 reference and the GPU with images of an independent float64 implementation
    OracleCheck {
        /// NumPy archives: image files and superpoint files
        #[arg(required = true, value_name = "FILE.npz")]
        files: Vec<PathBuf>,
        /// One JSON object per file and line
        #[arg(long)]
        json: bool,
    },
    /// What compilers of GPUs make of every kernel: registers, spills, subgroups in flight, estimated cycles
    Isa(isa::task::Options),
    /// Plant faults in the kernels and count how many the tests see
    Mutants(mutants::task::Options),
    /// Print the kernels as a table, from their declarations
    Docs,
    /// Render the images of the README from the built-in scene: an animation, a still, the f64 reference, the error
    Pictures,
    /// Write the manual's table of recorded measurements (tools/docs/measured.md) from tests/measurements/*.json
    Measurements {
        /// Change nothing; fail when the table is out of date
        #[arg(long)]
        check: bool,
        /// Print the commands that record everything for files that begin with DEVICE_, one per line
        #[arg(long, value_name = "DEVICE", conflicts_with = "check")]
        commands: Option<String>,
    },
}

fn main() -> ExitCode {
    match output::parse::<Cli>("spgs-dev", |_, _| None) {
        Ok(cli) => output::run_main("spgs-dev", move || run(&cli)),
        Err(code) => code,
    }
}

fn run(cli: &Cli) -> Result<ExitCode> {
    match &cli.task {
        Task::Spirv { check } => spirv(cli, *check),
        Task::Plan { check, write } => plan(cli, *check, *write),
        Task::OracleCheck { files, json } => oracle_check(files, *json),
        Task::Isa(options) => Ok(status(isa::task::run(&cli.root, options)?)),
        Task::Mutants(options) => Ok(status(mutants::task::run(&cli.root, options)?)),
        Task::Docs => {
            output::line(kernel_docs::table().trim_end());
            Ok(ExitCode::SUCCESS)
        }
        Task::Pictures => {
            pictures::write(&Gpu::open(&GpuOptions::default())?, &cli.root)?.iter().for_each(|l| output::line(l));
            Ok(ExitCode::SUCCESS)
        }
        Task::Measurements { commands: Some(device), .. } => {
            measurements::commands(device).iter().for_each(|c| output::line(c));
            Ok(ExitCode::SUCCESS)
        }
        Task::Measurements { check: true, .. } => {
            let (old, new) = measurements::updated(&cli.root)?;
            output::line(if old == new {
                "tools/docs/measured.md is up to date"
            } else {
                "tools/docs/measured.md is out of date"
            });
            Ok(status(old == new))
        }
        Task::Measurements { .. } => {
            let changed = measurements::write(&cli.root)?;
            output::line(if changed {
                "tools/docs/measured.md written"
            } else {
                "tools/docs/measured.md was up to date"
            });
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn spirv(cli: &Cli, check: bool) -> Result<ExitCode> {
    let outcome = if check { spirv::check(&cli.root)? } else { spirv::write(&cli.root)? };
    for line in &outcome.lines {
        output::line(line);
    }
    let verdict = if outcome.stale { "stale" } else { "fresh" };
    let uneven = spirv::check_flow(&cli.root)?;
    for line in &uneven {
        output::line(line);
    }
    let flow = if uneven.is_empty() { "uniform flow" } else { "flow that is not uniform" };
    output::line(&format!("spirv_cache: {} kernels, {verdict}, {flow}", outcome.kernels));
    Ok(status(!outcome.stale && uneven.is_empty()))
}

fn plan(cli: &Cli, check: bool, write: bool) -> Result<ExitCode> {
    let mut same = true;
    for plan in plan::plans(&Gpu::open(&GpuOptions::default())?)? {
        output::line(&format!("== {}: {} dispatches, {} barriers", plan.name, plan.dispatches, plan.barriers));
        output::line(&plan.text);
        if write {
            plan::write(&cli.root, &plan)?;
        }
        if check && let Some(text) = plan::difference(&cli.root, &plan)? {
            output::error_line(&format!("spgs-dev: {text}"));
            same = false;
        }
    }
    Ok(status(same))
}

fn oracle_check(files: &[PathBuf], json: bool) -> Result<ExitCode> {
    let gpu = Gpu::open(&GpuOptions::default())?;
    let (mut checked, mut passed) = (0, true);
    for file in files {
        let Some(check) = check::check(&gpu, file)? else {
            log::warn!(
                "{}: holds neither an image with its Gaussians nor superpoints nor an image loss; skipped",
                file.display()
            );
            continue;
        };
        checked += 1;
        passed &= check.passes();
        if json {
            let line = serde_json::to_string(&check)
                .map_err(|e| Error::usage("JSON output", e.to_string(), "serialisable values"))?;
            output::line(&line);
        } else {
            output::line(&check.describe());
        }
    }
    Ok(status(passed && checked > 0))
}

fn status(ok: bool) -> ExitCode {
    ExitCode::from(u8::from(!ok))
}
