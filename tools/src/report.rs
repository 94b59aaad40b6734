//! A measurement as text for the terminal and as a self-contained page with a bar chart.

use std::fmt::Write as _;

use serde_json::Value;

use crate::measure::{Measurement, OperationRow};

/// The table that `bench` and `demo` print.
pub fn text(m: &Measurement) -> String {
    let mut t = String::new();
    let f = m.frame_ms;
    let _ = writeln!(t, "frame   {:.3} ms median, {:.3} p5, {:.3} p95 over {} frames", f.median, f.p5, f.p95, m.frames);
    if let Some(d) = m.device_ms {
        let _ = writeln!(t, "device  {:.3} ms median, {:.3} p5, {:.3} p95", d.median, d.p5, d.p95);
    }
    let _ =
        writeln!(t, "FPS     {:.1} one at a time, {:.1} with {} in flight", m.fps, m.fps_pipelined, m.frames_in_flight);
    if let Some(fps) = m.fps_paper_protocol {
        let _ = writeln!(t, "FPS     {fps:.1} by the paper's protocol (one view, 1000 frames, t from 0 to 1)");
    }
    let _ = writeln!(t, "work    {} dispatches, {} barriers per frame", m.dispatches, m.barriers);
    let _ = writeln!(
        t,
        "        {} visible Gaussians, {} tile instances, {} rejected",
        m.statistics.visible, m.statistics.instances, m.statistics.rejected
    );
    let _ = writeln!(
        t,
        "memory  {:.1} MiB: {:.0} bytes per Gaussian, {:.1} per tile instance of room, {:.1} MiB of images",
        (m.memory.scene + m.memory.per_gaussian + m.memory.per_instance + m.memory.images) as f64 / MIB,
        m.bytes_per_gaussian,
        m.bytes_per_instance,
        m.memory.images as f64 / MIB
    );
    let _ = writeln!(t, "copies  {:.1} GB/s (device to device, read + written)", m.copy_gb_per_s);
    if m.operations.is_empty() {
        let _ = writeln!(t, "no kernel times: this device has no timestamps");
        return t;
    }
    let _ =
        writeln!(t, "{:24} {:>10} {:>7} {:>12} {:>9} {:>8}", "operation", "us", "share", "bytes", "GB/s", "of copy");
    for row in &m.operations {
        t.push_str(&text_row(row));
    }
    let total: f64 = m.operations.iter().map(|r| r.us).sum();
    let _ = writeln!(t, "{:24} {total:>10.1}", "sum of medians");
    t
}

/// Bytes of a MiB.
pub(crate) const MIB: f64 = 1_048_576.0;

pub(crate) fn text_row(row: &OperationRow) -> String {
    let bytes = row.bytes.map_or("-".into(), |b| b.to_string());
    let rate = row.gb_per_s.map_or("-".into(), |r| format!("{r:.2}"));
    let share = row.of_copy_bandwidth.map_or("-".into(), |r| format!("{:.0} %", 100.0 * r));
    format!("{:24} {:>10.1} {:>5.1} % {bytes:>12} {rate:>9} {share:>8}\n", row.label, row.us, 100.0 * row.share)
}

/// A page without references to anything outside.
pub fn html(record: &Value, m: &Measurement) -> String {
    let field = |pointer: &str| match record.pointer(pointer) {
        Some(Value::String(s)) => escape(s),
        Some(Value::Null) | None => "unknown".into(),
        Some(other) => escape(&other.to_string()),
    };
    let mut h = String::from(HEAD);
    let _ = writeln!(h, "<h1>spgs bench: {}</h1>", field("/device/name"));
    let _ = writeln!(h, "<table class=\"facts\">");
    let mut fact = |name: &str, value: String| {
        let _ = writeln!(h, "<tr><th>{name}</th><td>{value}</td></tr>");
    };
    fact("Device", format!("{} ({})", field("/device/name"), field("/device/kind")));
    fact("Driver", format!("{}, Vulkan {}", field("/device/driver"), field("/device/vulkan")));
    fact("Commit", field("/program/commit"));
    fact("Command", format!("<code>{}</code>", field("/command")));
    fact(
        "Scene",
        format!(
            "{}: {} Gaussians, SH degree {}, {} superpoints",
            field("/scene/name"),
            field("/scene/gaussians"),
            field("/scene/sh_degree"),
            field("/scene/superpoints")
        ),
    );
    fact("View", format!("{}×{} pixels, t {}", field("/view/width"), field("/view/height"), field("/view/times")));
    let f = m.frame_ms;
    fact("Frame", format!("{:.3} ms median, {:.3} p5, {:.3} p95 over {} frames", f.median, f.p5, f.p95, m.frames));
    let mut fps = format!("{:.1} one at a time, {:.1} with {} in flight", m.fps, m.fps_pipelined, m.frames_in_flight);
    if let Some(paper) = m.fps_paper_protocol {
        let _ = write!(fps, ", {paper:.1} by the paper's protocol");
    }
    fact("FPS", fps);
    fact("Work", format!("{} dispatches, {} barriers per frame", m.dispatches, m.barriers));
    fact(
        "Memory",
        format!("{:.0} bytes per Gaussian, {:.1} per tile instance", m.bytes_per_gaussian, m.bytes_per_instance),
    );
    fact("Copy bandwidth", format!("{:.1} GB/s", m.copy_gb_per_s));
    match record.pointer("/error_against_f64/psnr").and_then(Value::as_f64) {
        Some(psnr) => {
            fact("Error against f64", format!("PSNR {psnr:.1} dB, largest {}", field("/error_against_f64/max")))
        }
        None => fact("Error against f64", "not measured (--check)".into()),
    }
    h.push_str("</table>\n<h2>Device time of each operation, median, µs</h2>\n");
    h.push_str(&chart(&m.operations));
    h.push_str(&operations_table(&m.operations));
    h.push_str("</body></html>\n");
    h
}

