//! A training run on `dnerf_lego` by the paper's schedule, as far as the time goes.

use engine::error::Result;
use serde_json::json;

use super::clock::Context;
use super::outcome::{Done, Figure, Measured, Outcome, figures};
use crate::bench::prediction::{self, Kind};
use crate::bench::train;
use crate::bench::train::session::{Session, Until};
use crate::report::page::Page;
use crate::report::provenance;

/// The paper's iterations.
const ITERATIONS: u64 = 40_000;
/// Evaluations on the way, the last one at the end.
const EVALUATIONS: u64 = 4;
/// Of the time, for the evaluation at the end.
const FOR_EVALUATION: f64 = 0.15;
/// Images are averaged down by this on a device that is a CPU.
const CPU_DOWNSCALE: u32 = 8;

/// Trains until the time is up.
pub(super) fn run(context: &Context<'_>) -> Result<Done> {
    let path = match context.data_set("dnerf_lego") {
        Ok(path) => path,
        Err(why) => return Ok(Done::Skipped(why)),
    };
    let gpu = context.open()?;
    let mut reduced = Vec::new();
    let downscale = gpu.info().is_cpu().then_some(CPU_DOWNSCALE);
    if downscale.is_some() {
        reduced.push(format!("images averaged down by {CPU_DOWNSCALE}: the device is a CPU"));
    }
    let session = Session::new(&gpu, &path, downscale)?;
    let config = session.config(ITERATIONS);
    let end = context.clock.end() - context.clock.left().mul_f64(FOR_EVALUATION);
    let until = Until { psnr: None, end: Some(end) };
    let (timed, trainer) = session.run(&config, until, EVALUATIONS, &|| context.tick())?;
    let done = trainer.iteration();
    if done < ITERATIONS {
        reduced.push(format!("{done} of {ITERATIONS} iterations, to stay within the time"));
    }
    let predicted = match &timed.last_step {
        Some(step) => train::predicted(&trainer, step, &trainer.scene()?.gaussians, session.training()),
        None => None,
    };
    let measured =
        Measured { device_ms: None, one_at_a_time_ms: timed.step_ms.median, per_second: timed.iterations_per_second };
    let mut figures = figures(predicted.as_ref(), Kind::Step, &gpu.info().name, measured);
    if let Some(last) = timed.last() {
        figures.push(Figure::new(format!("held-out views after {} iterations", last.iteration), "dB", last.psnr));
    }
    figures.push(Figure::new("training time, without evaluation", "s", timed.seconds));
    let numbers = json!({
        "data": path,
        "views": session.describe(),
        "iterations": config.iterations,
        "iterations_done": done,
        "downscale": downscale,
        "run": timed,
        "predicted": predicted,
    });
    let record = provenance::record(Some("gpu_day_training"), &gpu, numbers);
    let views = session.describe();
    let section = Box::new(move |page: &mut Page| {
        page.text(&format!("{views}. The prediction is of the last step, measured is the median of all."));
        page.table(&train::milestones(&timed));
        if let Some(p) = &predicted {
            prediction::report::summary(page, p);
        }
        Ok(())
    });
    Ok(Done::Ran(Box::new(Outcome { record, figures, reduced, failure: None, section })))
}
