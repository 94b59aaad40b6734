//! The measurement as text and as a page.

use std::fmt::Write as _;

use engine::error::Result;
use serde_json::Value;

use super::protocol::Rates;
use super::roofline::Roofline;
use super::scaling::Curve;
use crate::report::benchmark::Benchmark;
use crate::report::measure::{Measurement, PAPER_FRAMES};
use crate::report::page::{Align, Axis, Chart, Mark, Page, Series, Standing, Table};
use crate::report::paper;

/// Everything that was found.
pub(crate) struct Found {
    pub(crate) rates: Rates,
    pub(crate) measured: Measurement,
    pub(super) roofline: Roofline,
    pub(super) curves: Vec<Curve>,
    pub(super) benchmark: Benchmark,
}

/// Frame rates beside the paper's.
fn speed_table(found: &Found) -> Result<Table> {
    let mut table = Table::new(&[
        ("frames per second", Align::Left),
        ("this device", Align::Right),
        ("V100", Align::Right),
        ("TITAN Xp", Align::Right),
        ("GTX 1060", Align::Right),
    ]);
    let (rates, name) = (&found.rates, found.benchmark.name());
    let ours = |what: &str, fps: f64| [what.to_owned(), format!("{fps:.2}")].map(String::from);
    table.marked(Standing::Good, ours("ours, paper's protocol (one view, in flight)", rates.paper_fps));
    table.marked(Standing::Good, ours("ours, whole path, one frame at a time", rates.path_fps));
    if let Some(fps) = rates.path_fps_in_flight {
        table.marked(Standing::Good, ours("ours, whole path, in flight", fps));
    }
    table.marked(Standing::Good, ours("ours, slowest 1 % of the path", rates.low_1_percent_fps));
    table.row(ours("bound of this device (roofline)", found.roofline.bound_fps));
    for row in paper::tables()?.speed(found.benchmark) {
        let cells = [&row.v100, &row.titan_xp, &row.gtx_1060].map(ToString::to_string);
        let [v100, titan, gtx] = cells;
        table.row([format!("{} on {name} (paper)", row.method), String::new(), v100, titan, gtx]);
    }
    Ok(table)
}

fn percentile_table(found: &Found) -> Table {
    let p = found.rates.path;
    let mut table = Table::new(&["p1", "p5", "p50", "p95", "p99", "mean", "slowest 1 %"].map(|n| (n, Align::Right)));
    table.row([p.p1, p.p5, p.p50, p.p95, p.p99, p.mean, p.slowest_1_percent].map(|v| format!("{v:.3}")));
    table
}

fn roofline_table(r: &Roofline) -> Table {
    let mut table = Table::new(&[
        ("operation", Align::Left),
        ("µs", Align::Right),
        ("bytes", Align::Right),
        ("MFLOP", Align::Right),
        ("bound, µs", Align::Right),
        ("limited by", Align::Left),
        ("of bound", Align::Right),
    ]);
    for row in &r.rows {
        let bound = row.bound_us();
        let by = match bound {
            0.0 => "–",
            _ if row.bytes_us >= row.flops_us => "bytes",
            _ => "arithmetic",
        };
        let share = if row.us > 0.0 && bound > 0.0 { format!("{:.1} %", 100.0 * bound / row.us) } else { "–".into() };
        table.row([
            row.label.clone(),
            format!("{:.1}", row.us),
            row.bytes.to_string(),
            format!("{:.2}", row.flops / 1e6),
            format!("{bound:.2}"),
            by.into(),
            share,
        ]);
    }
    table
}

fn curve_table(curve: &Curve) -> Table {
    let mut table = Table::new(
        &[curve.name, "frame ms", "device ms", "visible", "tile instances"].map(|name| (name, Align::Right)),
    );
    for p in &curve.points {
        table.row([
            format!("{:.0}", p.x),
            format!("{:.3}", p.frame_ms),
            format!("{:.3}", p.device_ms),
            p.visible.to_string(),
            p.instances.to_string(),
        ]);
    }
    table
}

/// What was reduced for the time, if anything was.
pub(crate) fn reduction(found: &Found) -> Option<String> {
    let frames = found.rates.paper_frames;
    (frames < PAPER_FRAMES).then(|| {
        format!("{frames} of the {PAPER_FRAMES} frames of the paper's protocol, to stay within the time (--budget)")
    })
}

/// What was reduced and what to beware of.
fn notes(found: &Found) -> Vec<String> {
    let mut notes: Vec<String> = reduction(found).iter().map(|what| format!("reduced: {what}")).collect();
    notes.push(format!(
        "warm-up {} frames, then {} passes over the path ({} frames)",
        found.rates.warmup_frames, found.rates.passes, found.rates.path.frames
    ));
    notes.push("the paper's figures are means over its scenes at its sizes and Gaussian counts (D-NeRF without Lego: 120k on average)".into());
    notes
}

