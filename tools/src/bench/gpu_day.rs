//! `spgs bench gpu-day`: everything that a machine with a GPU is borrowed for, in one command of at most eight minutes: whether the
//! kernels are right there, how fast frames, steps, sorts and a training run are, and how far that is from what was predicted.
//!
//! Each step has a part of the time that is left, opens the device anew and writes its own file as soon as it has ended. A step that
//! fails or has no data does not stop the others.

mod clock;
mod frames;
mod outcome;
mod paper;
mod report;
mod self_tests;
mod sorts;
mod training;
mod training_steps;

use std::process::ExitCode;

use engine::error::{Error, Result};
use serde_json::{Value, json};

use self::clock::{Clock, Context};
use self::outcome::{Done, Finished, State};
use crate::cli::args::{Global, GpuDayArgs};
use crate::cli::{gpu_session, output, progress};
use crate::report::files::{create_folder, to_json, write_text};
use crate::report::provenance;

/// A step.
struct Step {
    /// Stem of its file.
    name: &'static str,
    title: &'static str,
    /// Its part of the time, in relation to the others'.
    weight: f64,
    run: fn(&Context<'_>) -> Result<Done>,
}

/// All of them, what matters most first: the last ones go without when the time is short.
const STEPS: [Step; 8] = [
    Step { name: "self_test", title: "kernels against their CPU twins", weight: 0.08, run: self_tests::run },
    Step { name: "synthetic_frame", title: "frame, synthetic scene", weight: 0.08, run: frames::synthetic },
    Step { name: "synthetic_train", title: "step, synthetic scene", weight: 0.08, run: training_steps::synthetic },
    Step { name: "bench_s50k_frame", title: "frame, bench_s50k", weight: 0.05, run: frames::bench_s50k },
    Step { name: "bench_s50k_train", title: "step, bench_s50k", weight: 0.05, run: training_steps::bench_s50k },
    Step { name: "sort", title: "radix sort", weight: 0.06, run: sorts::run },
    Step { name: "dnerf_lego", title: "training, dnerf_lego", weight: 0.4, run: training::run },
    Step { name: "paper", title: "the paper's protocol", weight: 0.2, run: paper::run },
];

/// Runs all steps and writes their files, a summary and a page.
///
/// # Errors
/// No device; a folder that cannot be written. A step that fails is in the summary and in the exit code.
pub fn run(args: &GpuDayArgs, global: &Global) -> Result<ExitCode> {
    if let Some(data) = args.data.as_deref().filter(|d| !d.is_dir()) {
        return Err(Error::usage("--data", format!("{}, which is no folder", data.display()), "a folder of data sets"));
    }
    let steps = chosen(&args.only)?;
    let gpu = gpu_session::open_untested(global)?;
    create_folder(&args.out)?;
    let (device, begin) = (gpu_session::describe(&gpu), provenance::record(Some("gpu_day"), &gpu, json!({})));
    drop(gpu);
    let clock = Clock::start(args.budget);
    let mut finished = Vec::with_capacity(steps.len());
    for (i, step) in steps.iter().enumerate() {
        let weights: f64 = steps[i..].iter().map(|s| s.weight).sum();
        let share = clock.share(step.weight / weights);
        let title = format!("{}/{} {}", i + 1, steps.len(), step.title);
        let bar = progress::budget(&title, share, global.quiet);
        let context = Context { global, data: args.data.as_deref(), clock: clock.part(share), bar };
        let done = if share.as_secs_f64() < clock::LEAST_S {
            Ok(Done::Skipped("no time is left of --budget".into()))
        } else {
            (step.run)(&context)
        };
        context.bar.finish_and_clear();
        let step = Finished::new((step.name, step.title), share, context.clock.elapsed(), done);
        step.write(&args.out)?;
        if !global.quiet {
            output::line(&step.line());
        }
        finished.push(step);
    }
    let failure = finished.iter().find_map(|f| match &f.state {
        State::Failed(error) => Some(error.exit_code()),
        _ => None,
    });
    let record = summary(begin, args.budget, clock.elapsed().as_secs_f64(), &finished);
    write_text(&args.out.join("gpu_day.json"), &(to_json(&record)? + "\n"))?;
    if !global.quiet {
        output::line(&report::text(&device, &finished));
    }
    report::loud(&finished);
    let page = args.out.join("index.html");
    write_text(&page, &report::html(&record, finished)?)?;
    if !global.quiet {
        output::line(&format!("written {} and a JSON file for each step beside it", page.display()));
    }
    Ok(failure.map_or(ExitCode::SUCCESS, ExitCode::from))
}

/// The steps of these names, in their own order; all where none is named.
fn chosen(only: &[String]) -> Result<Vec<&'static Step>> {
    if let Some(unknown) = only.iter().find(|name| STEPS.iter().all(|s| s.name != name.as_str())) {
        let names = STEPS.map(|s| s.name).join(", ");
        return Err(Error::usage("--only", unknown.clone(), format!("some of {names}")));
    }
    Ok(STEPS.iter().filter(|s| only.is_empty() || only.iter().any(|name| name == s.name)).collect())
}

fn summary(mut record: Value, budget_s: f64, seconds: f64, steps: &[Finished]) -> Value {
    let count = |name: &str| steps.iter().filter(|s| s.state.name() == name).count();
    record["budget_s"] = json!(budget_s);
    record["seconds"] = json!(seconds);
    record["failed"] = json!(count("failed"));
    record["skipped"] = json!(count("skipped"));
    record["steps"] = steps.iter().map(Finished::summary).collect();
    record
}
