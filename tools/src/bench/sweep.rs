//! `spgs bench sweep`: speed against error of every knob of the renderer, for a model and a camera path.

mod combine;
mod measure;
mod measured;
mod report;
mod settings;
mod table;
mod views;

use engine::error::Result;
use engine::image::Image;
use engine::reference::{self, ReferenceOptions};
use engine::scene::{Camera, Scene};
use serde_json::json;

use self::measure::Measurer;
use self::measured::{Measured, VISIBLE, VISIBLE_SHARE};
use self::settings::Kind;
use self::table::table;
use self::views::Views;
use super::scene;
use crate::cli::args::{Global, SweepArgs};
use crate::cli::{gpu_session, model, output, progress};
use crate::report::provenance;

/// Measures every setting and reports.
pub(crate) fn run(args: &SweepArgs, global: &Global) -> Result<()> {
    let (scene, name) = scene::load(&args.scene, args.look.motion.is_some())?;
    let gpu = gpu_session::open(global)?;
    let views = Views::choose(args, &scene, gpu.info().is_cpu())?;
    let mut settings = settings::alone(&scene);
    let combinations = settings.iter().filter(|s| matches!(s.kind, Kind::Knob { .. })).count();
    let bar = progress::sweep((views.cameras.len() + settings.len() + combinations / 2) as u64, global.quiet);
    bar.set_message("f64 reference");
    let truth = references(&scene, args, &views, &|| bar.inc(1))?;
    let mut measurer = Measurer::new(&gpu, &scene, args, &views, &truth)?;
    let mut results: Vec<Measured> = Vec::new();
    for setting in settings.drain(..) {
        bar.set_message(setting.name.clone());
        results.push(measurer.measure(setting)?);
        bar.inc(1);
    }
    for setting in combine::combinations(&results) {
        bar.set_message(setting.name.clone());
        results.push(measurer.measure(setting)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    mark_front(&mut results);
    gpu_session::report_validation(&gpu);
    let view = |(c, t): &(Camera, f64)| json!({ "name": c.name, "width": c.width, "height": c.height, "time": t });
    let numbers = json!({
        "scene": provenance::scene(&name, &scene),
        "views": views.cameras.iter().map(view).collect::<Vec<_>>(),
        "timed_size": views.timed_size,
        "photos": views.photos.is_some(),
        "notes": views.notes,
        "visible": { "difference": VISIBLE, "share": VISIBLE_SHARE },
        "settings": results,
    });
    let record = provenance::record(None, &gpu, numbers);
    args.results.write(&record, || report::html(&record, &measurer, &results))?;
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("scene   {name}: {}", model::describe(&scene)));
        views.notes.iter().for_each(|note| output::line(&format!("note    {note}")));
        output::line(table(&results).text().trim_end());
    }
    Ok(())
}

/// The f64 image of each view.
fn references(scene: &Scene, args: &SweepArgs, views: &Views, tick: &dyn Fn()) -> Result<Vec<Image>> {
    let options = ReferenceOptions {
        background: args.look.background.map(f64::from),
        motion: args.look.motion_source(),
        ..ReferenceOptions::default()
    };
    let mut images = Vec::new();
    for (camera, time) in &views.cameras {
        let r = reference::render(scene, camera, *time, &options)?;
        let rgba = r.rgb.chunks_exact(3).flat_map(|p| [p[0] as f32, p[1] as f32, p[2] as f32, 1.0]).collect();
        images.push(Image { width: r.width, height: r.height, rgba, depth: Vec::new() });
        tick();
    }
    Ok(images)
}

/// Marks the settings that no other one beats in both time and error (mean square).
fn mark_front(results: &mut [Measured]) {
    let points: Vec<(f64, f64)> = results.iter().map(|r| (r.ms(), r.error.rmse)).collect();
    for (i, result) in results.iter_mut().enumerate() {
        let (ms, error) = points[i];
        let beats = |p: &(f64, f64)| p.0 <= ms && p.1 <= error && (p.0 < ms || p.1 < error);
        result.pareto = !points.iter().any(beats);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_what_nothing_beats() {
        let of = |ms: f64, rmse: f64| Measured::for_tests("x", ms, rmse);
        let mut results = vec![of(10.0, 0.0), of(8.0, 1e-3), of(9.0, 1e-2), of(8.0, 1e-3), of(4.0, 1e-1)];
        mark_front(&mut results);
        assert_eq!(results.iter().map(|r| r.pareto).collect::<Vec<_>>(), [true, true, false, true, true]);
        assert_eq!(table(&results).len(), 5);
    }
}
