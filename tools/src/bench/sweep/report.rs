//! The page of a sweep.

use engine::error::Result;
use engine::image::Image;
use engine::metrics::Planes;
use serde_json::Value;

use super::measure::{Measurer, STAGES};
use super::measured::{Measured, VISIBLE};
use super::settings::Kind;
use super::table::table;
use crate::report::error_image;
use crate::report::page::{self, Align, Axis, Chart, Mark, Page, Picture, Series, Standing, Table};

/// Settings that are shown as pictures, at most.
const SHOWN: usize = 10;
/// Smallest error that the logarithmic chart shows: below are equal images.
const SMALLEST_ERROR: f64 = 1e-8;

/// The whole page.
pub(super) fn html(record: &Value, measurer: &Measurer<'_>, results: &[Measured]) -> Result<String> {
    let field = |pointer: &str| page::field(record, pointer);
    let mut page = Page::new(&format!("Speed against error: {}", field("/scene/name")));
    page.provenance(record);
    let views = measurer.views;
    let (camera, _) = &views.cameras[0];
    let [w, h] = views.timed_size;
    page.facts(&[
        (
            "Scene",
            format!(
                "{} Gaussians of SH degree {}, {} superpoints, {} key times",
                field("/scene/gaussians"),
                field("/scene/sh_degree"),
                field("/scene/superpoints"),
                field("/scene/key_times")
            ),
        ),
        (
            "Errors",
            format!(
                "{} views of {}×{} pixels against the f64 reference of the same model",
                views.cameras.len(),
                camera.width,
                camera.height
            ),
        ),
        ("Times", format!("{w}×{h} pixels, one frame at a time, median of {}", time_name(results))),
    ]);
    if !views.notes.is_empty() {
        page.note(&format!("Reduced or left out: {}.", views.notes.join("; ")));
    }
    summary(&mut page, results);
    page.heading("Speed against error");
    page.chart(&scatter(results))?;
    page.text("Down and to the left is better. A value (0 to 1, as an image shows it) off by more than 1/255 = 0.0039 is visible; a setting counts as without visible error when at most 0.01 % of its values are.");
    page.chart(&by_bytes(results))?;
    page.heading("All settings");
    page.table(&table(results));
    page.text("MB/frame: bytes that the kernels of the frame must move, the part of the cost that does not depend on the device. Green: on the Pareto front, no other setting is both faster and more accurate.");
    page.heading("Where the time goes");
    page.table(&stages(results));
    page.heading("What it looks like");
    page.text(&format!("Each setting in the first view, and |difference from the reference| × {}.", error_image::GAIN));
    pictures(&mut page, measurer, results)?;
    Ok(page.finish())
}

/// What the times are.
fn time_name(results: &[Measured]) -> &'static str {
    if results.iter().any(|r| r.processor_ms.is_some()) {
        "the processor time of all threads relative to exact frames drawn in between, because the device is a CPU that others may use too"
    } else {
        "the host's time from submission to the end"
    }
}

/// The answer in a few rows.
fn summary(page: &mut Page, results: &[Measured]) {
    let Some(exact) = results.first() else { return };
    let fastest =
        |ok: &dyn Fn(&Measured) -> bool| results.iter().filter(|r| ok(r)).min_by(|a, b| a.ms().total_cmp(&b.ms()));
    let mut table = Table::new(&[
        ("", Align::Left),
        ("setting", Align::Left),
        ("ms", Align::Right),
        ("speed", Align::Right),
        ("PSNR dB", Align::Right),
        ("> 1/255", Align::Right),
    ]);
    let mut row = |what: &str, m: Option<&Measured>| {
        if let Some(m) = m {
            let standing = if m.error.invisible { Standing::Good } else { Standing::Plain };
            table.marked(
                standing,
                [
                    what.to_owned(),
                    m.setting.name.clone(),
                    format!("{:.2}", m.ms()),
                    format!("{:.2}×", exact.ms() / m.ms()),
                    format!("{:.1}", m.error.psnr),
                    format!("{:.3} %", 100.0 * m.error.visible),
                ],
            );
        }
    };
    row("the definition", Some(exact));
    for r in results.iter().filter(|r| r.setting.kind == Kind::Preset) {
        row("preset", Some(r));
    }
    row("fastest without visible error", fastest(&|r| r.error.invisible));
    row("fastest with at least 40 dB", fastest(&|r| r.error.psnr >= 40.0));
    row("fastest with at least 30 dB", fastest(&|r| r.error.psnr >= 30.0));
    page.table(&table);
}

fn error_of(m: &Measured) -> f64 {
    m.error.rmse.max(SMALLEST_ERROR)
}

/// Series of single knobs, presets and combinations, placed by `x`.
fn kinds(chart: Chart, results: &[Measured], x: fn(&Measured) -> f64) -> Chart {
    let group = |name: &str, is: fn(&Kind) -> bool| {
        let of: Vec<&Measured> = results.iter().filter(|r| is(&r.setting.kind)).collect();
        let label = |r: &&Measured| match &r.setting.kind {
            Kind::Combination => String::new(),
            _ => r.setting.name.replace(" = ", " "),
        };
        Series::points(name, of.iter().map(|r| (x(r), error_of(r))).collect()).labelled(of.iter().map(label).collect())
    };
    chart
        .series(group("one knob", |k| matches!(k, Kind::Knob { .. })))
        .series(group("exact and presets", |k| matches!(k, Kind::Exact | Kind::Preset)))
        .series(group("combination", |k| *k == Kind::Combination))
}

