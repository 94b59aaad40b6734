//! The page of an evaluation.

use engine::error::Result;
use engine::metrics::flip;
use serde_json::Value;

use super::evaluation::{Evaluation, our_row, paper_rows, paper_title};
use super::session::{Session, ViewResult};
use super::setting::Setting;
use crate::report::page::{Align, Axis, Chart, Mark, Page, Picture, Series, Standing, Table};
use crate::report::scores::{AllScores, cell};
use crate::report::{error_image, paper};

/// A page with tables, charts of the metrics over time, and pictures of the worst, the median and the best view.
pub(super) fn page(record: &Value, setting: &Setting, e: &Evaluation, session: &mut Session<'_>) -> Result<String> {
    let title = record.pointer("/data/folder").and_then(Value::as_str).unwrap_or("a data set");
    let mut page = Page::new(&format!("spgs eval: {title}"));
    page.provenance(record);
    page.facts(&facts(record, setting, e));
    e.notes.iter().for_each(|n| page.note(n));
    page.heading("Mean");
    page.table(&means(e));
    beside_the_paper(&mut page, setting, e)?;
    page.heading("By view");
    charts(&mut page, e)?;
    page.table(&views(e));
    page.heading("Images");
    page.text(
        "Left to right: rendered, truth, FLIP (black: no visible difference, pale yellow: the largest), absolute \
         difference times four.",
    );
    for (what, view) in shown(&e.views) {
        let [rendered, truth] = session.quantised(view.index)?;
        let map = flip(&truth, &rendered, engine::metrics::PIXELS_PER_DEGREE)?;
        let pictures = [
            Picture::embedded(&error_image::image(&rendered), "rendered")?,
            Picture::embedded(&error_image::image(&truth), "truth")?,
            Picture::embedded(&error_image::flip(&map), "FLIP")?,
            Picture::embedded(&error_image::absolute(&truth, &rendered), "absolute difference × 4")?,
        ];
        let s = view.scores.pixel;
        let caption = format!(
            "{what}: {}, t = {:.4}, PSNR {:.2} dB, SSIM {:.4}, FLIP {:.4}",
            view.name, view.time, s.psnr, s.ssim, s.flip
        );
        page.pictures(&pictures, &caption);
    }
    Ok(page.finish())
}

fn facts(record: &Value, setting: &Setting, e: &Evaluation) -> Vec<(&'static str, String)> {
    let of = |pointer: &str| crate::report::page::field(record, pointer);
    let size = e.views.first().map_or(String::new(), |v| format!("{}x{} pixels", v.width, v.height));
    let render = e.views.iter().map(|v| v.render_ms).sum::<f64>() / e.views.len().max(1) as f64;
    let mut facts = vec![
        ("Model", format!("{}: {}", of("/model/file"), of("/model/description"))),
        ("Data", format!("{}, split {}, {} views of {size}", of("/data/format"), of("/data/split"), e.views.len())),
        ("Background", format!("{:?}", setting.background)),
        ("Rendering", format!("{render:.2} ms a view, from submission to the image in host memory (not a benchmark)")),
    ];
    if let Some(f) = e.flicker {
        let rms = f.rms.map_or("no static pixel".into(), |r| format!("{r:.5} rms"));
        let share = 100.0 * f.static_share;
        facts.push(("Flicker", format!("{rms}, {share:.1} % of pixels static, {} pairs of frames", f.pairs)));
    }
    if let Some(c) = &e.confidence {
        facts.push(("Confidence", c.line()));
    }
    facts
}

fn metric_columns(first: &str) -> Vec<(String, Align)> {
    let names = ["PSNR, dB", "SSIM", "SSIM, inside", "MS-SSIM", "FLIP", "LPIPS AlexNet", "LPIPS VGG-16"];
    std::iter::once((first.to_owned(), Align::Left))
        .chain(names.into_iter().map(|n| (n.to_owned(), Align::Right)))
        .collect()
}

fn cells(scores: &AllScores) -> impl Iterator<Item = String> {
    scores.rows().map(|(_, value, decimals)| cell(value, decimals)).into_iter()
}

