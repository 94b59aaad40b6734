//! A training measurement as text for the terminal and as a self-contained page.

use std::fmt::Write as _;

use serde_json::Value;

use super::measure::TrainMeasurement;
use crate::report::{HEAD, MIB, chart, escape, operations_table, text_row};

/// What `bench --train` prints of a training set; with `rows` also its kernels.
pub(super) fn text(record: &Value, m: &TrainMeasurement, rows: bool) -> String {
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
    t
}

fn title(record: &Value) -> String {
    let of = |pointer: &str| match record.pointer(pointer) {
        Some(Value::String(s)) => s.clone(),
        other => other.map_or("unknown".into(), Value::to_string),
    };
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
        ("rate", format!("{:.2} steps/s", m.steps_per_second)),
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
    let field = |pointer: &str| match record.pointer(pointer) {
        Some(Value::String(s)) => escape(s),
        Some(Value::Null) | None => "unknown".into(),
        Some(other) => escape(&other.to_string()),
    };
    let mut h = String::from(HEAD);
    let _ = writeln!(h, "<h1>spgs bench --train: {}</h1>\n<table class=\"facts\">", field("/device/name"));
    let fact = |h: &mut String, name: &str, value: &str| {
        let _ = writeln!(h, "<tr><th>{name}</th><td>{value}</td></tr>");
    };
    fact(&mut h, "Driver", &format!("{}, Vulkan {}", field("/device/driver"), field("/device/vulkan")));
    fact(&mut h, "Commit", &field("/program/commit"));
    fact(&mut h, "Command", &format!("<code>{}</code>", field("/command")));
    h.push_str("</table>\n");
    if cases.len() > 1 {
        h.push_str(&sweep_table(cases));
    }
    for (record, m) in cases {
        let _ = writeln!(h, "<h2>{}</h2>\n<table class=\"facts\">", escape(&title(record)));
        facts(m).iter().for_each(|(name, value)| fact(&mut h, name, &escape(value)));
        h.push_str("</table>\n<h3>Device time of each kernel in a step, median, µs</h3>\n");
        h.push_str(&chart(&m.kernels));
        h.push_str(&operations_table(&m.kernels));
    }
    h.push_str("</body></html>\n");
    h
}

/// One row per training set.
fn sweep_table(cases: &[(Value, TrainMeasurement)]) -> String {
    let mut t = String::from(
        "<table><tr><th>Gaussians</th><th>pixels</th><th>ms per step</th><th>device ms</th><th>state / parameters</th><th>slowest kernel</th></tr>\n",
    );
    for (record, m) in cases {
        let number = |pointer: &str| record.pointer(pointer).and_then(Value::as_u64).unwrap_or(0);
        let slowest = m.kernels.iter().max_by(|a, b| a.us.total_cmp(&b.us));
        let _ = writeln!(
            t,
            "<tr><td>{}</td><td>{}×{}</td><td>{:.2}</td><td>{:.2}</td><td>{:.2}</td><td>{}</td></tr>",
            number("/scene/gaussians"),
            number("/photos/width"),
            number("/photos/height"),
            m.step_ms.median,
            m.device_ms.map_or(f64::NAN, |d| d.median),
            m.state_ratio,
            slowest.map_or(String::new(), |r| format!("{} ({:.0} %)", escape(&r.label), 100.0 * r.share))
        );
    }
    t.push_str("</table>\n");
    t
}
