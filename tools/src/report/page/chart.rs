//! Charts as inline SVG.

mod scale;

use std::fmt::Write as _;

use engine::error::{Error, Result};
use plotters::coord::Shift;
use plotters::prelude::*;

use self::scale::Scale;
use super::encode::escape;

/// Width and height of a chart, pixels.
const SIZE: (u32, u32) = (960, 420);

/// An axis: what it shows and in which unit, and whether it is logarithmic.
#[derive(Debug, Clone)]
pub struct Axis {
    label: String,
    log: bool,
    range: Option<[f64; 2]>,
}

impl Axis {
    /// With even steps. The label names the unit: `frame time, ms`.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: false, range: None }
    }

    /// Logarithmic; points that are not positive are left out.
    pub fn log(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: true, range: None }
    }

    /// Shows at least this range.
    #[must_use]
    pub fn including(mut self, low: f64, high: f64) -> Self {
        self.range = Some([low, high]);
        self
    }

    fn shows(&self, value: f64) -> bool {
        value.is_finite() && (!self.log || value > 0.0)
    }

    fn scale(&self, values: impl Iterator<Item = f64>) -> Scale {
        let all = values.chain(self.range.into_iter().flatten()).filter(|v| self.shows(*v));
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        Scale::around(low, high, self.log)
    }
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// Joined by lines.
    Line,
    /// A dot each.
    Points,
    /// Both.
    LineAndPoints,
}

/// Points of one colour, with a name in the legend.
#[derive(Debug, Clone)]
pub struct Series {
    name: String,
    mark: Mark,
    points: Vec<(f64, f64)>,
    labels: Vec<String>,
}

impl Series {
    /// Points of a kind. A series without a name is not in the legend.
    pub fn new(name: impl Into<String>, mark: Mark, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), mark, points, labels: Vec::new() }
    }

    /// Points joined by lines, in their order.
    pub fn line(name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self::new(name, Mark::Line, points)
    }

    /// A dot per point.
    pub fn points(name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self::new(name, Mark::Points, points)
    }

    /// Words beside the points, by position; empty ones are left out, as are those that would cover another.
    #[must_use]
    pub fn labelled(mut self, labels: Vec<String>) -> Self {
        self.labels = labels;
        self
    }
}

/// A chart of series over two axes.
#[derive(Debug, Clone)]
pub struct Chart {
    title: String,
    x: Axis,
    y: Axis,
    series: Vec<Series>,
    size: (u32, u32),
}

type Drawn<T> = std::result::Result<T, Box<dyn std::error::Error>>;

impl Chart {
    /// An empty chart.
    pub fn new(title: impl Into<String>, x: Axis, y: Axis) -> Self {
        Self { title: title.into(), x, y, series: Vec::new(), size: SIZE }
    }

    /// Adds a series.
    #[must_use]
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Another height, pixels.
    #[must_use]
    pub fn height(mut self, pixels: u32) -> Self {
        self.size.1 = pixels;
        self
    }

    /// The chart as SVG; empty when there is nothing to show.
    ///
    /// # Errors
    /// `Usage` when it cannot be drawn.
    pub fn svg(&self) -> Result<String> {
        let mut svg = String::new();
        if self.shown().next().is_none() {
            return Ok(svg);
        }
        let root = SVGBackend::with_string(&mut svg, self.size).into_drawing_area();
        self.draw(&root)
            .map_err(|e| Error::usage(format!("chart of {}", self.title), e.to_string(), "points that can be drawn"))?;
        drop(root);
        Ok(svg + "\n")
    }

    fn shown(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.series.iter().flat_map(|s| &s.points).copied().filter(|p| self.shows(*p))
    }

    fn shows(&self, p: (f64, f64)) -> bool {
        self.x.shows(p.0) && self.y.shows(p.1)
    }

    /// Where the legend covers the fewest points.
    fn emptiest_corner(&self) -> SeriesLabelPosition {
        let (x, y) = (self.x.scale(self.shown().map(|p| p.0)), self.y.scale(self.shown().map(|p| p.1)));
        let inside = |right: bool, top: bool| {
            let near = |at: f64, high: bool| if high { at > 0.7 } else { at < 0.3 };
            self.shown().filter(|p| near(x.position(p.0), right) && near(y.position(p.1), top)).count()
        };
        let corners = [
            (SeriesLabelPosition::UpperRight, inside(true, true)),
            (SeriesLabelPosition::LowerRight, inside(true, false)),
            (SeriesLabelPosition::UpperLeft, inside(false, true)),
            (SeriesLabelPosition::LowerLeft, inside(false, false)),
        ];
        corners.into_iter().min_by_key(|c| c.1).map_or(SeriesLabelPosition::UpperRight, |c| c.0)
    }

