//! Timing of a renderer: frame times, kernel times, bytes moved, the device's copy bandwidth.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use engine::error::{Error, Result};
use engine::gpu::kernel::{Kernel, Workload};
use engine::gpu::{Commands, Gpu, RecordedOperation, RecordedTask, Timing};
use engine::render::copy_rate::copy_rate;
use engine::render::{FrameId, FrameStatistics, MemoryUse, RenderOptions, Renderer};
use engine::scene::{Camera, Scene};
use serde::Serialize;

/// How long a GPU works before it is measured.
const CLOCKS: Duration = Duration::from_millis(300);

/// Frames of the paper's protocol.
pub const PAPER_FRAMES: u32 = 1000;

/// What to measure.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The view.
    pub camera: Camera,
    /// Frame `i` of `n` shows the time `times[0] + (times[1] − times[0])·i/(n−1)`.
    pub times: [f64; 2],
    /// Measured frames.
    pub frames: u32,
    /// Frames before.
    pub warmup: u32,
    /// Whether to run the paper's protocol too.
    pub paper_protocol: bool,
}

impl Plan {
    /// How often [`measure`] calls its `tick`.
    pub fn ticks(&self) -> u64 {
        let pairs = 2 * u64::from(self.frames.div_ceil(2));
        3 * u64::from(self.frames) + pairs + if self.paper_protocol { u64::from(PAPER_FRAMES) } else { 0 }
    }

    /// Time of frame `i` of `n`.
    pub fn time(&self, i: u32, n: u32) -> f64 {
        let weight = f64::from(i) / f64::from(n.max(2) - 1);
        self.times[0] + (self.times[1] - self.times[0]) * weight
    }
}

/// Quantiles of a list of numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Quantiles {
    /// Half are below.
    pub median: f64,
    /// 5 % are below.
    pub p5: f64,
    /// 95 % are below.
    pub p95: f64,
}

impl Quantiles {
    /// Of `values`, by nearest rank; zeros when there are none.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_unstable_by(f64::total_cmp);
        let rank = |q: f64| {
            let index = (q * values.len() as f64).ceil() as usize;
            values.get(index.max(1) - 1).copied().unwrap_or_default()
        };
        Self { median: rank(0.5), p5: rank(0.05), p95: rank(0.95) }
    }
}

/// One operation of the frame.
#[derive(Debug, Clone, Serialize)]
pub struct OperationRow {
    /// Label: the kernel and, where it runs several times, which run.
    pub label: String,
    /// Name of the kernel; none for fills and copies.
    pub kernel: Option<&'static str>,
    /// What the kernel is for.
    pub doc: Option<&'static str>,
    /// Device time, microseconds, median over the frames.
    pub us: f64,
    /// Share of the frame's device time.
    pub share: f64,
    /// Bytes that an ideal implementation moves.
    pub bytes: Option<u64>,
    /// Those bytes over the time, GB/s.
    pub gb_per_s: Option<f64>,
    /// That rate as a share of the device's copy bandwidth.
    pub of_copy_bandwidth: Option<f64>,
}

/// One operation as it was recorded, with its amounts of work.
#[derive(Debug, Clone)]
pub struct Recorded {
    /// What was recorded.
    pub operation: RecordedOperation,
    /// Of the last frame or step, with the numbers in its push constants.
    pub work: Workload,
}

/// The operations of a recording; `work` gives a dispatch's amounts of work by kernel and push constants.
pub(crate) fn recorded(
    commands: Option<&Commands>,
    all: &Workload,
    work: &dyn Fn(&Kernel, &[u8]) -> Workload,
) -> Vec<Recorded> {
    let operations = commands.map(Commands::recorded).unwrap_or_default();
    let with_work = |operation: RecordedOperation| {
        let work = match &operation.task {
            RecordedTask::Dispatch { kernel, push, .. } => work(kernel, push),
            _ => all.clone(),
        };
        Recorded { operation, work }
    };
    operations.into_iter().map(with_work).collect()
}

