//! `spgs bench --paper`: frame rates by the paper's protocol and by an honest one beside the paper's own, the roofline of
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

use crate::bench::frame::{load_scene, size_of, write_text};
use crate::cli::args::{BenchArgs, Global};
use crate::cli::{camera, gpu_session, model, output};
use crate::report::measure::{self, Plan};
use crate::report::paper::Benchmark;
use crate::report::processor;

/// Seconds for the whole measurement where the arguments do not say.
const BUDGET_S: f64 = 180.0;
/// Views of the path around a scene that comes without cameras.
const ORBIT: usize = 20;
/// Frames of the kernel profile where the arguments do not say, and frames before it.
const PROFILE: [u32; 2] = [20, 3];

/// A view of the path.
type Stop = (Camera, f64);

/// Measures and reports.
///
/// # Errors
/// Those of loading and rendering; a file that cannot be written.
pub fn run(args: &BenchArgs, global: &Global) -> Result<()> {
    let (scene, name) = load_scene(args)?;
    let (path, path_name) = path(args, &scene)?;
    let gpu = gpu_session::open_to_measure(global)?;
    let options = RenderOptions {
        background: args.view.background,
        motion: args.view.motion_source(),
        quality: args.view.quality().for_scene(&scene),
        ..RenderOptions::default()
    };
    let budget = Duration::from_secs_f64(args.budget.unwrap_or(BUDGET_S));
    let start = Instant::now();
    let rates = protocol::measure(&gpu, &scene, &options, &path, args.frame.min(path.len() - 1), budget / 3)?;
    let plan = Plan {
        camera: path[0].0.clone(),
        times: camera::time_range(&scene),
        frames: args.frames.unwrap_or(PROFILE[0]).min(protocol::affordable(rates.path.p50, budget / 12)),
        warmup: args.warmup.unwrap_or(PROFILE[1]),
        paper_protocol: false,
    };
    let measured = measure::measure(&gpu, &scene, &options, &plan, &|| {})?;
    let last = plan.time(plan.frames.saturating_sub(1), plan.frames);
    let pairs = roofline::pairs(&scene, &plan.camera, last, &options)?;
    let roofline = roofline::roofline(&gpu, &measured, pairs)?;
    let curves = if args.budget == Some(0.0) {
        Vec::new()
    } else {
        scaling::curves(&gpu, budget.saturating_sub(start.elapsed()))?
    };
    gpu_session::report_validation(&gpu);
    let found = report::Found { rates, measured, roofline, curves, benchmark: benchmark(&path[0].0) };
    let mut record = record(&gpu, &scene, [&name, &path_name], &path, budget, &found);
    record["quality"] = json!(options.quality);
    if let Some(file) = &args.json {
        write_text(file, &(output::to_json(&record)? + "\n"))?;
    }
    if let Some(file) = &args.report {
        write_text(file, &report::html(&record, &found)?)?;
    }
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("scene   {name}: {}", model::describe(&scene)));
        let size = format!("{}x{} pixels", path[0].0.width, path[0].0.height);
        output::line(&format!("path    {} views of {size}: {path_name}", path.len()));
        output::line(report::text(&found)?.trim_end());
    }
    Ok(())
}

/// The whole test path with its times: that of `--cameras`, or around the scene and over its time.
fn path(args: &BenchArgs, scene: &Scene) -> Result<(Vec<Stop>, String)> {
    let timed = |c: Camera| (c.clone(), args.time.unwrap_or(c.time));
    if let Some(file) = &args.cameras {
        let set = model::load_cameras(file, args.split.as_deref(), [args.view.width, args.view.height])?;
        model::camera(&set, args.frame)?;
        return Ok((set.cameras.iter().cloned().map(timed).collect(), set.source.clone()));
    }
    let stops = camera::orbit(scene, size_of(args), ORBIT).into_iter().map(timed);
    Ok((stops.collect(), "around the scene, once, over its whole time".into()))
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

fn record(
    gpu: &Gpu,
    scene: &Scene,
    [name, path_name]: [&str; 2],
    path: &[Stop],
    budget: Duration,
    found: &report::Found,
) -> Value {
    let camera = &path[0].0;
    json!({
        "kind": "paper",
        "program": { "name": "spgs", "version": env!("CARGO_PKG_VERSION"), "commit": measure::commit() },
        "command": std::env::args().collect::<Vec<_>>().join(" "),
        "device": gpu.info(),
        "processor": processor(),
        "clocks": "host: monotonic clock around submission and completion; device: timestamps between operations",
        "budget_s": budget.as_secs_f64(),
        "scene": {
            "name": name,
            "gaussians": scene.gaussians.len(),
            "sh_degree": scene.gaussians.sh_degree,
            "superpoints": scene.superpoints.as_ref().map_or(0, |s| s.position.len()),
            "key_times": scene.motion.as_ref().map_or(0, |m| m.times.len()),
        },
        "path": { "name": path_name, "views": path.len(), "width": camera.width, "height": camera.height },
        "rates": found.rates,
        "measurement": found.measured,
        "roofline": found.roofline,
        "scaling": found.curves,
    })
}