    fn draw(&self, root: &DrawingArea<SVGBackend<'_>, Shift>) -> Drawn<()> {
        let mut chart = ChartBuilder::on(root)
            .caption(&self.title, ("sans-serif", 17))
            .margin(10)
            .margin_right(26)
            .x_label_area_size(44)
            .y_label_area_size(84)
            .build_cartesian_2d(self.x.scale(self.shown().map(|p| p.0)), self.y.scale(self.shown().map(|p| p.1)))?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.12))
            .axis_style(BLACK.mix(0.6))
            .label_style(("sans-serif", 13))
            .axis_desc_style(("sans-serif", 14))
            .x_desc(&self.x.label)
            .y_desc(&self.y.label)
            .draw()?;
        let mut taken = Vec::new();
        for (i, series) in self.series.iter().enumerate() {
            let color = COLORS[i % COLORS.len()];
            let points = || series.points.iter().copied().filter(|p| self.shows(*p));
            if points().next().is_none() {
                continue;
            }
            let mut named = None;
            if series.mark != Mark::Points {
                named = Some(chart.draw_series(std::iter::once(PathElement::new(
                    points().collect::<Vec<_>>(),
                    color.stroke_width(2),
                )))?);
            }
            if series.mark != Mark::Line {
                named = Some(chart.draw_series(points().map(|p| Circle::new(p, 4, color.filled())))?);
            }
            if let Some(annotation) = named.filter(|_| !series.name.is_empty()) {
                annotation
                    .label(&series.name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(3)));
            }
            let labelled = series.points.iter().zip(&series.labels).filter(|(p, l)| self.shows(**p) && !l.is_empty());
            for (point, label) in labelled {
                let at = chart.backend_coord(point);
                let Some(offset) = free_place(&mut taken, at, label, self.size.0) else { continue };
                let text = EmptyElement::at(*point) + Text::new(label.clone(), offset, ("sans-serif", 12));
                chart.draw_series(std::iter::once(text))?;
            }
        }
        if self.series.iter().filter(|s| !s.name.is_empty()).count() > 0 {
            chart
                .configure_series_labels()
                .position(self.emptiest_corner())
                .background_style(WHITE.mix(0.85))
                .border_style(BLACK.mix(0.25))
                .label_font(("sans-serif", 13))
                .draw()?;
        }
        root.present()?;
        Ok(())
    }
}

/// Where a label goes beside its point, in pixels from it: right, left, below or above, where no other label is; `None`
/// when all are taken. `taken`: left, top, right, bottom of the labels so far.
fn free_place(taken: &mut Vec<[i32; 4]>, at: (i32, i32), label: &str, width: u32) -> Option<(i32, i32)> {
    let (w, h) = (label.chars().count() as i32 * 7, 13);
    let places = [(8, -6), (-8 - w, -6), (6, 6), (6, -20), (-6 - w, 6), (-6 - w, -20), (8, 18), (8, -32)];
    for (dx, dy) in places {
        let area = [at.0 + dx, at.1 + dy, at.0 + dx + w, at.1 + dy + h];
        let inside = area[0] >= 86 && area[2] < width as i32 - 4;
        let free = |t: &[i32; 4]| area[2] <= t[0] || t[2] <= area[0] || area[3] <= t[1] || t[3] <= area[1];
        if inside && taken.iter().all(free) {
            taken.push(area);
            return Some((dx, dy));
        }
    }
    None
}

/// Colours that differ in lightness too, for those who do not tell red from green, on light and dark paper.
const COLORS: [RGBColor; 8] = [
    RGBColor(0x3f, 0x78, 0xc0),
    RGBColor(0xd9, 0x5f, 0x30),
    RGBColor(0x3a, 0x9a, 0x5d),
    RGBColor(0x98, 0x68, 0xc0),
    RGBColor(0xc0, 0x96, 0x20),
    RGBColor(0x2f, 0xa5, 0xb5),
    RGBColor(0xc8, 0x58, 0x90),
    RGBColor(0x80, 0x80, 0x80),
];