/// Rate of frames drawn side by side.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Beside {
    /// Frames of one submission.
    pub frames: usize,
    /// All frames, per second.
    pub fps: f64,
}

/// Everything measured.
#[derive(Debug, Clone, Serialize)]
pub struct Measurement {
    /// Measured frames.
    pub frames: u32,
    /// Host time from submission to the finished frame, one frame at a time, milliseconds.
    pub frame_ms: Quantiles,
    /// Device time of a frame (sum over its operations), milliseconds; absent without timestamps.
    pub device_ms: Option<Quantiles>,
    /// Frames per second, one frame at a time (from the median).
    pub fps: f64,
    /// Frames per second with several frames in flight.
    pub fps_pipelined: f64,
    /// Rates of frames drawn side by side, by two and by four; those are left out whose buffers do not fit.
    pub fps_side_by_side: Vec<Beside>,
    /// Frames per second by the paper's protocol: this view, 1000 frames, t from 0 to 1, frames in flight.
    pub fps_paper_protocol: Option<f64>,
    /// Frames in flight.
    pub frames_in_flight: usize,
    /// Operations in order.
    pub operations: Vec<OperationRow>,
    /// Dispatches of a frame.
    pub dispatches: usize,
    /// Barriers of a frame.
    pub barriers: usize,
    /// Best rate of a device-to-device copy, bytes read plus bytes written, GB/s.
    pub copy_gb_per_s: f64,
    /// Amounts of work of the last frame.
    pub workload: BTreeMap<&'static str, u64>,
    /// Counts of the last frame.
    pub statistics: FrameStatistics,
    /// What was recorded for a frame, for predictions.
    #[serde(skip)]
    pub recorded: Vec<Recorded>,
    /// The same of so many frames side by side.
    #[serde(skip)]
    pub recorded_beside: Vec<(usize, Vec<Recorded>)>,
    /// Device memory, bytes.
    pub memory: MemoryUse,
    /// Model and buffers that grow with the Gaussians, per Gaussian.
    pub bytes_per_gaussian: f64,
    /// Buffers that grow with the tile instances, per instance that they hold.
    pub bytes_per_instance: f64,
}

/// Measures `scene` from one view. `tick` is called after each frame.
pub fn measure(gpu: &Gpu, scene: &Scene, options: &RenderOptions, plan: &Plan, tick: &dyn Fn()) -> Result<Measurement> {
    let copy_gb_per_s = copy_rate(gpu)?;
    // Timestamps between operations cost a little, so frame times come from a renderer without them.
    let (operations, device_ms) = {
        let profiled = RenderOptions { profile: true, ..options.clone() };
        let mut renderer = Renderer::new(gpu, scene, &profiled)?;
        profile(gpu, &mut renderer, plan, copy_gb_per_s, tick)?
    };
    let plain = RenderOptions { profile: false, ..options.clone() };
    let mut renderer = Renderer::new(gpu, scene, &plain)?;
    let mut statistics = warm_up(gpu, &mut renderer, plan)?;
    let mut frame_ms = Vec::with_capacity(plan.frames as usize);
    for i in 0..plan.frames {
        let start = Instant::now();
        (_, statistics) = renderer.draw(&plan.camera, plan.time(i, plan.frames))?;
        frame_ms.push(start.elapsed().as_secs_f64() * 1e3);
        tick();
    }
    let fps_pipelined = pipelined_fps(&mut renderer, plan, plan.times, plan.frames, tick)?;
    // Of frames alone: those side by side need more.
    let memory = renderer.memory();
    let two = beside::<2>(&mut renderer, plan, tick)?;
    let four = beside::<4>(&mut renderer, plan, tick)?;
    let fps_paper_protocol = if plan.paper_protocol {
        Some(pipelined_fps(&mut renderer, plan, [0.0, 1.0], PAPER_FRAMES, tick)?)
    } else {
        None
    };
    let frame_ms = Quantiles::of(frame_ms);
    let count = scene.gaussians.len().max(1) as f64;
    let (commands, workload) = (renderer.commands(), renderer.workload(&statistics));
    let record = |commands| recorded(commands, &workload, &|kernel, push| with_push(&workload, kernel, push));
    let of_frame = |(rate, frame): (Beside, FrameId)| (rate, (rate.frames, record(renderer.commands_of(frame).ok())));
    let (fps_side_by_side, recorded_beside) = two.into_iter().chain(four).map(of_frame).unzip();
    Ok(Measurement {
        frames: plan.frames,
        frame_ms,
        device_ms,
        fps: 1e3 / frame_ms.median,
        fps_pipelined,
        fps_side_by_side,
        fps_paper_protocol,
        frames_in_flight: renderer.frames_in_flight(),
        operations,
        dispatches: commands.map_or(0, Commands::dispatches),
        barriers: commands.map_or(0, Commands::barriers),
        copy_gb_per_s,
        recorded_beside,
        recorded: record(commands),
        workload: workload.0,
        statistics,
        memory,
        bytes_per_gaussian: (memory.scene + memory.per_gaussian) as f64 / count,
        bytes_per_instance: memory.per_instance as f64 / memory.instance_capacity.max(1) as f64,
    })
}

