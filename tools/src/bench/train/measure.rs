//! Times, traffic and memory of training steps.

use std::collections::BTreeMap;
use std::time::Instant;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::gpu::kernel::{Kernel, Workload};
use engine::render::RenderOptions;
use engine::scene::{Gaussians, Scene};
use engine::train::config::Config;
use engine::train::trainer::{Profile, StepReport, Trainer, TrainingData};
use engine::train::usage::TrainingMemory;
use serde::Serialize;

use crate::bench::prediction::{Kind, Predicted, Subtiles, predict};
use crate::report::measure::{OperationRow, Quantiles, operation_rows, raise_clocks, recorded, with_push};
use crate::report::processor::processor_seconds;

/// How much to measure.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plan {
    /// Measured steps.
    pub(crate) steps: u32,
    /// Steps before.
    pub(crate) warmup: u32,
}

/// Everything measured of one training set.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct TrainMeasurement {
    /// Measured steps.
    pub(super) steps: u32,
    /// Host time of a step that is waited for, milliseconds.
    pub(crate) step_ms: Quantiles,
    /// Time per step as a run takes them, several in flight, milliseconds, mean.
    pub(crate) in_flight_ms: f64,
    /// Processor time (user and system, all threads) of a step, milliseconds, mean; absent where the system does not tell.
    pub(super) cpu_ms: Option<f64>,
    /// Device time of a step (sum over its operations), milliseconds; absent without timestamps.
    pub(crate) device_ms: Option<Quantiles>,
    /// Steps per second, several in flight.
    pub(crate) steps_per_second: f64,
    /// One row per kernel or transfer, in order of first use; times of its dispatches added up.
    pub(crate) kernels: Vec<OperationRow>,
    /// Dispatches of a step.
    pub(super) dispatches: usize,
    /// Barriers of a step.
    pub(super) barriers: usize,
    /// Best rate of a device-to-device copy, bytes read plus bytes written, GB/s.
    pub(super) copy_gb_per_s: f64,
    /// Amounts of work of the last step.
    pub(super) workload: BTreeMap<&'static str, u64>,
    /// Times on named GPUs, by the model.
    pub(crate) predicted: Option<Predicted>,
    /// Device memory, bytes.
    pub(super) memory: TrainingMemory,
    /// Moments and gradients in units of the parameters; at most 4 by design.
    pub(super) state_ratio: f64,
    /// The first step.
    pub(super) first_step: StepReport,
    /// The last step.
    pub(super) last_step: StepReport,
}

/// Measures training from `first`. `tick` is called after each step.
pub(super) fn measure(
    gpu: &Gpu,
    config: &Config,
    data: &TrainingData,
    first: &Gaussians,
    plan: Plan,
    copy_gb_per_s: f64,
    tick: &dyn Fn(),
) -> Result<TrainMeasurement> {
    let trainer = || Trainer::new(gpu, config, data, first);
    // Timestamps between operations cost a little, so step times come from a run without them.
    let (kernels, device_ms) = profile(gpu, trainer()?.with_profile(Profile::All), plan, copy_gb_per_s, tick)?;
    let mut trainer = trainer()?;
    let first_step = warm_up(gpu, &mut trainer, plan, tick)?;
    let (mut step_ms, mut last_step) = (Vec::with_capacity(plan.steps as usize), first_step);
    let busy = processor_seconds();
    for _ in 0..plan.steps {
        let start = Instant::now();
        last_step = trainer.step()?;
        step_ms.push(start.elapsed().as_secs_f64() * 1e3);
        tick();
    }
    let per_step = |since: f64| processor_seconds().map(|now| 1e3 * (now - since) / f64::from(plan.steps));
    let cpu_ms = busy.and_then(per_step);
    let step_ms = Quantiles::of(step_ms);
    let in_flight_ms = in_flight(&mut trainer, plan, tick)?;
    let memory = trainer.memory();
    let (commands, work) = (trainer.commands(), trainer.workload(&last_step));
    let predicted = predicted(&trainer, &last_step, first, data);
    Ok(TrainMeasurement {
        steps: plan.steps,
        step_ms,
        in_flight_ms,
        cpu_ms,
        device_ms,
        steps_per_second: 1e3 / in_flight_ms,
        kernels,
        dispatches: commands.map_or(0, engine::gpu::Commands::dispatches),
        barriers: commands.map_or(0, engine::gpu::Commands::barriers),
        copy_gb_per_s,
        predicted,
        workload: work.0,
        memory,
        state_ratio: memory.state_ratio(),
        first_step,
        last_step,
    })
}

