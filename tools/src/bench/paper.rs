//! `spgs bench paper`: frame rates by the paper's protocol and by an honest one beside the paper's own, the roofline of
//! this device, and how the cost grows with Gaussians, superpoints and pixels.

mod protocol;
mod report;
mod roofline;
mod scaling;

use std::time::{Duration, Instant};

use engine::error::Result;
use engine::gpu::Gpu;
use engine::render::RenderOptions;
use engine::scene::{Camera, Scene};
use serde_json::{Value, json};

use self::protocol::Stop;
pub(super) use self::report::{Found, reduction, section};
use super::scene::{self, DEFAULT_SIZE};
use crate::cli::args::{Global, PaperArgs};
use crate::cli::{camera, gpu_session, model, output};
use crate::report::benchmark::Benchmark;
use crate::report::measure::{self, Plan};
use crate::report::{processor, provenance};

/// Views of the path around a scene that comes without cameras.
const ORBIT: usize = 20;

/// What is measured.
pub(super) struct Subject<'a> {
    pub(super) scene: &'a Scene,
    pub(super) name: String,
    /// The views and their times, and what they are in words.
    pub(super) path: Vec<Stop>,
    pub(super) path_name: String,
    pub(super) options: RenderOptions,
    /// The view of the paper's protocol.
    pub(super) view: usize,
    /// Frames of the kernel profile, at most, and frames before it.
    pub(super) frames: u32,
    pub(super) warmup: u32,
    /// Time that it may take, roughly.
    pub(super) budget: Duration,
    /// Whether to measure how the cost grows.
    pub(super) curves: bool,
}

/// Measures both protocols, the roofline and the curves: numbers for a record, and all that was found.
///
/// # Errors
/// Those of rendering.
pub(super) fn measure(gpu: &Gpu, s: &Subject<'_>) -> Result<(Value, Found)> {
    let (path, budget, start) = (&s.path, s.budget, Instant::now());
    let rates = protocol::measure(gpu, s.scene, &s.options, path, s.view.min(path.len() - 1), budget / 3)?;
    let plan = Plan {
        camera: path[0].0.clone(),
        times: s.scene.time_range(),
        frames: s.frames.min(protocol::affordable(rates.path.p50, budget / 12)),
        warmup: s.warmup,
        paper_protocol: false,
    };
    let measured = measure::measure(gpu, s.scene, &s.options, &plan, &|| {})?;
    let last = plan.time(plan.frames.saturating_sub(1), plan.frames);
    let pairs = roofline::pairs(s.scene, &plan.camera, last, &s.options)?;
    let roofline = roofline::roofline(gpu, &measured, pairs)?;
    let left = budget.saturating_sub(start.elapsed());
    let curves = if s.curves { scaling::curves(gpu, left)? } else { Vec::new() };
    let found = Found { rates, measured, roofline, curves, benchmark: benchmark(&path[0].0) };
    let (width, height) = (path[0].0.width, path[0].0.height);
    let numbers = json!({
        "processor": processor(),
        "clocks": "host: monotonic clock around submission and completion; device: timestamps between operations",
        "budget_s": budget.as_secs_f64(),
        "scene": provenance::scene(&s.name, s.scene),
        "path": { "name": s.path_name, "views": path.len(), "width": width, "height": height },
        "rates": found.rates,
        "measurement": found.measured,
        "roofline": found.roofline,
        "scaling": found.curves,
        "quality": s.options.quality,
    });
    Ok((numbers, found))
}

/// Measures and reports.
///
/// # Errors
/// Those of loading and rendering; a file that cannot be written.
pub fn run(args: &PaperArgs, global: &Global) -> Result<()> {
    let (scene, name) = scene::load(&args.scene, args.look.motion.is_some())?;
    let (path, path_name) = path(args, &scene)?;
    let gpu = gpu_session::open(global)?;
    let options = RenderOptions {
        background: args.look.background,
        motion: args.look.motion_source(),
        quality: args.quality.chosen().for_scene(&scene),
        ..RenderOptions::default()
    };
    let subject = Subject {
        scene: &scene,
        name,
        path,
        path_name,
        options,
        view: args.frame,
        frames: args.frames,
        warmup: args.warmup,
        budget: Duration::from_secs_f64(args.budget),
        curves: args.budget > 0.0,
    };
    let (numbers, found) = measure(&gpu, &subject)?;
    gpu_session::report_validation(&gpu);
    let record = provenance::record(Some("paper"), &gpu, numbers);
    args.results.write(&record, || report::html(&record, &found))?;
    if !global.quiet {
        let (path, camera) = (&subject.path, &subject.path[0].0);
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("scene   {}: {}", subject.name, model::describe(&scene)));
        output::line(&format!(
            "path    {} views of {}x{} pixels: {}",
            path.len(),
            camera.width,
            camera.height,
            subject.path_name
        ));
        output::line(report::text(&found)?.trim_end());
    }
    Ok(())
}

/// The whole test path with its times: that of `--cameras`, or around the scene and over its time.
fn path(args: &PaperArgs, scene: &Scene) -> Result<(Vec<Stop>, String)> {
    let timed = |c: Camera| (c.clone(), args.path.time.unwrap_or(c.time));
    if let Some(file) = &args.path.cameras {
        let set = model::load_cameras(file, args.path.split.as_deref(), args.size.asked())?;
        model::camera(&set, args.frame)?;
        return Ok((set.cameras.iter().cloned().map(timed).collect(), set.source.clone()));
    }
    let (stops, name) = orbit(scene, args.size.or_square(DEFAULT_SIZE));
    Ok((stops.into_iter().map(|(camera, _)| timed(camera)).collect(), name))
}

/// Around a scene that comes without cameras.
pub(super) fn orbit(scene: &Scene, size: [u32; 2]) -> (Vec<Stop>, String) {
    let stops = camera::orbit(scene, size, ORBIT).into_iter().map(|c| (c.clone(), c.time));
    (stops.collect(), "around the scene, once, over its whole time".into())
}

/// The data set of the paper whose pictures have this size; D-NeRF where none has.
fn benchmark(camera: &Camera) -> Benchmark {
    match [camera.width, camera.height] {
        [536, 960] | [960, 536] => Benchmark::HyperNerf,
        [480, 270] => Benchmark::NerfDs,
        _ => Benchmark::DNerf,
    }
}

/// The processor, which is the device where the device is a CPU, and its clock now, MHz.
fn processor() -> Value {
    let (name, mhz_now) = processor::processor();
    let cores = std::thread::available_parallelism().map_or(0, std::num::NonZero::get);
    json!({ "name": name, "mhz_now": mhz_now, "threads": cores })
}
