//! Frames: of the synthetic scene that the goal is stated for, and of the scene that other programs were measured on.

use std::time::Instant;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::render::{Quality, RenderOptions, Renderer};
use engine::scene::{Camera, Scene};

use super::clock::{Context, affordable};
use super::outcome::{Done, Figure, Measured, Outcome, figures};
use crate::bench::frame::{self, Found};
use crate::bench::prediction::{self, Kind};
use crate::bench::scene::{synthetic as synthetic_scene, synthetic_name};
use crate::cli::{camera, model};
use crate::report::measure::Plan;
use crate::report::page::Page;
use crate::report::{provenance, summary};

/// Gaussians, superpoints, image side: what is wanted, and what a slow device gets.
pub(super) const SYNTHETIC: [[u32; 3]; 4] =
    [[120_000, 512, 800], [30_000, 512, 400], [8_000, 128, 200], [1_000, 16, 64]];
/// Most frames that are measured; each is drawn with timestamps, alone, in flight and side by side, then twice as many by the paper's protocol.
const FRAMES: u32 = 500;
const PASSES: f64 = 7.0;
/// Frames before.
const WARMUP: u32 = 3;
/// Of a slow device's time, what one frame of the chosen size may take: scene, copies and pipelines take the rest.
const SHARE_OF_ONE: f64 = 0.05;

/// The synthetic scene of the goal.
pub(super) fn synthetic(context: &Context<'_>) -> Result<Done> {
    let gpu = context.open()?;
    let left = context.clock.left().mul_f64(SHARE_OF_ONE);
    let size = affordable(&gpu, left, &SYNTHETIC, cost, |size| {
        let (scene, view) = made(size);
        Renderer::new(&gpu, &scene, &options(&scene))?.draw(&view, 0.5).map(|_| context.tick())
    })?;
    let (scene, view) = made(size);
    let reduced = smaller(size).into_iter().collect();
    measure(context, &gpu, (&scene, &synthetic_name()), view, reduced)
}

/// As `spgs bench frame` draws a scene without options.
pub(super) fn options(scene: &Scene) -> RenderOptions {
    RenderOptions { quality: Quality::HIGH.for_scene(scene), ..RenderOptions::default() }
}

/// Work of a size, in any unit.
pub(super) fn cost([gaussians, _, side]: [u32; 3]) -> f64 {
    f64::from(gaussians) + f64::from(side).powi(2)
}

/// What is said of a size that is not the one that was wanted.
pub(super) fn smaller(size: [u32; 3]) -> Option<String> {
    let [n, m, side] = size;
    let [wanted, ..] = SYNTHETIC[0];
    (size != SYNTHETIC[0])
        .then(|| format!("{n} of {wanted} Gaussians, {m} superpoints, {side}×{side} pixels, to stay within the time"))
}

fn made([gaussians, superpoints, side]: [u32; 3]) -> (Scene, Camera) {
    let scene = synthetic_scene(gaussians, superpoints, false);
    let view = camera::default_camera(&scene, [side, side]);
    (scene, view)
}

/// The scene on which peers were measured.
pub(super) fn bench_s50k(context: &Context<'_>) -> Result<Done> {
    let folder = match context.data_set("bench_s50k") {
        Ok(folder) => folder,
        Err(why) => return Ok(Done::Skipped(why)),
    };
    let path = folder.join("model.ply");
    let scene = model::load_level(&path, None)?.scene;
    let set = model::load_cameras(&folder, Some("train"), [None; 2])?;
    let view = model::camera(&set, 0)?.clone();
    let gpu = context.open()?;
    measure(context, &gpu, (&scene, &path.display().to_string()), view, Vec::new())
}

fn measure(
    context: &Context<'_>,
    gpu: &Gpu,
    (scene, name): (&Scene, &str),
    camera: Camera,
    mut reduced: Vec<String>,
) -> Result<Done> {
    let options = options(scene);
    let times = scene.time_range();
    let frames = frames_within(context, gpu, scene, &camera, times[1])?;
    if frames < FRAMES {
        reduced.push(format!("{frames} frames of {FRAMES}, to stay within the time"));
    }
    let plan = Plan { camera, times, frames, warmup: WARMUP.min(frames / 2), paper_protocol: frames == FRAMES };
    let found = frame::measure_scene(gpu, (scene, name), &options, &plan, &|| context.tick())?;
    Ok(Done::Ran(Box::new(outcome(gpu, found, reduced))))
}

/// So many that all passes over them fit into half of what is left.
fn frames_within(context: &Context<'_>, gpu: &Gpu, scene: &Scene, view: &Camera, time: f64) -> Result<u32> {
    let mut renderer = Renderer::new(gpu, scene, &options(scene))?;
    renderer.draw(view, time)?;
    let start = Instant::now();
    renderer.draw(view, time)?;
    let each = start.elapsed().as_secs_f64().max(1e-6);
    let fit = 0.5 * context.clock.left().as_secs_f64() / (PASSES * each);
    Ok((fit as u32).clamp(3, FRAMES))
}

fn outcome(gpu: &Gpu, mut found: Found, reduced: Vec<String>) -> Outcome {
    let m = &found.measured;
    let measured = Measured {
        device_ms: m.device_ms.map(|d| d.median),
        one_at_a_time_ms: m.frame_ms.median,
        per_second: m.fps_pipelined,
    };
    let device = gpu.info().name.clone();
    let mut figures = figures(found.predicted.as_ref(), Kind::Frame, &device, measured);
    let in_flight = figures.first().cloned();
    for (rate, in_flight) in m.fps_side_by_side.iter().zip(in_flight.iter().cycle().cloned()) {
        let what = format!("frames, {} side by side", rate.frames);
        let predicted = found.predicted.as_ref().and_then(|p| p.beside(&device));
        let predicted = predicted.and_then(|(gpu, _)| gpu.side_by_side.iter().find(|b| b.frames == rate.frames));
        figures.push(Figure { what, measured: Some(rate.fps), predicted: predicted.map(|b| b.fps), ..in_flight });
    }
    if let Some((fps, in_flight)) = m.fps_paper_protocol.zip(figures.first().cloned()) {
        let what = "frames in flight, the paper's protocol".into();
        figures.push(Figure { what, measured: Some(fps), ..in_flight });
    }
    let record = provenance::record(None, gpu, found.numbers.take());
    let section = Box::new(move |page: &mut Page| {
        page.text(summary::text(&found.measured).lines().next().unwrap_or_default());
        if let Some(p) = &found.predicted {
            prediction::report::summary(page, p);
            page.table(&prediction::report::beside(p, &device, &found.measured.operations));
        }
        Ok(())
    });
    Outcome { record, figures, reduced, failure: None, section }
}