/// Lets buffers grow to what the most demanding frame needs, and caches and clocks settle.
fn warm_up(gpu: &Gpu, renderer: &mut Renderer, plan: &Plan) -> Result<FrameStatistics> {
    let mut statistics = renderer.draw(&plan.camera, plan.times[0])?.1;
    for i in 0..plan.warmup {
        statistics = renderer.draw(&plan.camera, plan.time(i, plan.warmup))?.1;
    }
    raise_clocks(gpu, || renderer.draw(&plan.camera, plan.times[0]).map(|_| ()))?;
    Ok(statistics)
}

/// Works for a while, so that a GPU that idled raises its clocks: on an H200 that had waited seconds for the host kernels took three to
/// six times as long. A CPU device does nothing.
pub fn raise_clocks(gpu: &Gpu, mut work: impl FnMut() -> Result<()>) -> Result<()> {
    let start = Instant::now();
    while !gpu.info().is_cpu() && start.elapsed() < CLOCKS {
        work()?;
    }
    Ok(())
}

fn pipelined_fps(renderer: &mut Renderer, plan: &Plan, times: [f64; 2], frames: u32, tick: &dyn Fn()) -> Result<f64> {
    let plan = Plan { times, ..plan.clone() };
    let in_flight = renderer.frames_in_flight();
    let mut pending = std::collections::VecDeque::with_capacity(in_flight);
    let start = Instant::now();
    for i in 0..frames {
        if pending.len() == in_flight
            && let Some((frame, time)) = pending.pop_front()
        {
            complete(renderer, &plan, frame, time, tick)?;
        }
        let time = plan.time(i, frames);
        pending.push_back((renderer.submit(&plan.camera, time)?, time));
    }
    for (frame, time) in pending {
        complete(renderer, &plan, frame, time, tick)?;
    }
    Ok(f64::from(frames) / start.elapsed().as_secs_f64())
}

/// Rate of frames drawn side by side, `K` by a submission, and the last one; `None` where there is no room for their buffers.
fn beside<const K: usize>(renderer: &mut Renderer, plan: &Plan, tick: &dyn Fn()) -> Result<Option<(Beside, FrameId)>> {
    match beside_fps::<K>(renderer, plan, tick) {
        Err(Error::OutOfMemory { .. } | Error::Limit { .. }) => Ok(None),
        found => found.map(|(fps, last)| Some((Beside { frames: K, fps }, last))),
    }
}

