//! The page of a student.

use engine::distill::Report;
use engine::error::Result;
use engine::metrics::Planes;
use serde_json::Value;

use super::compare::Shown;
use super::summary::{Summary, verdict};
use super::tune::Tuning;
use crate::report::error_image;
use crate::report::page::{Align, Axis, Chart, Page, Picture, Series, Standing, Table};
use crate::report::scores::cell;

/// A page with tables, a chart of PSNR over time, and images of the worst, the median and the best view.
pub(super) fn page(record: &Value, s: &Summary, shown: &[Shown]) -> Result<String> {
    let m = &s.motion;
    let mut page = Page::new(&format!("spgs distill: {}", s.teacher.display()));
    if record.get("device").is_some() {
        page.provenance(record);
    }
    let [before, after] = m.superpoints;
    page.facts(&[
        ("Student", format!("{} Gaussians, {after} superpoints, {} key times", m.gaussians[1], m.key_times)),
        ("Teacher", format!("{} Gaussians, {before} superpoints", m.gaussians[0])),
        ("Of the superpoints", format!("{} move one Gaussian", m.singletons)),
        ("Blended", format!("{} Gaussians move with several superpoints", m.soft)),
        ("Rest", format!("{} Gaussians", m.still)),
        ("Pixels", format!("of {}", s.measured_in)),
        ("Times", format!("{} to fit, {} more to measure", m.sampled_times, m.checked_times)),
        ("Chords", format!("between those times the teacher is off them by up to {:.4} px", m.chord_px)),
    ]);
    let when = if s.tuning.is_some() { "Error of the fit" } else { "Error" };
    page.note(&format!("{when}: {}.", verdict(m)));
    s.tuning.iter().for_each(|t| page.note(&format!("Fine-tuning: {}.", t.verdict())));
    page.heading(when);
    page.table(&errors(m));
    if let Some(t) = &s.tuning {
        page.heading("Fine-tuning");
        page.table(&tuned(m, t));
        let [photos, drawn] = t.images;
        let (n, seed, seconds) = (t.iterations, t.seed, t.seconds);
        page.text(&format!(
            "{n} steps on {photos} photos and {drawn} images of the teacher, seed {seed}, {seconds:.1} s."
        ));
    }
    page.heading("What the student lacks");
    if m.dropped.is_empty() {
        page.text("Nothing.");
    }
    m.dropped.iter().for_each(|text| page.text(text));
    page.heading("Both");
    page.table(&both(s));
    if let Some(images) = &s.images {
        let mut points: Vec<(f64, f64)> = images.views.iter().filter_map(|v| Some((v.time, v.psnr?))).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let series = Series::points("PSNR", points);
        let axes = [Axis::linear("time of the view"), Axis::linear("PSNR, dB")];
        let [x, y] = axes;
        page.chart(&Chart::new("Student against teacher", x, y).series(series))?;
    }
    for Shown { caption, teacher, student } in shown {
        let planes = [Planes::quantised(teacher)?, Planes::quantised(student)?];
        let pictures = [
            Picture::embedded(&error_image::image(&planes[0]), "teacher")?,
            Picture::embedded(&error_image::image(&planes[1]), "student")?,
            Picture::embedded(&error_image::absolute(&planes[0], &planes[1]), "absolute difference × 4")?,
        ];
        page.pictures(&pictures, caption);
    }
    Ok(page.finish())
}

fn errors(m: &Report) -> Table {
    let mut table = Table::new(&[("", Align::Left), ("largest", Align::Right), ("99.9 % of Gaussians", Align::Right)]);
    let standing = if m.is_within() { Standing::Good } else { Standing::Bad };
    let row = |name: &str, largest: f64, q999: Option<f64>| [name.to_owned(), cell(Some(largest), 4), cell(q999, 4)];
    table.marked(standing, row("displacement, px", m.error_px.largest, Some(m.error_px.q999)));
    table.row(row("at key times, px", m.at_keys_px, None));
    table.row(row("between key times, px", m.between_px, None));
    table.row(row("rotation, degrees", m.rotation_degrees.largest, Some(m.rotation_degrees.q999)));
    if let Some(change) = &m.size_change {
        table.row(row("size not followed, px at two standard deviations", change.px.largest, Some(change.px.q999)));
        table.row(row("size not followed, %", 100.0 * change.share.largest, Some(100.0 * change.share.q999)));
    }
    table
}

/// Before and after.
fn tuned(m: &Report, t: &Tuning) -> Table {
    let mut table = Table::new(&[("", Align::Left), ("before", Align::Right), ("after", Align::Right)]);
    let d = &t.displacement;
    let row = |name: &str, pair: [Option<f64>; 2], digits: usize| {
        let [a, b] = pair.map(|v| cell(v, digits));
        [name.to_owned(), a, b]
    };
    let standing = if t.within_bound { Standing::Good } else { Standing::Bad };
    table.marked(standing, row("largest displacement, px", [m.error_px.largest, d.error_px.largest].map(Some), 4));
    table.row(row("99.9 % of the Gaussians, px", [m.error_px.q999, d.error_px.q999].map(Some), 4));
    table.row(["Gaussians above the bound".into(), m.above.to_string(), d.above.to_string()]);
    table.row(row("PSNR against the teacher, dB", t.teacher_psnr, 2));
    if let (Some(psnr), Some(ssim)) = (t.photo_psnr, t.photo_ssim) {
        table.row(row("PSNR against photos, dB", psnr.map(Some), 2));
        table.row(row("SSIM against photos", ssim.map(Some), 4));
    }
    table.row(row("loss of the steps", t.loss.map(Some), 5));
    table
}

fn both(s: &Summary) -> Table {
    let mut table = Table::new(&[("", Align::Left), ("teacher", Align::Right), ("student", Align::Right)]);
    let mut row = |name: &str, [a, b]: [String; 2]| table.row([name.to_owned(), a, b]);
    row("bytes", s.bytes.map(|b| b.map_or("-".into(), |b| b.to_string())));
    row("Gaussians", s.motion.gaussians.map(|n| n.to_string()));
    row("superpoints", s.motion.superpoints.map(|n| n.to_string()));
    if let Some(images) = &s.images {
        row("frame, ms", images.frame_ms.map(|v| cell(Some(v), 2)));
        row("FPS, one frame at a time", images.fps().map(|v| cell(Some(v), 1)));
        row("PSNR against the teacher, dB", ["-".into(), cell(images.psnr, 2)]);
        row("worst view, dB", ["-".into(), cell(images.worst, 2)]);
    }
    if let Some(photos) = &s.photos {
        row(&format!("PSNR against {} photos, dB", photos.split), photos.psnr.map(|v| cell(Some(v), 2)));
        row(&format!("SSIM against {} photos", photos.split), photos.ssim.map(|v| cell(Some(v), 4)));
    }
    table
}