fn exponents(curve: &Curve) -> String {
    let number = |e: Option<f64>| e.map_or("–".into(), |e| format!("{e:.2}"));
    let [low, high] = curve.range;
    let verdict = match curve.as_theory {
        Some(true) => "as the theory says",
        Some(false) => "NOT as the theory says",
        None => "too few points to say",
    };
    format!(
        "exponent {} over all, {} over the larger half; theory {low:.0} to {high:.0}: {verdict}",
        number(curve.exponent),
        number(curve.tail_exponent)
    )
}

fn bound_line(r: &Roofline) -> String {
    format!(
        "copies {:.1} GB/s, f32 {:.1} GFLOP/s (both measured) → at least {:.3} ms, at most {:.1} frames per second; the device reaches {:.1} % of it",
        r.copy_gb_per_s,
        r.gflop_per_s,
        r.bound_ms,
        r.bound_fps,
        100.0 * r.share
    )
}

/// For the terminal.
pub(super) fn text(found: &Found) -> Result<String> {
    let mut t = String::new();
    let _ = writeln!(t, "\n{}", speed_table(found)?.text());
    let _ = writeln!(t, "frame times over the path, ms\n{}", percentile_table(found).text());
    notes(found).iter().for_each(|n| t.push_str(&format!("note    {n}\n")));
    let _ = writeln!(t, "\nroofline  {}\n{}", bound_line(&found.roofline), roofline_table(&found.roofline).text());
    for curve in &found.curves {
        let _ = writeln!(t, "cost against {} ({})\n{}", curve.name, curve.fixed, curve_table(curve).text().trim_end());
        let _ = writeln!(t, "{}; ended {}\n", exponents(curve), curve.ended);
    }
    Ok(t)
}

/// The page.
pub(super) fn html(record: &Value, found: &Found) -> Result<String> {
    let mut page = Page::new("spgs bench paper");
    page.provenance(record);
    let of = |pointer: &str| crate::report::page::field(record, pointer);
    page.facts(&[
        (
            "Processor",
            format!(
                "{}, {} threads, {} MHz now",
                of("/processor/name"),
                of("/processor/threads"),
                of("/processor/mhz_now")
            ),
        ),
        ("Clocks", of("/clocks")),
        (
            "Scene",
            format!(
                "{}: {} Gaussians, {} superpoints",
                of("/scene/name"),
                of("/scene/gaussians"),
                of("/scene/superpoints")
            ),
        ),
        (
            "Path",
            format!(
                "{} views of {}×{} pixels: {}",
                of("/path/views"),
                of("/path/width"),
                of("/path/height"),
                of("/path/name")
            ),
        ),
    ]);
    notes(found).iter().for_each(|n| page.note(n));
    section(&mut page, found)?;
    Ok(page.finish())
}

/// Tables and charts.
pub(crate) fn section(page: &mut Page, found: &Found) -> Result<()> {
    page.heading("Frames per second");
    page.table(&speed_table(found)?);
    page.subheading("Frame times over the path, ms");
    page.table(&percentile_table(found));
    page.heading("Roofline");
    page.text(&bound_line(&found.roofline));
    page.text(
        "Arithmetic: 650 operations per Gaussian, 20 per pixel of every tile instance, two per weight of network F.",
    );
    page.table(&roofline_table(&found.roofline));
    for curve in &found.curves {
        page.heading(&format!("Cost against {}", curve.name));
        page.text(&format!("Fixed: {}. Theory: {}.", curve.fixed, curve.theory));
        page.text(&format!("Device time: {}. The curve ended {}.", exponents(curve), curve.ended));
        page.chart(&curve_chart(curve))?;
        page.table(&curve_table(curve));
    }
    Ok(())
}

/// Measured points, and the steepest line that the theory allows through the last one.
fn curve_chart(curve: &Curve) -> Chart {
    let of = |f: fn(&super::scaling::Point) -> f64| curve.points.iter().map(|p| (p.x, f(p))).collect::<Vec<_>>();
    let mut chart =
        Chart::new(format!("Cost against {}", curve.name), Axis::log(curve.name), Axis::log("time of a frame, ms"))
            .series(Series::new("host", Mark::LineAndPoints, of(|p| p.frame_ms)))
            .series(Series::new("device", Mark::LineAndPoints, of(|p| p.device_ms)));
    if let (Some(first), Some(last)) = (curve.points.first(), curve.points.last()) {
        let at = |x: f64| last.device_ms * (x / last.x).powf(curve.range[1]);
        let line = vec![(first.x, at(first.x)), (last.x, at(last.x))];
        chart = chart.series(Series::line(format!("theory: exponent {:.0}", curve.range[1]), line));
    }
    chart
}