fn beside_fps<const K: usize>(renderer: &mut Renderer, plan: &Plan, tick: &dyn Fn()) -> Result<(f64, FrameId)> {
    let groups = (plan.frames as usize).div_ceil(K);
    // The times of the frames that were drawn alone: there is room for them.
    let at = |i: usize| plan.time((i as u32).min(plan.frames.saturating_sub(1)), plan.frames);
    let views = |group: usize| std::array::from_fn(|k| (&plan.camera, at(group * K + k)));
    // The first makes the buffers.
    let mut frames: [FrameId; K] = renderer.submit_beside(views(0))?;
    finish(renderer, &frames, &|| ())?;
    let mut pending = std::collections::VecDeque::new();
    let start = Instant::now();
    for group in 0..groups {
        if pending.len() == renderer.frames_in_flight()
            && let Some(frames) = pending.pop_front()
        {
            finish::<K>(renderer, &frames, tick)?;
        }
        frames = renderer.submit_beside(views(group))?;
        pending.push_back(frames);
    }
    for frames in pending {
        finish(renderer, &frames, tick)?;
    }
    let rate = (groups * K) as f64 / start.elapsed().as_secs_f64();
    Ok((rate, frames[K - 1]))
}

/// Waits for all of them.
fn finish<const K: usize>(renderer: &mut Renderer, frames: &[FrameId; K], tick: &dyn Fn()) -> Result<()> {
    for frame in frames {
        renderer.finish(*frame)?;
        tick();
    }
    Ok(())
}

/// Waits for a frame; one that outgrew its buffers is drawn again.
fn complete(renderer: &mut Renderer, plan: &Plan, frame: FrameId, time: f64, tick: &dyn Fn()) -> Result<()> {
    if renderer.finish(frame)?.is_none() {
        renderer.draw(&plan.camera, time)?;
    }
    tick();
    Ok(())
}

fn profile(
    gpu: &Gpu,
    renderer: &mut Renderer,
    plan: &Plan,
    copy_gb_per_s: f64,
    tick: &dyn Fn(),
) -> Result<(Vec<OperationRow>, Option<Quantiles>)> {
    warm_up(gpu, renderer, plan)?;
    let mut samples: Vec<Vec<f64>> = Vec::new();
    let mut labels: Vec<String> = Vec::new();
    let mut totals = Vec::new();
    let mut statistics = FrameStatistics::default();
    for i in 0..plan.frames {
        let (frame, counted) = renderer.draw(&plan.camera, plan.time(i, plan.frames))?;
        statistics = counted;
        let timings = renderer.timings(frame)?;
        let times: Vec<&Timing> = timings.iter().filter(|t| !t.label.starts_with("host read")).collect();
        samples.resize(times.len(), Vec::new());
        labels = times.iter().map(|t| t.label.clone()).collect();
        samples.iter_mut().zip(&times).for_each(|(s, t)| s.push(t.us));
        totals.push(times.iter().map(|t| t.us).sum::<f64>() / 1e3);
        tick();
    }
    let workload = renderer.workload(&statistics);
    let medians: Vec<f64> = samples.into_iter().map(|s| Quantiles::of(s).median).collect();
    let total: f64 = medians.iter().sum();
    let timed = labels.into_iter().zip(medians).collect();
    let work = |kernel: &Kernel, push: &[u8]| with_push(&workload, kernel, push);
    let rows = operation_rows(timed, renderer.commands(), copy_gb_per_s, &work, &|label, _| label.to_owned());
    Ok((rows, (!totals.is_empty() && total > 0.0).then(|| Quantiles::of(totals))))
}

/// Operations of one name, added up.
struct Group {
    name: String,
    kernel: Option<&'static Kernel>,
    count: usize,
    us: f64,
    bytes: u64,
}

