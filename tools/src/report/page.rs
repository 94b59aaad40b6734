//! One self-contained HTML page: headings, provenance, tables, charts, pictures. No scripts, nothing loaded from anywhere;
//! readable in light and dark, and on paper.
//!
//! ```
//! use tools::report::page::{Align, Axis, Chart, Page, Series, Table};
//! let mut page = Page::new("spgs bench");
//! page.facts(&[("Scene", "two Gaussians".into())]);
//! page.heading("Frame time");
//! let line = Series::line("exact", vec![(1e4, 1.5), (1e5, 9.0)]);
//! let (x, y) = (Axis::log("Gaussians"), Axis::log("frame time, ms"));
//! page.chart(&Chart::new("Cost against size", x, y).series(line))?;
//! let mut table = Table::new(&[("Gaussians", Align::Right), ("ms", Align::Right)]);
//! table.row(["10000".into(), "1.50".into()]);
//! page.table(&table);
//! assert!(page.finish().ends_with("</html>\n"));
//! # Ok::<(), engine::error::Error>(())
//! ```

mod chart;
mod encode;
mod table;

pub use chart::{Axis, Bar, Chart, Mark, Series, bars};
use encode::escape;
pub use encode::{base64, encode_png};
pub use table::{Align, Standing, Table};

use std::fmt::Write as _;

use engine::error::Result;
use engine::image::Image;
use serde_json::Value;

/// A page under construction. Text given to its methods is escaped; only [`Page::raw`] takes HTML.
#[derive(Debug)]
pub struct Page {
    html: String,
}

/// A picture of [`Page::pictures`].
#[derive(Debug, Clone)]
pub struct Picture {
    source: String,
    caption: String,
}

impl Picture {
    /// Embeds an image as 8-bit PNG (values clamped to [0, 1], as stored).
    ///
    /// # Errors
    /// As [`encode_png`].
    pub fn embedded(image: &Image, caption: impl Into<String>) -> Result<Self> {
        let source = format!("data:image/png;base64,{}", base64(&encode_png(image)?));
        Ok(Self { source, caption: caption.into() })
    }

    /// A PNG that is encoded already.
    pub fn from_png(png: &[u8], caption: impl Into<String>) -> Self {
        Self { source: format!("data:image/png;base64,{}", base64(png)), caption: caption.into() }
    }

    /// A file beside the page, by its name relative to it.
    pub fn beside(file: impl Into<String>, caption: impl Into<String>) -> Self {
        Self { source: file.into(), caption: caption.into() }
    }
}

impl Page {
    /// A page with this title and first heading.
    pub fn new(title: &str) -> Self {
        let title = escape(title);
        let html = format!("{HEAD_BEFORE_TITLE}{title}{HEAD_AFTER_TITLE}<h1>{title}</h1>\n");
        Self { html }
    }

    /// What makes numbers comparable, from a record with `/device`, `/program` and `/command` as `spgs bench` writes it.
    pub fn provenance(&mut self, record: &Value) {
        let of = |pointer: &str| field(record, pointer);
        self.facts(&[
            ("Device", format!("{} ({})", of("/device/name"), of("/device/kind"))),
            ("Driver", format!("{}, Vulkan {}", of("/device/driver"), of("/device/vulkan"))),
            ("Program", format!("spgs {}, commit {}", of("/program/version"), of("/program/commit"))),
            ("Command", of("/command")),
        ]);
    }

    /// A list of names and values.
    pub fn facts<N: AsRef<str>>(&mut self, rows: &[(N, String)]) {
        self.html.push_str("<table class=\"facts\">\n");
        for (name, value) in rows {
            let _ = writeln!(self.html, "<tr><th>{}</th><td>{}</td></tr>", escape(name.as_ref()), escape(value));
        }
        self.html.push_str("</table>\n");
    }

    /// A heading.
    pub fn heading(&mut self, text: &str) {
        let _ = writeln!(self.html, "<h2>{}</h2>", escape(text));
    }

    /// A heading below [`Page::heading`].
    pub fn subheading(&mut self, text: &str) {
        let _ = writeln!(self.html, "<h3>{}</h3>", escape(text));
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) {
        let _ = writeln!(self.html, "<p>{}</p>", escape(text));
    }

    /// A paragraph that must not be overlooked: what was reduced, left out or not measured.
    pub fn note(&mut self, text: &str) {
        let _ = writeln!(self.html, "<p class=\"note\">{}</p>", escape(text));
    }

    /// A table.
    pub fn table(&mut self, table: &Table) {
        self.html.push_str(&table.html());
    }

