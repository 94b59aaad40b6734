//! Training steps: of the synthetic scene that the goal is stated for, and of the scene that other programs were measured on.

use std::time::Instant;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::train::trainer::Trainer;

use super::clock::{Context, affordable};
use super::frames::{SYNTHETIC, cost, smaller};
use super::outcome::{Done, Measured, Outcome, figures};
use crate::bench::prediction::{self, Kind};
use crate::bench::train::{self, Case, Plan};
use crate::report::page::Page;
use crate::report::provenance;

/// Most steps that are measured, with timestamps and then without.
const STEPS: u32 = 200;
const PASSES: f64 = 2.0;
/// Steps before.
const WARMUP: u32 = 3;
/// Of a slow device's time, what one step of the chosen size may take.
const SHARE_OF_ONE: f64 = 0.04;

/// The synthetic scene of the goal.
pub(super) fn synthetic(context: &Context<'_>) -> Result<Done> {
    let gpu = context.open()?;
    let case = |[n, m, side]: [u32; 3]| train::synthetic(&gpu, m, [0.0; 3], n, [side, side]);
    let left = context.clock.left().mul_f64(SHARE_OF_ONE);
    let size = affordable(&gpu, left, &SYNTHETIC, cost, |size| {
        let case = case(size)?;
        Trainer::new(&gpu, &case.config, &case.data, &case.first)?.step().map(|_| context.tick())
    })?;
    measure(context, &gpu, &case(size)?, smaller(size).into_iter().collect())
}

/// The scene on which peers were measured.
pub(super) fn bench_s50k(context: &Context<'_>) -> Result<Done> {
    let folder = match context.data_set("bench_s50k") {
        Ok(folder) => folder,
        Err(why) => return Ok(Done::Skipped(why)),
    };
    let case = train::photos_of_model(&folder.join("model.ply"), None, &folder, [0.0; 3])?;
    let gpu = context.open()?;
    measure(context, &gpu, &case, Vec::new())
}

fn measure(context: &Context<'_>, gpu: &Gpu, case: &Case, mut reduced: Vec<String>) -> Result<Done> {
    let steps = steps_within(context, gpu, case)?;
    if steps < STEPS {
        reduced.push(format!("{steps} steps of {STEPS}, to stay within the time"));
    }
    let plan = Plan { steps, warmup: WARMUP.min(steps / 2) };
    let (mut numbers, measured) =
        train::measure_case(gpu, case, plan, engine::render::copy_rate::copy_rate(gpu)?, &|| context.tick())?;
    let figures = figures(
        measured.predicted.as_ref(),
        Kind::Step,
        &gpu.info().name,
        Measured {
            device_ms: measured.device_ms.map(|d| d.median),
            one_at_a_time_ms: measured.step_ms.median,
            per_second: measured.steps_per_second,
        },
    );
    let record = provenance::record(None, gpu, numbers.take());
    let device = gpu.info().name.clone();
    let section = Box::new(move |page: &mut Page| {
        if let Some(p) = &measured.predicted {
            prediction::report::summary(page, p);
            page.table(&prediction::report::beside(p, &device, &measured.kernels));
        }
        Ok(())
    });
    Ok(Done::Ran(Box::new(Outcome { record, figures, reduced, failure: None, section })))
}

/// So many that both passes fit into half of what is left.
fn steps_within(context: &Context<'_>, gpu: &Gpu, case: &Case) -> Result<u32> {
    let mut trainer = Trainer::new(gpu, &case.config, &case.data, &case.first)?;
    trainer.step()?;
    trainer.step()?;
    let start = Instant::now();
    trainer.step()?;
    let each = start.elapsed().as_secs_f64().max(1e-6);
    let fit = 0.5 * context.clock.left().as_secs_f64() / (PASSES * each);
    Ok((fit as u32).saturating_sub(WARMUP).clamp(2, STEPS))
}