/// Rows of a table from the labels and times of all operations, in order. `work` gives the amounts of work of a dispatch (by
/// kernel and push constants), `name` what a row is called: operations of one name are added up.
pub(crate) fn operation_rows(
    timed: Vec<(String, f64)>,
    commands: Option<&Commands>,
    copy_gb_per_s: f64,
    work: &dyn Fn(&Kernel, &[u8]) -> Workload,
    name: &dyn Fn(&str, Option<&Kernel>) -> String,
) -> Vec<OperationRow> {
    let dispatches = commands.map(|c| c.kernels().into_iter().zip(c.push_constants())).into_iter().flatten();
    let mut dispatches = dispatches.peekable();
    let total: f64 = timed.iter().map(|(_, us)| us).sum();
    let mut groups: Vec<Group> = Vec::new();
    for (label, us) in timed {
        let dispatch = dispatches.next_if(|((name, _), _)| *name == label);
        let kernel = dispatch.map(|((_, kernel), _)| kernel);
        let bytes = dispatch.map_or(0, |((_, kernel), push)| (kernel.bytes)(&work(kernel, push)));
        let name = name(&label, kernel);
        match groups.iter_mut().find(|g| g.name == name) {
            Some(group) => {
                group.count += 1;
                group.us += us;
                group.bytes += bytes;
            }
            None => groups.push(Group { name, kernel, count: 1, us, bytes }),
        }
    }
    let row = |g: Group| {
        let label = if g.count > 1 { format!("{} ×{}", g.name, g.count) } else { g.name };
        rate_row(g.kernel, label, g.us, total, g.kernel.map(|_| g.bytes), copy_gb_per_s)
    };
    groups.into_iter().map(row).collect()
}

/// Amounts of work with the numbers in a dispatch's push constants.
pub(crate) fn with_push(workload: &Workload, kernel: &Kernel, push: &[u8]) -> Workload {
    let mut work = workload.clone();
    for (name, offset) in kernel.push {
        let at = *offset as usize;
        if let Some(word) = push.get(at..at + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes) {
            work.0.insert(name, word.into());
        }
    }
    let inputs = work.get("inputs") + work.get("inputs_0") + work.get("inputs_1");
    work.0.insert("inputs", inputs);
    work
}

/// A row from a time, the step's or frame's whole time, and the bytes moved.
pub(crate) fn rate_row(
    kernel: Option<&'static Kernel>,
    label: String,
    us: f64,
    total: f64,
    bytes: Option<u64>,
    copy_gb_per_s: f64,
) -> OperationRow {
    let gb_per_s = bytes.filter(|_| us > 0.0).map(|b| b as f64 / us / 1e3);
    OperationRow {
        kernel: kernel.map(|k| k.name),
        doc: kernel.map(|k| k.doc),
        us,
        share: if total > 0.0 { us / total } else { 0.0 },
        bytes,
        gb_per_s,
        of_copy_bandwidth: gb_per_s.filter(|_| copy_gb_per_s > 0.0).map(|r| r / copy_gb_per_s),
        label,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn quantiles_are_nearest_ranks() {
        let q = Quantiles::of((1..=100).rev().map(f64::from).collect());
        assert_eq!(q, Quantiles { median: 50.0, p5: 5.0, p95: 95.0 });
        assert_eq!(Quantiles::of(vec![7.0]), Quantiles { median: 7.0, p5: 7.0, p95: 7.0 });
        assert_eq!(Quantiles::of(Vec::new()), Quantiles::default());
    }

    #[test]
    fn times_sweep_both_ends() {
        let camera = Camera::look_at(glam::DVec3::ZERO, glam::DVec3::Z, glam::DVec3::Y, 1.0, [4, 4]);
        let plan = Plan { camera, times: [1.0, 3.0], frames: 5, warmup: 0, paper_protocol: false };
        let times: Vec<f64> = (0..5).map(|i| plan.time(i, 5)).collect();
        assert_eq!(times, [1.0, 1.5, 2.0, 2.5, 3.0]);
        assert_eq!(plan.time(0, 1), 1.0);
    }
}
