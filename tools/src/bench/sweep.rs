//! `spgs bench --sweep`: speed against error of every knob of the renderer, for a model and a camera path.

mod measure;
mod report;
mod settings;
mod views;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::image::Image;
use engine::reference::{self, ReferenceOptions};
use engine::scene::Scene;
use serde_json::{Value, json};

use self::measure::{Measured, Measurer};
use self::settings::Kind;
use self::views::Views;
use crate::bench::frame::{load_scene, write_text};
use crate::cli::args::{BenchArgs, Global};
use crate::cli::{gpu_session, model, output, progress};
use crate::report::page::{Align, Standing, Table};

/// A value off by more than this is visible in an 8-bit picture.
const VISIBLE: f64 = 1.0 / 255.0;
/// Share of values that may be off by more for a setting to count as without visible error.
const VISIBLE_SHARE: f64 = 1e-4;

/// Measures every setting and reports.
pub(crate) fn run(args: &BenchArgs, global: &Global) -> Result<()> {
    let (scene, name) = load_scene(args)?;
    let gpu = gpu_session::open_to_measure(global)?;
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
    for setting in settings::combinations(&results) {
        bar.set_message(setting.name.clone());
        results.push(measurer.measure(setting)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    mark_front(&mut results);
    gpu_session::report_validation(&gpu);
    let record = record(&gpu, &scene, &name, &views, &results);
    let page = match &args.report {
        Some(path) => Some((path, report::html(&record, &measurer, &results)?)),
        None => None,
    };
    if let Some(path) = &args.json {
        write_text(path, &(output::to_json(&record)? + "\n"))?;
    }
    if let Some((path, page)) = page {
        write_text(path, &page)?;
    }
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("scene   {name}: {}", model::describe(&scene)));
        views.notes.iter().for_each(|note| output::line(&format!("note    {note}")));
        output::line(table(&results).text().trim_end());
    }
    Ok(())
}

/// The f64 image of each view.
fn references(scene: &Scene, args: &BenchArgs, views: &Views, tick: &dyn Fn()) -> Result<Vec<Image>> {
    let options = ReferenceOptions {
        background: args.view.background.map(f64::from),
        motion: args.view.motion_source(),
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

/// Everything that makes the numbers comparable.
fn record(gpu: &Gpu, scene: &Scene, name: &str, views: &Views, results: &[Measured]) -> Value {
    json!({
        "program": { "name": "spgs", "version": env!("CARGO_PKG_VERSION"), "commit": crate::report::measure::commit() },
        "command": std::env::args().collect::<Vec<_>>().join(" "),
        "device": gpu.info(),
        "scene": {
            "name": name,
            "gaussians": scene.gaussians.len(),
            "sh_degree": scene.gaussians.sh_degree,
            "superpoints": scene.superpoints.as_ref().map_or(0, |s| s.position.len()),
            "key_times": scene.motion.as_ref().map_or(0, |m| m.times.len()),
        },
        "views": views.cameras.iter().map(|(c, t)| json!({ "name": c.name, "width": c.width, "height": c.height, "time": t })).collect::<Vec<_>>(),
        "timed_size": views.timed_size,
        "photos": views.photos.is_some(),
        "notes": views.notes,
        "visible": { "difference": VISIBLE, "share": VISIBLE_SHARE },
        "settings": results,
    })
}

/// The table of the terminal and of the page.
fn table(results: &[Measured]) -> Table {
    let photos = results.iter().any(|r| r.photo_psnr.is_some());
    let mut columns = vec![
        ("setting", Align::Left),
        ("ms", Align::Right),
        ("speed", Align::Right),
        ("MB/frame", Align::Right),
        ("dispatches", Align::Right),
        ("PSNR dB", Align::Right),
        ("largest", Align::Right),
        ("> 1/255", Align::Right),
        ("FLIP", Align::Right),
    ];
    if photos {
        columns.push(("PSNR to photos", Align::Right));
    }
    columns.push(("", Align::Left));
    let mut table = Table::new(&columns);
    let exact = results.first().map_or(f64::NAN, Measured::ms);
    for r in results {
        let e = &r.error;
        let mut cells = vec![
            r.setting.name.clone(),
            format!("{:.2}", r.ms()),
            format!("{:.2}×", exact / r.ms()),
            format!("{:.2}", r.bytes as f64 / 1e6),
            r.dispatches.to_string(),
            format!("{:.1}", e.psnr),
            format!("{:.1e}", e.max),
            format!("{:.3} %", 100.0 * e.visible),
            format!("{:.4}", e.flip),
        ];
        if photos {
            cells.push(r.photo_psnr.map_or("–".into(), |p| format!("{p:.2}")));
        }
        cells.push(if r.pareto { "Pareto" } else { "" }.into());
        table.marked(if r.pareto { Standing::Good } else { Standing::Plain }, cells);
    }
    table
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
