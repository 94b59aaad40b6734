//! `report.html`: the curves of a run from its `run.jsonl`, and test images beside ground truth.

use std::path::Path;

use engine::error::Result;
use engine::file::durable::write_atomic;
use serde_json::Value;

use super::log::{self, number};
use crate::report::page::{Align, Axis, Chart, Mark, Page, Picture, Series, Table};

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

/// Writes the page beside the log.
///
/// # Errors
/// `Io`; `Corrupt` for a damaged log; `Usage` when a plot cannot be drawn.
pub fn write(folder: &Path, facts: &[(String, String)], pairs: &[Pair]) -> Result<()> {
    let lines = log::read(&folder.join("run.jsonl"))?;
    let page = page(&lines, facts, pairs)?;
    write_atomic(&folder.join("report.html"), |out| out.write_all(page.as_bytes()))
}

fn page(lines: &[Value], facts: &[(String, String)], pairs: &[Pair]) -> Result<String> {
    let mut page = Page::new("spgs train");
    page.facts(facts);
    let of = |keys: &[&str]| -> Vec<(f64, f64)> {
        let value = |line: &Value| keys.iter().try_fold(line.clone(), |v, key| v.get(key).cloned())?.as_f64();
        lines.iter().filter_map(|line| Some((number(line, "iteration"), value(line)?))).collect()
    };
    let smoothed = |name: &str, key: &'static str| Series::line(name, smooth(&of(&[key])));
    let psnr = of(&["evaluation", "psnr"]);
    let held_out = Series::new("held-out views", Mark::LineAndPoints, psnr);
    page.chart(&plot("PSNR", "dB").series(smoothed("training view (smoothed)", "psnr")).series(held_out))?;
    page.chart(&plot("Loss", "loss").series(smoothed("total", "loss")).series(smoothed("L1", "l1")))?;
    let property = |key: &'static str| Series::line(key, smooth(&of(&["property", key])));
    let properties = plot("Property losses, unweighted", "loss");
    page.chart(&["position", "rotation", "translation"].into_iter().map(property).fold(properties, Chart::series))?;
    page.chart(&plot("Gaussians", "number").series(Series::line("", of(&["gaussians"]))))?;
    let rate = smoothed("", "iterations_per_second");
    page.chart(&plot("Speed", "iterations per second").series(rate))?;
    kernels(&mut page, lines);
    if !pairs.is_empty() {
        page.heading("Held-out views");
    }
    for p in pairs {
        let beside = |file: &str, what: &str| Picture::beside(file, what);
        let pair = [beside(&p.rendered, "rendered"), beside(&p.truth, "ground truth")];
        page.pictures(&pair, &format!("{}: {:.2} dB", p.name, p.psnr));
    }
    Ok(page.finish())
}

/// An empty chart over iterations.
fn plot(title: &str, y: &str) -> Chart {
    Chart::new(title, Axis::linear("iteration"), Axis::linear(y)).height(320)
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

/// Where a step's time went, from the last line that has it.
fn kernels(page: &mut Page, lines: &[Value]) {
    let Some(Value::Object(ms)) = lines.iter().rev().find_map(|l| l.get("kernel_ms")) else { return };
    let mut rows: Vec<(&String, f64)> = ms.iter().filter_map(|(k, v)| Some((k, v.as_f64()?))).collect();
    rows.sort_by(|a, b| b.1.total_cmp(&a.1));
    page.heading("Device time of the last logged step");
    let mut table = Table::new(&[("kernel", Align::Left), ("ms", Align::Right)]);
    rows.iter().for_each(|(name, value)| table.row([(*name).clone(), format!("{value:.3}")]));
    page.table(&table);
}

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
