//! The paper's protocol, `spgs bench paper`, on the synthetic scene of the goal.

use engine::error::Result;

use super::clock::Context;
use super::frames::{SYNTHETIC, options, smaller};
use super::outcome::{Done, Figure, Outcome};
use crate::bench::paper::{self, Subject};
use crate::bench::prediction::{Kind, Subtiles, predict};
use crate::bench::scene::{synthetic, synthetic_name};
use crate::report::page::Page;
use crate::report::provenance;

/// Frames of the kernel profile, at most, and before it.
const FRAMES: u32 = 20;
const WARMUP: u32 = 3;
/// Seconds below which a CPU gets a smaller scene, and one without scaling curves.
const ENOUGH_S: f64 = 60.0;

/// Measures both protocols, the roofline and the scaling curves.
pub(super) fn run(context: &Context<'_>) -> Result<Done> {
    let gpu = context.open()?;
    let left = context.clock.left();
    let short = gpu.info().is_cpu() && left.as_secs_f64() < ENOUGH_S;
    let size = if short { SYNTHETIC[SYNTHETIC.len() - 1] } else { SYNTHETIC[0] };
    let [gaussians, superpoints, side] = size;
    let scene = synthetic(gaussians, superpoints, false);
    let (path, path_name) = paper::orbit(&scene, [side, side]);
    let subject = Subject {
        scene: &scene,
        name: synthetic_name(),
        path,
        path_name,
        options: options(&scene),
        view: 0,
        frames: FRAMES,
        warmup: WARMUP,
        budget: left.mul_f64(0.9),
        curves: !short,
    };
    let (numbers, found) = paper::measure(&gpu, &subject)?;
    context.tick();
    let mut reduced: Vec<String> = smaller(size).into_iter().collect();
    if short {
        reduced.push("no scaling curves".into());
    }
    let view = &subject.path[0].0;
    let counted = Subtiles::count(&scene, view, scene.time_range()[1], &subject.options)?;
    let predicted = predict(Kind::Frame, &found.measured.recorded, counted);
    let (beside, same) = predicted.as_ref().and_then(|p| p.beside(&gpu.info().name)).unzip();
    let figure = |what: &str, measured: f64, predicted: Option<f64>| Figure {
        predicted,
        predicted_on: beside.map(|g| g.gpu),
        same_device: same.unwrap_or(false),
        ..Figure::new(what, "FPS", measured)
    };
    let mut figures = vec![
        figure("the paper's protocol, in flight", found.rates.paper_fps, beside.map(|g| g.per_second)),
        figure("whole path, one frame at a time", found.rates.path_fps, beside.map(|g| 1e3 / g.one_at_a_time_ms)),
        Figure::new("slowest 1 % of the path", "FPS", found.rates.low_1_percent_fps),
    ];
    if let Some(fps) = found.rates.path_fps_in_flight {
        figures.insert(2, figure("whole path, in flight", fps, beside.map(|g| g.per_second)));
    }
    reduced.extend(paper::reduction(&found));
    let mut record = provenance::record(Some("paper"), &gpu, numbers);
    record["predicted"] = serde_json::json!(predicted);
    let section = Box::new(move |page: &mut Page| paper::section(page, &found));
    Ok(Done::Ran(Box::new(Outcome { record, figures, reduced, failure: None, section })))
}
