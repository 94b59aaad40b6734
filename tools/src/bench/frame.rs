//! `spgs bench`: frame and kernel times of a model or of a synthetic scene.

use std::path::Path;

use engine::error::{Error, Result};
use engine::file::durable::write_atomic;
use engine::gpu::Gpu;
use engine::image::{Difference, difference};
use engine::reference::{self, ReferenceOptions};
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{moving_scene, random_scene};
use engine::scene::{Camera, Scene};
use serde_json::{Value, json};

use crate::bench::{ablation as bench_ablation, paper as bench_paper, sweep, train};
use crate::cli::args::{BenchArgs, Global};
use crate::cli::{camera, gpu_session, model, output, progress};
use crate::report::measure::{self, Measurement, PAPER_FRAMES, Plan, commit};
use crate::report::summary;

/// Image size where neither arguments nor cameras say one: that of the paper's synthetic scenes.
pub(crate) const DEFAULT_SIZE: u32 = 800;
pub(crate) const SYNTHETIC_SEED: u64 = 1;
pub(crate) const SYNTHETIC_SH_DEGREE: u32 = 3;
/// Key times of the synthetic motion.
pub(crate) const SYNTHETIC_KEYS: usize = 100;

/// Measured frames where the arguments do not say.
const FRAMES: u32 = 100;
/// Frames before the measurement where the arguments do not say.
const WARMUP: u32 = 10;

/// Measures and reports.
pub fn run(args: &BenchArgs, global: &Global) -> Result<()> {
    if args.train {
        return train::run(args, global);
    }
    if args.ablation.is_some() {
        return bench_ablation::run(args, global);
    }
    if args.paper {
        return bench_paper::run(args, global);
    }
    if args.sweep {
        return sweep::run(args, global);
    }
    let (scene, name) = load_scene(args)?;
    let camera = choose_camera(args, &scene)?;
    let gpu = gpu_session::open_to_measure(global)?;
    let times = args.time.map_or_else(|| camera::time_range(&scene), |t| [t, t]);
    let options = RenderOptions {
        background: args.view.background,
        motion: args.view.motion_source(),
        quality: args.view.quality().for_scene(&scene),
        ..RenderOptions::default()
    };
    let (frames, warmup) = (args.frames.unwrap_or(FRAMES), args.warmup.unwrap_or(WARMUP));
    let plan = Plan { camera, times, frames, warmup, paper_protocol: args.paper_protocol };
    let total = 3 * u64::from(frames) + if args.paper_protocol { u64::from(PAPER_FRAMES) } else { 0 };
    let bar = progress::bar(total, global.quiet);
    let measured = measure::measure(&gpu, &scene, &options, &plan, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let error = if args.check { Some(check(&gpu, &scene, &options, &plan)?) } else { None };
    gpu_session::report_validation(&gpu);
    let mut record = record(&gpu, &scene, &name, &plan, &measured, error);
    record["quality"] = json!(options.quality);
    if let Some(path) = &args.json {
        write_text(path, &(output::to_json(&record)? + "\n"))?;
    }
    if let Some(path) = &args.report {
        write_text(path, &summary::html(&record, &measured))?;
    }
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("scene   {name}: {}", model::describe(&scene)));
        let size = format!("{}x{} pixels", plan.camera.width, plan.camera.height);
        output::line(&format!("view    {size}, t from {} to {}", times[0], times[1]));
        output::line(&format!("quality {}", options.quality.describe()));
        output::line(summary::text(&measured).trim_end());
        if let Some(e) = error {
            output::line(&format!(
                "error   against the f64 reference at t = {}: PSNR {:.1} dB, largest {:.2e}, 99.9 % within {:.2e}",
                times[0], e.psnr, e.max, e.q999
            ));
        }
    }
    Ok(())
}

/// The model of the arguments, or the synthetic scene, and its name.
pub(crate) fn load_scene(args: &BenchArgs) -> Result<(Scene, String)> {
    if let Some(path) = &args.model {
        return Ok((model::load_level(path, args.level)?.scene, path.display().to_string()));
    }
    let (n, m) = (args.synthetic as usize, args.superpoints as usize);
    let scene = if m == 0 {
        random_scene(n, SYNTHETIC_SEED, SYNTHETIC_SH_DEGREE)
    } else {
        moving_scene(n, m, SYNTHETIC_KEYS, SYNTHETIC_SEED, args.view.motion.is_some())
    };
    Ok((scene, format!("synthetic, seed {SYNTHETIC_SEED}")))
}

fn choose_camera(args: &BenchArgs, scene: &Scene) -> Result<Camera> {
    let (width, height) = (args.view.width, args.view.height);
    match &args.cameras {
        Some(path) => {
            let set = model::load_cameras(path, args.split.as_deref(), [width, height])?;
            Ok(model::camera(&set, args.frame)?.clone())
        }
        None => Ok(camera::default_camera(scene, size_of(args))),
    }
}

/// Image size where no cameras say one.
pub(crate) fn size_of(args: &BenchArgs) -> [u32; 2] {
    let (width, height) = (args.view.width, args.view.height);
    [width.or(height).unwrap_or(DEFAULT_SIZE), height.or(width).unwrap_or(DEFAULT_SIZE)]
}

/// The error of the first measured view against the f64 reference.
fn check(gpu: &Gpu, scene: &Scene, options: &RenderOptions, plan: &Plan) -> Result<Difference> {
    let time = plan.times[0];
    let test = Renderer::new(gpu, scene, options)?.render(&plan.camera, time)?;
    let reference_options = ReferenceOptions {
        near: options.near.into(),
        background: options.background.map(f64::from),
        motion: options.motion,
    };
    let truth = reference::render(scene, &plan.camera, time, &reference_options)?;
    let rgb = test.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from);
    Ok(difference(truth.rgb, rgb))
}

/// Everything that makes the numbers comparable.
fn record(
    gpu: &Gpu,
    scene: &Scene,
    name: &str,
    plan: &Plan,
    measured: &Measurement,
    error: Option<Difference>,
) -> Value {
    let info = gpu.info();
    let camera = &plan.camera;
    json!({
        "program": { "name": "spgs", "version": env!("CARGO_PKG_VERSION"), "commit": commit() },
        "command": std::env::args().collect::<Vec<_>>().join(" "),
        "device": info,
        "scene": {
            "name": name,
            "gaussians": scene.gaussians.len(),
            "sh_degree": scene.gaussians.sh_degree,
            "superpoints": scene.superpoints.as_ref().map_or(0, |s| s.position.len()),
            "key_times": scene.motion.as_ref().map_or(0, |m| m.times.len()),
        },
        "view": { "name": camera.name, "width": camera.width, "height": camera.height, "times": plan.times },
        "measurement": measured,
        "error_against_f64": error,
    })
}

/// Writes a text file into a folder that exists.
pub(crate) fn write_text(path: &Path, text: &str) -> Result<()> {
    if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty())
        && !folder.is_dir()
    {
        return Err(Error::usage(format!("{}", path.display()), "a folder that does not exist", "an existing folder"));
    }
    write_atomic(path, |out| out.write_all(text.as_bytes()))
}