/// The prediction of a trainer's last step. How far splats reach is counted for the first photo's view of `gaussians`, not moved;
/// every subtile counts where the reference rejects what the trainer only leaves out.
pub(crate) fn predicted(
    trainer: &Trainer,
    step: &StepReport,
    gaussians: &Gaussians,
    data: &TrainingData,
) -> Option<Predicted> {
    let work = trainer.workload(step);
    let of_dispatch = |kernel: &Kernel, push: &[u8]| of_dispatch(&work, kernel, push);
    let recorded = recorded(trainer.commands(), &work, &of_dispatch);
    let view = data.views.first()?;
    let still = Scene { gaussians: gaussians.clone(), ..Scene::default() };
    let counted = Subtiles::count(&still, &view.camera, view.time, &RenderOptions::default());
    let counted = counted.inspect_err(|e| log::warn!("prediction without subtiles: {e}")).unwrap_or(Subtiles::ALL);
    predict(Kind::Step, &recorded, counted)
}

/// The first step and those of the warm-up, in which buffers grow and photos are decoded; returns the first.
fn warm_up(gpu: &Gpu, trainer: &mut Trainer, plan: Plan, tick: &dyn Fn()) -> Result<StepReport> {
    let first = trainer.step()?;
    for _ in 0..plan.warmup {
        trainer.step()?;
        tick();
    }
    raise_clocks(gpu, || trainer.step().map(|_| ()))?;
    Ok(first)
}

/// Milliseconds per step, several in flight, from the first submission to the last report.
fn in_flight(trainer: &mut Trainer, plan: Plan, tick: &dyn Fn()) -> Result<f64> {
    let start = Instant::now();
    for _ in 0..plan.steps {
        trainer.advance()?;
        while trainer.take_finished().is_some() {}
        tick();
    }
    trainer.drain()?;
    Ok(start.elapsed().as_secs_f64() * 1e3 / f64::from(plan.steps.max(1)))
}

fn profile(
    gpu: &Gpu,
    mut trainer: Trainer,
    plan: Plan,
    copy_gb_per_s: f64,
    tick: &dyn Fn(),
) -> Result<(Vec<OperationRow>, Option<Quantiles>)> {
    let mut step = warm_up(gpu, &mut trainer, plan, tick)?;
    let (mut samples, mut labels, mut totals): (Vec<Vec<f64>>, Vec<String>, Vec<f64>) = Default::default();
    for _ in 0..plan.steps {
        step = trainer.step()?;
        let mut times = trainer.timings().to_vec();
        times.retain(|t| !t.label.starts_with("host read"));
        samples.resize(times.len(), Vec::new());
        labels = times.iter().map(|t| t.label.clone()).collect();
        samples.iter_mut().zip(&times).for_each(|(s, t)| s.push(t.us));
        totals.push(times.iter().map(|t| t.us).sum::<f64>() / 1e3);
        tick();
    }
    let medians: Vec<f64> = samples.into_iter().map(|s| Quantiles::of(s).median).collect();
    let total: f64 = medians.iter().sum();
    let work = trainer.workload(&step);
    let timed = labels.into_iter().zip(medians).collect();
    let of_dispatch = |kernel: &Kernel, push: &[u8]| of_dispatch(&work, kernel, push);
    let name = |label: &str, kernel: Option<&Kernel>| kernel.map_or(label, |k| k.name).to_owned();
    let rows = operation_rows(timed, trainer.commands(), copy_gb_per_s, &of_dispatch, &name);
    Ok((rows, (!totals.is_empty() && total > 0.0).then(|| Quantiles::of(totals))))
}

/// A dispatch's amount of work: the step's, the numbers in its push constants, and how many keys a sort has.
fn of_dispatch(step: &Workload, kernel: &Kernel, push: &[u8]) -> Workload {
    let mut work = with_push(step, kernel, push);
    // Of a gradient by the networks' outputs: r and τ, or the non-rigid offset.
    work.0.insert("planes", if step.get("nonrigid") > 0 { 10 } else { 6 });
    // Of Gaussians and superpoints, the only keys that a step sorts.
    work.0.insert("keys", work.get("gaussians") * (work.get("neighbors") + 1));
    work
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn a_dispatch_counts_its_push_constants_and_its_keys() {
        let step = Workload([("gaussians", 7), ("neighbors", 3)].into());
        let layer = &engine::render::linear_forward::LINEAR_FORWARD;
        let words: Vec<u8> = (1..=layer.push.len() as u32).flat_map(u32::to_le_bytes).collect();
        let work = of_dispatch(&step, layer, &words);
        assert_eq!((work.get("rows"), work.get("outputs"), work.get("inputs")), (1, 2, 3 + 4));
        assert_eq!((layer.bytes)(&work), 4 * (7 + 2 * 7 + 2));
        assert_eq!(work.get("keys"), 28);
    }
}
