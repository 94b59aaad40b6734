//! `spgs bench paper`: frame rates by the paper's protocol and by an honest one beside the paper's own, the roofline of
//! this device, and how the cost grows with Gaussians, superpoints and pixels.

mod protocol;
mod report;
mod roofline;
mod scaling;

use std::time::{Duration, Instant};

use engine::error::Result;
use engine::render::RenderOptions;
use engine::scene::{Camera, Scene};
use serde_json::{Value, json};

use self::protocol::Stop;
use super::scene::{self, DEFAULT_SIZE};
use crate::cli::args::{Global, PaperArgs};
use crate::cli::{camera, gpu_session, model, output};
use crate::report::benchmark::Benchmark;
use crate::report::measure::{self, Plan};
use crate::report::{processor, provenance};

/// Views of the path around a scene that comes without cameras.
const ORBIT: usize = 20;

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
    let budget = Duration::from_secs_f64(args.budget);
    let start = Instant::now();
    let rates = protocol::measure(&gpu, &scene, &options, &path, args.frame.min(path.len() - 1), budget / 3)?;
    let plan = Plan {
        camera: path[0].0.clone(),
        times: scene.time_range(),
        frames: args.frames.min(protocol::affordable(rates.path.p50, budget / 12)),
        warmup: args.warmup,
        paper_protocol: false,
    };
    let measured = measure::measure(&gpu, &scene, &options, &plan, &|| {})?;
    let last = plan.time(plan.frames.saturating_sub(1), plan.frames);
    let pairs = roofline::pairs(&scene, &plan.camera, last, &options)?;
    let roofline = roofline::roofline(&gpu, &measured, pairs)?;
    let curves =
        if args.budget == 0.0 { Vec::new() } else { scaling::curves(&gpu, budget.saturating_sub(start.elapsed()))? };
    gpu_session::report_validation(&gpu);
    let found = report::Found { rates, measured, roofline, curves, benchmark: benchmark(&path[0].0) };
    let (width, height) = (path[0].0.width, path[0].0.height);
    let numbers = json!({
        "processor": processor(),
        "clocks": "host: monotonic clock around submission and completion; device: timestamps between operations",
        "budget_s": budget.as_secs_f64(),
        "scene": provenance::scene(&name, &scene),
        "path": { "name": path_name, "views": path.len(), "width": width, "height": height },
        "rates": found.rates,
        "measurement": found.measured,
        "roofline": found.roofline,
        "scaling": found.curves,
        "quality": options.quality,
    });
    let record = provenance::record(Some("paper"), &gpu, numbers);
    args.results.write(&record, || report::html(&record, &found))?;
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("scene   {name}: {}", model::describe(&scene)));
        output::line(&format!("path    {} views of {width}x{height} pixels: {path_name}", path.len()));
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
    let stops = camera::orbit(scene, args.size.or_square(DEFAULT_SIZE), ORBIT).into_iter().map(timed);
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