    /// A chart; nothing when it has no finite point.
    ///
    /// # Errors
    /// `Usage` when it cannot be drawn.
    pub fn chart(&mut self, chart: &Chart) -> Result<()> {
        self.html.push_str(&chart.svg()?);
        Ok(())
    }

    /// Horizontal bars, see [`bars`].
    pub fn bars(&mut self, rows: &[Bar]) {
        self.html.push_str(&bars(rows));
    }

    /// Pictures side by side with their captions, and a caption of them all.
    pub fn pictures(&mut self, pictures: &[Picture], caption: &str) {
        self.html.push_str("<figure>\n<div class=\"row\">\n");
        for p in pictures {
            let (source, text) = (escape(&p.source), escape(&p.caption));
            let _ = writeln!(self.html, "<div><img src=\"{source}\" alt=\"{text}\"><span>{text}</span></div>");
        }
        let _ = writeln!(self.html, "</div>\n<figcaption>{}</figcaption></figure>", escape(caption));
    }

    /// HTML as it is.
    pub fn raw(&mut self, html: &str) {
        self.html.push_str(html);
    }

    /// The page.
    pub fn finish(self) -> String {
        self.html + "</body></html>\n"
    }
}

/// A value of a JSON record as text; `unknown` where it is missing.
pub fn field(record: &Value, pointer: &str) -> String {
    match record.pointer(pointer) {
        Some(Value::String(s)) => s.clone(),
        Some(Value::Null) | None => "unknown".into(),
        Some(other) => other.to_string(),
    }
}

const HEAD_BEFORE_TITLE: &str = "<!doctype html>
<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>";

/// Charts are drawn in black on white; in the dark the style sheet turns black into the colour of the text.
const HEAD_AFTER_TITLE: &str = "</title>
<style>
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #fff; --rule: #ddd; --soft: #f4f6f8; --bar: #3568a8; --good: #e2f2e4; --bad: #f9dedb; --note: #fff3d6; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e4e4; --paper: #16181b; --rule: #3a3d42; --soft: #202328; --bar: #6ea0dc; --good: #1c3a22; --bad: #4a1f1b; --note: #3d3213; } }
body { font: 15px/1.45 system-ui, sans-serif; max-width: 66rem; margin: 2rem auto; padding: 0 1rem; color: var(--ink); background: var(--paper); }
h2 { margin-top: 2.2rem; } p { max-width: 50rem; } p.note { background: var(--note); padding: .5rem .8rem; border-radius: .3rem; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem; border-bottom: 1px solid var(--rule); text-align: left; vertical-align: top; } th { background: var(--soft); }
td.n, th.n { text-align: right; } td.n { white-space: nowrap; } tr.good td { background: var(--good); } tr.bad td { background: var(--bad); }
table.facts th { white-space: nowrap; } table.facts td { overflow-wrap: anywhere; }
svg { display: block; max-width: 100%; height: auto; margin: .5rem 0; } svg text { font-family: system-ui, sans-serif; fill: var(--ink); } svg.bars text { font-size: 13px; } svg.bars rect { fill: var(--bar); }
svg [stroke=\"#000000\"] { stroke: var(--ink); } svg [fill=\"#FFFFFF\"] { fill: var(--paper); }
figure { margin: 1rem 0; } figure .row { display: flex; flex-wrap: wrap; gap: .6rem; } figure .row div { flex: 1 1 12rem; max-width: 32rem; }
figure img { width: 100%; image-rendering: pixelated; background: #000; } figure span, figcaption { display: block; font-size: 13px; } figcaption { margin-top: .3rem; font-weight: 600; }
</style></head><body>
";

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use serde_json::json;

    use super::*;

    #[test]
    fn a_page_escapes_its_text_and_loads_nothing() {
        let mut page = Page::new("a <b> & \"c\"");
        page.provenance(&json!({ "device": { "name": "x<y" }, "command": "spgs --out a&b" }));
        page.heading("h<");
        page.note("n<");
        page.facts(&[("f<", "v<".to_owned())]);
        let image = Image { width: 1, height: 1, rgba: vec![1.0, 0.0, 0.0, 1.0], depth: Vec::new() };
        page.pictures(&[Picture::embedded(&image, "p<").unwrap()], "all<");
        let html = page.finish();
        for part in ["a &lt;b&gt; &amp; &quot;c&quot;", "x&lt;y (unknown)", "a&amp;b", "n&lt;", "v&lt;", "p&lt;"] {
            assert!(html.contains(part), "{part} in {html}");
        }
        for outside in ["http://", "https://", "<script", "url(", "@import", "x<y"] {
            assert!(!html.contains(outside), "{outside}");
        }
        assert!(html.contains("data:image/png;base64,iVBORw0KGgo"));
    }
}
