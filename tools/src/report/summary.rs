//! A measurement as text for the terminal and as a self-contained page with a bar chart.

use std::fmt::Write as _;

use serde_json::Value;

use crate::report::measure::{Measurement, OperationRow};
use crate::report::page::{self, Align, Bar, Page, Table};

/// The table that `bench` and `demo` print.
pub fn text(m: &Measurement) -> String {
    let mut t = String::new();
    let f = m.frame_ms;
    let _ = writeln!(t, "frame   {:.3} ms median, {:.3} p5, {:.3} p95 over {} frames", f.median, f.p5, f.p95, m.frames);
    if let Some(d) = m.device_ms {
        let _ = writeln!(t, "device  {:.3} ms median, {:.3} p5, {:.3} p95", d.median, d.p5, d.p95);
    }
    let _ = writeln!(t, "FPS     {}", rates(m));
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

fn rates(m: &Measurement) -> String {
    let beside: String =
        m.fps_side_by_side.iter().map(|b| format!(", {:.1} with {} side by side", b.fps, b.frames)).collect();
    format!("{:.1} one at a time, {:.1} with {} in flight{beside}", m.fps, m.fps_pipelined, m.frames_in_flight)
}

/// Bytes of a MiB.
pub(crate) const MIB: f64 = 1_048_576.0;

pub(crate) fn text_row(row: &OperationRow) -> String {
    let bytes = row.bytes.map_or("-".into(), |b| b.to_string());
    let rate = row.gb_per_s.map_or("-".into(), |r| format!("{r:.2}"));
    let share = row.of_copy_bandwidth.map_or("-".into(), |r| format!("{:.0} %", 100.0 * r));
    format!("{:24} {:>10.1} {:>5.1} % {bytes:>12} {rate:>9} {share:>8}\n", row.label, row.us, 100.0 * row.share)
}

/// A page without references to anything outside, to be finished by the caller.
pub fn begin_page(record: &Value, m: &Measurement) -> Page {
    let field = |pointer: &str| page::field(record, pointer);
    let mut page = Page::new(&format!("spgs bench: {}", field("/device/name")));
    page.provenance(record);
    let f = m.frame_ms;
    let mut fps = rates(m);
    if let Some(paper) = m.fps_paper_protocol {
        let _ = write!(fps, ", {paper:.1} by the paper's protocol");
    }
    let error = match record.pointer("/error_against_f64/psnr").and_then(Value::as_f64) {
        Some(psnr) => format!("PSNR {psnr:.1} dB, largest {}", field("/error_against_f64/max")),
        None => "not measured (--check)".into(),
    };
    page.facts(&[
        (
            "Scene",
            format!(
                "{}: {} Gaussians, SH degree {}, {} superpoints",
                field("/scene/name"),
                field("/scene/gaussians"),
                field("/scene/sh_degree"),
                field("/scene/superpoints")
            ),
        ),
        ("View", format!("{}×{} pixels, t {}", field("/view/width"), field("/view/height"), field("/view/times"))),
        ("Frame", format!("{:.3} ms median, {:.3} p5, {:.3} p95 over {} frames", f.median, f.p5, f.p95, m.frames)),
        ("FPS", fps),
        ("Work", format!("{} dispatches, {} barriers per frame", m.dispatches, m.barriers)),
        (
            "Memory",
            format!("{:.0} bytes per Gaussian, {:.1} per tile instance", m.bytes_per_gaussian, m.bytes_per_instance),
        ),
        ("Copy bandwidth", format!("{:.1} GB/s", m.copy_gb_per_s)),
        ("Error against f64", error),
    ]);
    page.heading("Device time of each operation, median, µs");
    operations(&mut page, &m.operations);
    page
}

/// Bars and table of operations.
pub(crate) fn operations(page: &mut Page, rows: &[OperationRow]) {
    let bar = |r: &OperationRow| Bar {
        label: r.label.clone(),
        value: r.us,
        text: format!("{:.1}", r.us),
        hint: r.doc.unwrap_or("transfer").to_owned(),
    };
    page.bars(&rows.iter().map(bar).collect::<Vec<_>>());
    let (l, r) = (Align::Left, Align::Right);
    let columns = [
        ("operation", l),
        ("µs", r),
        ("share", r),
        ("bytes", r),
        ("GB/s", r),
        ("of copy bandwidth", r),
        ("what it does", l),
    ];
    let mut table = Table::new(&columns);
    for row in rows {
        table.row([
            row.label.clone(),
            format!("{:.1}", row.us),
            format!("{:.1} %", 100.0 * row.share),
            row.bytes.map_or("–".into(), |b| b.to_string()),
            row.gb_per_s.map_or("–".into(), |x| format!("{x:.2}")),
            row.of_copy_bandwidth.map_or("–".into(), |x| format!("{:.0} %", 100.0 * x)),
            row.doc.unwrap_or("transfer").to_owned(),
        ]);
    }
    page.table(&table);
}

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
    fn an_operation_is_a_bar_and_a_row() {
        let mut page = Page::new("t");
        operations(&mut page, &[row("a<b", 100.0), row("half", 50.0)]);
        let html = page.finish();
        assert!(html.matches("<rect").count() == 2 && html.matches("a&lt;b").count() == 2, "{html}");
        assert!(text_row(&row("x", 1.0)).contains("50.0 %"));
    }
}
