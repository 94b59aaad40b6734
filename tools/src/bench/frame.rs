//! `spgs bench frame`: frame and kernel times of a model or of a synthetic scene.

use engine::error::Result;
use engine::gpu::Gpu;
use engine::image::{Difference, difference};
use engine::reference::{self, ReferenceOptions};
use engine::render::{RenderOptions, Renderer};
use engine::scene::{Camera, Scene};
use serde_json::{Value, json};

use super::prediction::{self, Kind, Predicted, Subtiles, predict};
use super::scene::{self, DEFAULT_SIZE};
use crate::cli::args::{FrameArgs, Global};
use crate::cli::{camera, gpu_session, model, output, progress};
use crate::report::measure::{self, Measurement, Plan};
use crate::report::page::field;
use crate::report::{provenance, summary};

/// A measured scene and what was predicted of it.
pub(super) struct Found {
    /// Scene, view, measurement and prediction, for a record.
    pub(super) numbers: Value,
    pub(super) measured: Measurement,
    pub(super) predicted: Option<Predicted>,
}

/// Measures a scene and predicts its frame. `tick` is called after each frame.
///
/// # Errors
/// Those of rendering.
pub(super) fn measure_scene(
    gpu: &Gpu,
    (scene, name): (&Scene, &str),
    options: &RenderOptions,
    plan: &Plan,
    tick: &dyn Fn(),
) -> Result<Found> {
    let measured = measure::measure(gpu, scene, options, plan, tick)?;
    // Where the reference rejects what the renderer only leaves out, every subtile counts.
    let counted = Subtiles::count(scene, &plan.camera, plan.times[1], options);
    let counted = counted.inspect_err(|e| log::warn!("prediction without subtiles: {e}")).unwrap_or(Subtiles::ALL);
    let mut predicted = predict(Kind::Frame, &measured.recorded, counted);
    if let Some(predicted) = &mut predicted {
        measured.recorded_beside.iter().for_each(|(frames, recorded)| predicted.add_beside(*frames, recorded));
    }
    let (width, height) = (plan.camera.width, plan.camera.height);
    let numbers = json!({
        "scene": provenance::scene(name, scene),
        "view": { "name": plan.camera.name, "width": width, "height": height, "times": plan.times },
        "measurement": measured,
        "predicted": predicted,
        "quality": options.quality,
    });
    Ok(Found { numbers, measured, predicted })
}

/// The page of a record.
pub(super) fn html(record: &Value, found: &Found) -> String {
    let mut page = summary::begin_page(record, &found.measured);
    if let Some(predicted) = &found.predicted {
        let device = field(record, "/device/name");
        prediction::report::section(&mut page, predicted, &device, &found.measured.operations);
    }
    page.finish()
}

/// Measures and reports.
///
/// # Errors
/// Those of loading and rendering; a file that cannot be written.
pub fn run(args: &FrameArgs, global: &Global) -> Result<()> {
    let (scene, name) = scene::load(&args.scene, args.look.motion.is_some())?;
    let view = choose_camera(args, &scene)?;
    let gpu = gpu_session::open(global)?;
    let times = args.path.time.map_or_else(|| scene.time_range(), |t| [t, t]);
    let options = RenderOptions {
        background: args.look.background,
        motion: args.look.motion_source(),
        quality: args.quality.chosen().for_scene(&scene),
        ..RenderOptions::default()
    };
    let (frames, warmup) = (args.frames, args.warmup);
    let plan = Plan { camera: view, times, frames, warmup, paper_protocol: args.paper_protocol };
    let bar = progress::bar(plan.ticks(), global.quiet);
    let mut found = measure_scene(&gpu, (&scene, &name), &options, &plan, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let error = if args.check { Some(check(&gpu, &scene, &options, &plan)?) } else { None };
    gpu_session::report_validation(&gpu);
    found.numbers["error_against_f64"] = json!(error);
    let record = provenance::record(None, &gpu, found.numbers.take());
    args.results.write(&record, || Ok(html(&record, &found)))?;
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("scene   {name}: {}", model::describe(&scene)));
        output::line(&format!(
            "view    {}x{} pixels, t from {} to {}",
            plan.camera.width, plan.camera.height, times[0], times[1]
        ));
        output::line(&format!("quality {}", options.quality.describe()));
        output::line(summary::text(&found.measured).trim_end());
        if let Some(predicted) = &found.predicted {
            output::line(prediction::report::text(predicted, args.predict).trim_end());
        }
        if let Some(e) = error {
            output::line(&format!(
                "error   against the f64 reference at t = {}: PSNR {:.1} dB, largest {:.2e}, 99.9 % within {:.2e}",
                times[0], e.psnr, e.max, e.q999
            ));
        }
    }
    Ok(())
}

fn choose_camera(args: &FrameArgs, scene: &Scene) -> Result<Camera> {
    match &args.path.cameras {
        Some(path) => {
            let set = model::load_cameras(path, args.path.split.as_deref(), args.size.asked())?;
            Ok(model::camera(&set, args.frame)?.clone())
        }
        None => Ok(camera::default_camera(scene, args.size.or_square(DEFAULT_SIZE))),
    }
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
