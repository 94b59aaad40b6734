//! The page of what was found.

use engine::error::Result;
use engine::pose::{Moment, PhotoReport, Solve};

use super::summary::{Summary, word};
use crate::report::page::{Align, Axis, Chart, Page, Series, Standing, Table};

/// A page with charts over time and a table of the photos.
///
/// # Errors
/// `Usage` for a chart that cannot be drawn.
pub(super) fn page(s: &Summary) -> Result<String> {
    let mut page = Page::new(&format!("spgs pose: {}", s.model.display()));
    let [before, after] = s.key_times;
    let photos = s.moments.iter().map(|m| m.photos.len()).sum::<usize>();
    page.facts(&[
        ("Device", s.device.clone()),
        ("Photos", format!("{photos}, of {} times", s.moments.len())),
        ("Key times", format!("{before} before, {after} now")),
        ("Search", format!("{} iterations per time, coupling {}", s.options.iterations, s.options.coupling)),
    ]);
    let stayed = s.moments.iter().filter(|m| !m.is_better).count();
    if s.options.solve != Solve::Camera && stayed > 0 {
        page.note(&format!(
            "At {stayed} of {} times nothing better was found, and all stayed as it was.",
            s.moments.len()
        ));
    }
    page.heading("Photos");
    page.chart(&over_time(
        "PSNR of the photos",
        "PSNR, dB",
        s,
        &[
            ("where the search began", &|m| m.photos.iter().map(|p| p.psnr_before).collect()),
            ("as found", &|m| m.photos.iter().map(|p| p.psnr).collect()),
        ],
    ))?;
    if s.options.solve != Solve::Camera {
        page.chart(&over_time(
            "How well superpoints are known, median of those seen",
            "standard deviation, pixels",
            s,
            &[("across the view", &|m| {
                median(m.superpoints.iter().filter_map(|u| u.across_px).collect()).into_iter().collect()
            })],
        ))?;
    }
    page.table(&table(s));
    Ok(page.finish())
}

type Values<'a> = &'a dyn Fn(&Moment) -> Vec<f64>;

fn over_time(title: &str, unit: &str, s: &Summary, series: &[(&str, Values<'_>)]) -> Chart {
    let chart = Chart::new(title, Axis::linear("time"), Axis::linear(unit));
    series.iter().fold(chart, |chart, (name, values)| {
        let points = s.moments.iter().flat_map(|m| values(m).into_iter().map(|v| (m.time, v))).collect();
        chart.series(Series::line(*name, points))
    })
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn table(s: &Summary) -> Table {
    let mut columns = vec![("photo", Align::Left)];
    columns.extend(["time", "PSNR before, dB", "after, dB", "superpoints seen"].map(|name| (name, Align::Right)));
    columns.push(("camera", Align::Left));
    let mut table = Table::new(&columns);
    for m in &s.moments {
        let seen = m.superpoints.iter().filter(|u| u.seen).count();
        let seen = if m.superpoints.is_empty() { "-".into() } else { format!("{seen} of {}", m.superpoints.len()) };
        for p in &m.photos {
            let camera = p.camera.as_ref().map_or_else(|| "as given".into(), |c| word(c.verdict));
            let numbers = [format!("{:.4}", m.time), format!("{:.2}", p.psnr_before), format!("{:.2}", p.psnr)];
            let cells = std::iter::once(p.name.clone()).chain(numbers).chain([seen.clone(), camera]);
            table.marked(standing(p), cells);
        }
    }
    table
}

fn standing(photo: &PhotoReport) -> Standing {
    match &photo.camera {
        Some(camera) if word(camera.verdict).starts_with("NOT") => Standing::Bad,
        _ => Standing::Plain,
    }
}