/// One of [`bars`].
#[derive(Debug, Clone)]
pub struct Bar {
    /// What it is, left of it.
    pub label: String,
    /// Its length.
    pub value: f64,
    /// Its length in words, with the unit, right of it.
    pub text: String,
    /// Shown while the mouse is on it.
    pub hint: String,
}

/// Horizontal bars from 0, longest 560 px; empty for no rows.
pub fn bars(rows: &[Bar]) -> String {
    const ROW: usize = 24;
    const LEFT: f64 = 240.0;
    const WIDTH: f64 = 560.0;
    if rows.is_empty() {
        return String::new();
    }
    let longest = rows.iter().map(|r| r.value).filter(|v| v.is_finite()).fold(1e-9, f64::max);
    let height = rows.len() * ROW + 4;
    let mut s =
        format!("<svg class=\"bars\" viewBox=\"0 0 960 {height}\" width=\"960\" height=\"{height}\" role=\"img\">\n");
    for (i, row) in rows.iter().enumerate() {
        let y = i * ROW;
        let width = if row.value.is_finite() { (WIDTH * row.value / longest).max(1.0) } else { 1.0 };
        let text_y = y + 16;
        let (label, text, hint) = (escape(&row.label), escape(&row.text), escape(&row.hint));
        let _ = writeln!(s, "<text x=\"{}\" y=\"{text_y}\" text-anchor=\"end\">{label}</text>", LEFT - 8.0);
        let (top, bar) = (y + 3, ROW - 6);
        let _ = writeln!(
            s,
            "<rect x=\"{LEFT}\" y=\"{top}\" width=\"{width:.1}\" height=\"{bar}\"><title>{hint}</title></rect>"
        );
        let _ = writeln!(s, "<text x=\"{:.1}\" y=\"{text_y}\">{text}</text>", LEFT + width + 6.0);
    }
    s + "</svg>\n"
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn bar(label: &str, value: f64) -> Bar {
        Bar { label: label.into(), value, text: format!("{value} µs"), hint: String::new() }
    }

    #[test]
    fn bars_are_in_proportion_and_text_is_escaped() {
        let svg = bars(&[bar("a<b>&\"", 100.0), bar("half", 50.0), bar("not a number", f64::NAN)]);
        assert!(svg.contains("a&lt;b&gt;&amp;&quot;") && !svg.contains("a<b>"));
        assert!(svg.contains("width=\"560.0\"") && svg.contains("width=\"280.0\""), "{svg}");
        assert!(bars(&[]).is_empty());
    }

    #[test]
    fn a_chart_has_axes_units_legend_and_labels() {
        let chart = Chart::new("cost", Axis::log("Gaussians"), Axis::linear("time, ms"))
            .series(Series::line("first", vec![(1e3, 1.0), (1e6, 9.0)]))
            .series(Series::points("second", vec![(1e4, 2.0), (0.0, 3.0), (1e5, f64::NAN)]).labelled(vec![
                "here".into(),
                "never: not positive".into(),
                "never: not a number".into(),
            ]));
        let svg = chart.svg().unwrap();
        for part in ["cost", "Gaussians", "time, ms", "first", "second", "here", "10k", "100k"] {
            assert!(svg.contains(&format!("\n{part}\n")), "{part} in {svg}");
        }
        assert!(!svg.contains("never") && svg.matches("<circle").count() == 1);
    }

    #[test]
    fn nothing_to_show_is_nothing() {
        let chart = Chart::new("c", Axis::log("x"), Axis::log("y")).series(Series::line("s", vec![(1.0, -1.0)]));
        assert_eq!(chart.svg().unwrap(), "");
        let one = Chart::new("c", Axis::linear("x"), Axis::log("y")).series(Series::points("s", vec![(0.0, 1.0)]));
        assert!(one.svg().unwrap().contains("<circle"), "one point is a chart too");
    }

    #[test]
    fn labels_do_not_cover_each_other() {
        let mut taken = Vec::new();
        let first = free_place(&mut taken, (300, 100), "word", 960).unwrap();
        let second = free_place(&mut taken, (301, 100), "word", 960).unwrap();
        assert_ne!(first, second);
        for _ in 0..8 {
            free_place(&mut taken, (300, 100), "word", 960);
        }
        assert_eq!(free_place(&mut taken, (300, 100), "word", 960), None);
    }
}
