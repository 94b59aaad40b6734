//! `report.html`: the curves of a run from its `run.jsonl`, and test images beside ground truth.

use std::fmt::Write as _;
use std::path::Path;

use engine::error::{Error, Result};
use engine::file::durable::write_atomic;
use plotters::prelude::*;
use serde_json::Value;

use super::log::{self, number};

/// A pair of pictures in the report, by file name relative to it.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Pair {
    /// The view.
    pub name: String,
    /// Rendered picture.
    pub rendered: String,
    /// Ground truth.
    pub truth: String,
    /// dB.
    pub psnr: f64,
}

/// A named curve: (iteration, value).
type Curve<'a> = (&'a str, Vec<(f64, f64)>);

/// Writes the page beside the log.
///
/// # Errors
/// [`Error::Io`]; [`Error::Corrupt`] for a damaged log; [`Error::Usage`] when a plot cannot be drawn.
pub fn write(folder: &Path, facts: &[(String, String)], pairs: &[Pair]) -> Result<()> {
    let lines = log::read(&folder.join("run.jsonl"))?;
    let page = page(&lines, facts, pairs)?;
    write_atomic(&folder.join("report.html"), |out| out.write_all(page.as_bytes()))
}

fn page(lines: &[Value], facts: &[(String, String)], pairs: &[Pair]) -> Result<String> {
    let mut h = String::from(HEAD);
    h.push_str("<h1>spgs train</h1>\n<table class=\"facts\">\n");
    for (name, value) in facts {
        let _ = writeln!(h, "<tr><th>{}</th><td>{}</td></tr>", escape(name), escape(value));
    }
    h.push_str("</table>\n");
    let of = |keys: &[&str]| -> Vec<(f64, f64)> {
        let value = |line: &Value| keys.iter().try_fold(line.clone(), |v, key| v.get(key).cloned())?.as_f64();
        lines.iter().filter_map(|line| Some((number(line, "iteration"), value(line)?))).collect()
    };
    let training = ("training view (smoothed)", smooth(&of(&["psnr"])));
    h.push_str(&plot("PSNR, dB", &[training, ("held-out views", of(&["evaluation", "psnr"]))])?);
    h.push_str(&plot("Loss", &[("total", smooth(&of(&["loss"]))), ("L1", smooth(&of(&["l1"])))])?);
    let property = |key: &'static str| (key, smooth(&of(&["property", key])));
    h.push_str(&plot(
        "Property losses, unweighted",
        &[property("position"), property("rotation"), property("translation")],
    )?);
    h.push_str(&plot("Gaussians", &[("number", of(&["gaussians"]))])?);
    h.push_str(&plot("Iterations per second", &[("rate", smooth(&of(&["iterations_per_second"])))])?);
    h.push_str(&kernels(lines));
    if !pairs.is_empty() {
        h.push_str("<h2>Held-out views: rendered, ground truth</h2>\n");
    }
    for p in pairs {
        let _ = writeln!(
            h,
            "<figure><img src=\"{}\" alt=\"rendered\"><img src=\"{}\" alt=\"ground truth\"><figcaption>{}: {:.2} dB</figcaption></figure>",
            escape(&p.rendered),
            escape(&p.truth),
            escape(&p.name),
            p.psnr
        );
    }
    h.push_str("</body></html>\n");
    Ok(h)
}

/// Running mean over a fiftieth of the curve.
fn smooth(curve: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let half = curve.len() / 100;
    let mean = |i: usize| {
        let window = &curve[i.saturating_sub(half)..(i + half + 1).min(curve.len())];
        window.iter().map(|p| p.1).sum::<f64>() / window.len() as f64
    };
    (0..curve.len()).map(|i| (curve[i].0, mean(i))).collect()
}