fn means(e: &Evaluation) -> Table {
    let mut table = Table::new(&metric_columns("values"));
    table.row(std::iter::once("8 bit, as written to PNG".to_owned()).chain(cells(&e.mean)));
    let [psnr, ssim, valid, ms_ssim] = e.mean_float.cells();
    let float = [cell(psnr, 2), cell(ssim, 4), cell(valid, 4), cell(ms_ssim, 4)];
    table.row(std::iter::once("float".to_owned()).chain(float));
    if let Some(masked) = &e.mean_masked {
        table.row(std::iter::once("8 bit, under the masks".to_owned()).chain(cells(masked)));
    }
    table
}

fn beside_the_paper(page: &mut Page, setting: &Setting, e: &Evaluation) -> Result<()> {
    let Some(protocol) = &setting.protocol else { return Ok(()) };
    page.heading(&format!("Beside the paper: {}", protocol.benchmark.name()));
    setting.deviations.iter().for_each(|d| page.note(&format!("Not as in the paper: {d}.")));
    page.text(&format!("The paper's figures: {}.", paper_title(setting)));
    let columns = ["PSNR, dB", protocol.similarity, "LPIPS"].map(|n| (n, Align::Right));
    let mut table = Table::new(&[&[("method", Align::Left)], &columns[..]].concat());
    let row = |name: &str, v: [Option<f64>; 3]| [name.to_owned(), cell(v[0], 2), cell(v[1], 4), cell(v[2], 4)];
    paper_rows(setting)?.iter().for_each(|r| table.row(row(&r.method, [r.psnr, r.similarity, r.lpips])));
    table.marked(Standing::Good, row("this model", our_row(setting, e)));
    page.table(&table);
    protocol.remarks.iter().for_each(|r| page.text(r));
    page.subheading("Where the paper contradicts itself");
    for c in paper::tables()?.contradictions(protocol.benchmark) {
        page.text(&format!("{}: {}", c.about, c.text));
    }
    Ok(())
}

fn charts(page: &mut Page, e: &Evaluation) -> Result<()> {
    let over_time = |value: fn(&ViewResult) -> f64| {
        let mut points: Vec<(f64, f64)> = e.views.iter().map(|v| (v.time, value(v))).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points
    };
    let time = || Axis::linear("time of the view");
    let mark = if e.beside.is_empty() { Mark::Points } else { Mark::Line };
    let psnr = Series::new("this model", mark, over_time(|v| v.scores.pixel.psnr));
    let chart = Chart::new("PSNR over time", time(), Axis::linear("PSNR, dB")).series(psnr);
    page.chart(&e.beside.iter().fold(chart, |chart, other| chart.series(other.series())))?;
    e.beside.iter().for_each(|other| page.text(&other.line(&e.views)));
    let flip = Series::points("FLIP", over_time(|v| v.scores.pixel.flip));
    page.chart(&Chart::new("FLIP over time", time(), Axis::linear("mean FLIP, 0 to 1")).series(flip))
}

fn views(e: &Evaluation) -> Table {
    let mut columns = metric_columns("view");
    columns.insert(1, ("time".into(), Align::Right));
    let mut table = Table::new(&columns);
    for v in &e.views {
        table.row([v.name.clone(), format!("{:.4}", v.time)].into_iter().chain(cells(&v.scores)));
    }
    table
}

/// Worst, median and best view by PSNR; fewer of fewer views.
fn shown(views: &[ViewResult]) -> Vec<(&'static str, &ViewResult)> {
    let mut sorted: Vec<&ViewResult> = views.iter().collect();
    sorted.sort_by(|a, b| a.scores.pixel.psnr.total_cmp(&b.scores.pixel.psnr));
    let picks = [("worst", 0), ("median", sorted.len() / 2), ("best", sorted.len().saturating_sub(1))];
    let mut shown: Vec<(&'static str, &ViewResult)> = Vec::new();
    for (what, at) in picks {
        if let Some(view) = sorted.get(at).filter(|v| shown.iter().all(|(_, s)| s.index != v.index)) {
            shown.push((what, view));
        }
    }
    shown
}
