//! A training measurement as text for the terminal and as a self-contained page.

use std::fmt::Write as _;

use serde_json::Value;

use super::measure::TrainMeasurement;
use crate::bench::prediction;
use crate::report::page::{self, Align, Page, Table};
use crate::report::summary::{MIB, operations, text_row};

/// What `bench train` prints of a training set; with `rows` also its kernels.
pub(super) fn text(record: &Value, m: &TrainMeasurement, rows: bool, inputs: bool) -> String {
    let mut t = format!("scene   {}\n", title(record));
    for (name, value) in facts(m) {
        let _ = writeln!(t, "{name:7} {value}");
    }
    if rows && m.kernels.is_empty() {
        t.push_str("no kernel times: this device has no timestamps\n");
    } else if rows {
        let _ =
            writeln!(t, "{:24} {:>10} {:>7} {:>12} {:>9} {:>8}", "kernel", "us", "share", "bytes", "GB/s", "of copy");
        m.kernels.iter().for_each(|row| t.push_str(&text_row(row)));
    }
    if let Some(predicted) = &m.predicted {
        t.push_str(&prediction::report::text(predicted, inputs));
    }
    t
}

fn title(record: &Value) -> String {
    let of = |pointer: &str| page::field(record, pointer);
    format!(
        "{}: {} Gaussians of SH degree {}, {} superpoints, {} photos of {}×{} pixels",
        of("/scene/name"),
        of("/scene/gaussians"),
        of("/scene/sh_degree"),
        of("/scene/superpoints"),
        of("/photos/count"),
        of("/photos/width"),
        of("/photos/height")
    )
}

fn facts(m: &TrainMeasurement) -> Vec<(&'static str, String)> {
    let (s, mib) = (m.step_ms, |bytes: u64| bytes as f64 / MIB);
    let cpu = m.cpu_ms.map_or(String::new(), |c| format!(", {c:.0} ms of processor time"));
    let device = m
        .device_ms
        .map_or("unknown".into(), |d| format!("{:.3} ms median, {:.3} p5, {:.3} p95", d.median, d.p5, d.p95));
    let quantiles = format!("{:.3} ms median, {:.3} p5, {:.3} p95 over {} steps{cpu}", s.median, s.p5, s.p95, m.steps);
    vec![
        ("step", quantiles),
        ("device", device),
        ("rate", format!("{:.2} steps/s with several in flight, {:.3} ms each", m.steps_per_second, m.in_flight_ms)),
        ("work", format!("{} dispatches, {} barriers per step", m.dispatches, m.barriers)),
        ("", format!("{} visible Gaussians, {} tile instances", m.last_step.visible, m.last_step.instances)),
        (
            "memory",
            format!(
                "{:.1} MiB of parameters, {:.1} of moments and gradients ({:.2} times), {:.1} of images, {:.1} of the rest",
                mib(m.memory.parameters),
                mib(m.memory.moments + m.memory.gradients),
                m.state_ratio,
                mib(m.memory.images),
                mib(m.memory.other)
            ),
        ),
        ("loss", format!("{:.5} at first, {:.5} at last", m.first_step.loss, m.last_step.loss)),
        ("copies", format!("{:.1} GB/s (device to device, read + written)", m.copy_gb_per_s)),
    ]
}

/// A page without references to anything outside.
pub(super) fn html(record: &Value, cases: &[(Value, TrainMeasurement)]) -> String {
    let mut page = Page::new(&format!("spgs bench train: {}", page::field(record, "/device/name")));
    page.provenance(record);
    let device = page::field(record, "/device/name");
    if cases.len() > 1 {
        page.table(&sweep_table(cases));
    }
    for (record, m) in cases {
        page.heading(&title(record));
        page.facts(&facts(m));
        page.subheading("Device time of each kernel in a step, median, µs");
        operations(&mut page, &m.kernels);
        if let Some(predicted) = &m.predicted {
            prediction::report::section(&mut page, predicted, &device, &m.kernels);
        }
    }
    page.finish()
}

/// One row per training set.
fn sweep_table(cases: &[(Value, TrainMeasurement)]) -> Table {
    let columns = ["Gaussians", "pixels", "ms per step", "device ms", "state / parameters"].map(|c| (c, Align::Right));
    let mut table = Table::new(&[&columns[..], &[("slowest kernel", Align::Left)]].concat());
    for (record, m) in cases {
        let number = |pointer: &str| record.pointer(pointer).and_then(Value::as_u64).unwrap_or(0);
        let slowest = m.kernels.iter().max_by(|a, b| a.us.total_cmp(&b.us));
        table.row([
            number("/scene/gaussians").to_string(),
            format!("{}×{}", number("/photos/width"), number("/photos/height")),
            format!("{:.2}", m.step_ms.median),
            format!("{:.2}", m.device_ms.map_or(f64::NAN, |d| d.median)),
            format!("{:.2}", m.state_ratio),
            slowest.map_or(String::new(), |r| format!("{} ({:.0} %)", r.label, 100.0 * r.share)),
        ]);
    }
    table
}