/// Horizontal bars as SVG.
pub(crate) fn chart(rows: &[OperationRow]) -> String {
    const ROW: usize = 24;
    const LEFT: f64 = 220.0;
    const WIDTH: f64 = 560.0;
    let longest = rows.iter().map(|r| r.us).fold(1e-9, f64::max);
    let height = rows.len() * ROW + 4;
    let mut s = format!("<svg viewBox=\"0 0 900 {height}\" width=\"900\" height=\"{height}\" role=\"img\">\n");
    for (i, row) in rows.iter().enumerate() {
        let y = i * ROW;
        let width = (WIDTH * row.us / longest).max(1.0);
        let text_y = y + 16;
        let _ =
            writeln!(s, "<text x=\"{}\" y=\"{text_y}\" text-anchor=\"end\">{}</text>", LEFT - 8.0, escape(&row.label));
        let title = escape(row.doc.unwrap_or("transfer"));
        let _ = writeln!(
            s,
            "<rect x=\"{LEFT}\" y=\"{}\" width=\"{width:.1}\" height=\"{}\"><title>{title}</title></rect>",
            y + 3,
            ROW - 6
        );
        let _ = writeln!(s, "<text x=\"{:.1}\" y=\"{text_y}\">{:.1}</text>", LEFT + width + 6.0, row.us);
    }
    s.push_str("</svg>\n");
    s
}

pub(crate) fn operations_table(rows: &[OperationRow]) -> String {
    let mut t = String::from(
        "<table><tr><th>operation</th><th>µs</th><th>share</th><th>bytes</th><th>GB/s</th><th>of copy bandwidth</th><th>what it does</th></tr>\n",
    );
    for r in rows {
        let bytes = r.bytes.map_or("–".into(), |b| b.to_string());
        let rate = r.gb_per_s.map_or("–".into(), |x| format!("{x:.2}"));
        let share = r.of_copy_bandwidth.map_or("–".into(), |x| format!("{:.0} %", 100.0 * x));
        let _ = writeln!(
            t,
            "<tr><td>{}</td><td>{:.1}</td><td>{:.1} %</td><td>{bytes}</td><td>{rate}</td><td>{share}</td><td>{}</td></tr>",
            escape(&r.label),
            r.us,
            100.0 * r.share,
            escape(r.doc.unwrap_or("transfer"))
        );
    }
    t.push_str("</table>\n");
    t
}

/// Text that is safe inside HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Beginning of a page, up to its body.
pub(crate) const HEAD: &str = "<!doctype html>
<html lang=\"en\"><head><meta charset=\"utf-8\"><title>spgs bench</title>
<style>
body { font: 15px/1.45 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #1b1b1b; background: #fff; }
table { border-collapse: collapse; margin: 1rem 0; } th, td { padding: .25rem .7rem; border-bottom: 1px solid #ddd; text-align: right; }
th:first-child, td:first-child, th:last-child, td:last-child { text-align: left; }
table.facts th { white-space: nowrap; vertical-align: top; } svg { max-width: 100%; height: auto; } svg text { font-size: 13px; }
rect { fill: #3568a8; }
</style></head><body>
";

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    fn row(label: &str, us: f64) -> OperationRow {
        OperationRow {
            label: label.into(),
            kernel: None,
            doc: None,
            us,
            share: 0.5,
            bytes: Some(10),
            gb_per_s: None,
            of_copy_bandwidth: None,
        }
    }

    #[test]
    fn bars_are_in_proportion_and_text_is_escaped() {
        let svg = chart(&[row("a<b>&\"", 100.0), row("half", 50.0)]);
        assert!(svg.contains("a&lt;b&gt;&amp;&quot;") && !svg.contains("a<b>"));
        assert!(svg.contains("width=\"560.0\"") && svg.contains("width=\"280.0\""), "{svg}");
    }

    #[test]
    fn an_empty_list_is_an_empty_chart() {
        assert!(!chart(&[]).contains("rect"));
        assert!(text_row(&row("x", 1.0)).contains("50.0 %"));
    }
}