/// One chart as inline SVG; nothing for curves without points.
fn plot(title: &str, curves: &[Curve<'_>]) -> Result<String> {
    let points = || curves.iter().flat_map(|c| &c.1).filter(|p| p.1.is_finite());
    if points().count() < 2 {
        return Ok(String::new());
    }
    let range = |of: fn(&(f64, f64)) -> f64| {
        let (low, high) = points().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let pad = 0.04 * (high - low).max(1e-9);
        (low - pad)..(high + pad)
    };
    let mut svg = String::new();
    draw(&mut svg, title, curves, range(|p| p.0), range(|p| p.1))
        .map_err(|e| Error::usage(format!("plot of {title}"), e.to_string(), "a chart"))?;
    Ok(svg)
}

fn draw(
    svg: &mut String,
    title: &str,
    curves: &[Curve<'_>],
    x: std::ops::Range<f64>,
    y: std::ops::Range<f64>,
) -> std::result::Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, (860, 300)).into_drawing_area();
    let mut chart = ChartBuilder::on(&root)
        .caption(title, ("sans-serif", 16))
        .margin(8)
        .x_label_area_size(30)
        .y_label_area_size(70)
        .build_cartesian_2d(x, y)?;
    chart.configure_mesh().light_line_style(BLACK.mix(0.05)).x_desc("iteration").draw()?;
    for (i, (name, points)) in curves.iter().enumerate().filter(|(_, c)| !c.1.is_empty()) {
        let color = COLORS[i % COLORS.len()];
        let finite = points.iter().copied().filter(|p| p.1.is_finite());
        chart
            .draw_series(LineSeries::new(finite, color.stroke_width(2)))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2)));
    }
    chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3)).draw()?;
    root.present()?;
    Ok(())
}

const COLORS: [RGBColor; 4] =
    [RGBColor(0x35, 0x68, 0xa8), RGBColor(0xc4, 0x4e, 0x32), RGBColor(0x3a, 0x8a, 0x4d), RGBColor(0x80, 0x55, 0xa0)];

/// Where a step's time went, from the last line that has it.
fn kernels(lines: &[Value]) -> String {
    let Some(Value::Object(ms)) = lines.iter().rev().find_map(|l| l.get("kernel_ms")) else { return String::new() };
    let mut rows: Vec<(&String, f64)> = ms.iter().filter_map(|(k, v)| Some((k, v.as_f64()?))).collect();
    rows.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut h = String::from("<h2>Device time of the last logged step, ms</h2>\n<table>\n");
    for (name, value) in rows {
        let _ = writeln!(h, "<tr><td>{}</td><td>{value:.3}</td></tr>", escape(name));
    }
    h.push_str("</table>\n");
    h
}

fn escape(text: &str) -> String {
    crate::report::escape(text)
}

const HEAD: &str = "<!doctype html>
<html lang=\"en\"><head><meta charset=\"utf-8\"><title>spgs train</title>
<style>
body { font: 15px/1.45 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #1b1b1b; background: #fff; }
table { border-collapse: collapse; margin: 1rem 0; } th, td { padding: .25rem .7rem; border-bottom: 1px solid #ddd; text-align: left; }
svg, img { max-width: 100%; height: auto; } figure { margin: 1rem 0; } figure img { width: 49%; margin-right: 1%; image-rendering: pixelated; background: #000; }
</style></head><body>
";

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use serde_json::json;

    use super::*;

    #[test]
    fn the_page_has_the_curves_that_the_log_has() {
        let step = |i: u64| json!({ "iteration": i, "loss": 1.0 / i as f64, "l1": 0.5, "psnr": 20.0 + i as f64 });
        let mut lines: Vec<Value> = (1..50).map(step).collect();
        lines.push(json!({ "iteration": 50, "evaluation": { "psnr": 33.0 }, "kernel_ms": { "blend<": 2.0 } }));
        let pair = Pair { name: "r_0".into(), rendered: "a.png".into(), truth: "b.png".into(), psnr: 30.5 };
        let page = page(&lines, &[("Device".into(), "x & y".into())], &[pair]).unwrap();
        assert!(page.matches("<svg").count() == 2, "PSNR and loss, nothing for what was never logged");
        for part in ["x &amp; y", "blend&lt;", "30.50 dB", "a.png", "iteration"] {
            assert!(page.contains(part), "{part}");
        }
    }

    #[test]
    fn an_empty_log_is_a_page_without_curves() {
        assert!(!page(&[], &[], &[]).unwrap().contains("<svg"));
    }
}