/// Time against error with the Pareto front.
fn scatter(results: &[Measured]) -> Chart {
    let mut front: Vec<(f64, f64)> = results.iter().filter(|r| r.pareto).map(|r| (r.ms(), error_of(r))).collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    let x = Axis::linear(if results.iter().any(|r| r.processor_ms.is_some()) {
        "processor time of a frame, ms"
    } else {
        "frame time, ms"
    });
    let y = Axis::log("root mean square error against the f64 reference (values 0 to 1)");
    let chart = Chart::new("Every setting: time against error", x, y).height(620);
    let chart = kinds(chart, results, |r| r.ms());
    chart.series(Series::new("Pareto front", Mark::Line, front)).series(visible_line(results, |r| r.ms()))
}

/// The same over the bytes that are moved.
fn by_bytes(results: &[Measured]) -> Chart {
    let x = Axis::linear("bytes moved per frame, MB");
    let y = Axis::log("root mean square error against the f64 reference");
    let chart = Chart::new("Every setting: memory traffic against error", x, y).height(460);
    kinds(chart, results, |r| r.bytes as f64 / 1e6)
}

/// Where a whole picture would be off by one level of 255.
fn visible_line(results: &[Measured], x: fn(&Measured) -> f64) -> Series {
    let (low, high) = results.iter().map(x).fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
    Series::line("1/255", vec![(low, VISIBLE), (high, VISIBLE)])
}

/// Device time by stage.
fn stages(results: &[Measured]) -> Table {
    let shown: Vec<&str> = STAGES.into_iter().filter(|s| results.iter().any(|r| r.stage_ms.contains_key(s))).collect();
    let mut columns = vec![("setting".to_owned(), Align::Left)];
    columns.extend(shown.iter().map(|s| (format!("{s}, ms"), Align::Right)));
    columns.push(("tile instances".into(), Align::Right));
    columns.push(("model MB".into(), Align::Right));
    let mut table = Table::new(&columns);
    for r in results {
        let mut cells = vec![r.setting.name.clone()];
        cells.extend(shown.iter().map(|s| r.stage_ms.get(s).map_or("–".into(), |ms| format!("{ms:.3}"))));
        cells.push(r.instances.to_string());
        cells.push(format!("{:.2}", r.scene_bytes as f64 / 1e6));
        table.row(cells);
    }
    table
}

/// The presets, then of each knob its coarsest value, largest visible error first.
fn notable(results: &[Measured]) -> Vec<&Measured> {
    let mut shown: Vec<&Measured> = results.iter().filter(|r| r.setting.kind == Kind::Preset).collect();
    let mut coarsest: Vec<&Measured> = Vec::new();
    for r in results {
        let Kind::Knob { knob, .. } = &r.setting.kind else { continue };
        let same = |m: &&mut &Measured| matches!(&m.setting.kind, Kind::Knob { knob: k, .. } if k == knob);
        match coarsest.iter_mut().find(same) {
            Some(m) if m.error.rmse < r.error.rmse => *m = r,
            Some(_) => {}
            None => coarsest.push(r),
        }
    }
    coarsest.retain(|r| r.error.max > VISIBLE);
    coarsest.sort_by(|a, b| b.error.rmse.total_cmp(&a.error.rmse));
    shown.extend(coarsest);
    shown.truncate(SHOWN);
    shown
}

fn pictures(page: &mut Page, measurer: &Measurer<'_>, results: &[Measured]) -> Result<()> {
    let truth: &Image = &measurer.truth[0];
    let planes = Planes::clamped(truth)?;
    for m in notable(results) {
        let image = measurer.image(&m.setting, 0)?;
        let error = error_image::absolute(&planes, &Planes::clamped(&image)?);
        let e = &m.error;
        let caption = format!(
            "{}: {:.1} dB, largest difference {:.3}, {:.3} % visible, {:.2} ms",
            m.setting.name,
            e.psnr,
            e.max,
            100.0 * e.visible,
            m.ms()
        );
        let row = [
            Picture::embedded(truth, "f64 reference")?,
            Picture::embedded(&image, m.setting.name.clone())?,
            Picture::embedded(&error, format!("difference × {}", error_image::GAIN))?,
        ];
        page.pictures(&row, &caption);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn each_knob_is_shown_at_its_coarsest_and_the_worst_first() {
        let knob = |knob: &'static str, value: &str, rmse: f64| {
            let mut m = Measured::for_tests(&format!("{knob} = {value}"), 1.0, rmse);
            m.error.max = 10.0 * rmse;
            m.setting.kind = Kind::Knob { knob, value: value.into() };
            m
        };
        let results = [
            Measured::for_tests("exact", 1.0, 0.0),
            knob("sh", "f16", 1e-5),
            knob("alpha_cut", "1/128", 1e-3),
            knob("alpha_cut", "1/64", 2e-3),
            knob("resolution", "0.5", 1e-1),
        ];
        let names: Vec<&str> = notable(&results).into_iter().map(|m| m.setting.name.as_str()).collect();
        assert_eq!(names, ["resolution = 0.5", "alpha_cut = 1/64"]);
        assert!(scatter(&results).svg().unwrap().contains("resolution 0.5"));
    }
}
