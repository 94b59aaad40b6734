//! A prediction as text and on a page.

use std::fmt::Write as _;

use super::profile::PROFILES;
use super::times::{Goal, Kind, OnGpu, Operation, Predicted};
use crate::report::measure::OperationRow;
use crate::report::page::{Align, Page, Table};

const MODEL: &str = "A model, not a measurement: bytes over bandwidth, instructions over issue rate, atomics, latency of one \
                     subgroup, and the time from an operation to one that depends on it. Instructions are those of Mesa's \
                     compilers for Turing and Navi 31 (spgs-dev isa). Work and grids were recorded on this device; where a CPU keeps \
                     gradients by instance, the GPUs get the kernel with float atomics.";

/// A line for each GPU; with `inputs` all that the model was given.
pub(crate) fn text(p: &Predicted, inputs: bool) -> String {
    let mut t = String::from("predicted, not measured (--predict shows the inputs)\n");
    for gpu in &p.gpus {
        let _ = writeln!(t, "  {:12} {}", gpu.gpu, line(p.of, gpu));
    }
    if inputs {
        let _ = writeln!(t, "\n{MODEL}\n\n{}", facts(p));
        let _ = writeln!(t, "\n{}", constants().text());
        PROFILES.iter().for_each(|p| t.push_str(&format!("data sheet of {}: {}\n", p.name, p.sheet)));
        for a in &p.loops {
            let _ = writeln!(t, "assumed: {} takes {}", a.round, a.instructions);
        }
        for gpu in &p.gpus {
            let _ = writeln!(t, "\n{}\n{}", gpu.gpu, operations(gpu).text().trim_end());
        }
    }
    t
}

/// The prediction as a section of a page, beside the operations that this device was measured with.
pub(crate) fn section(page: &mut Page, p: &Predicted, device: &str, measured: &[OperationRow]) {
    page.subheading("Predicted");
    summary(page, p);
    page.table(&beside(p, device, measured));
    model(page);
    let assumed: Vec<String> = p.loops.iter().map(|a| format!("{}: {}", a.round, a.instructions)).collect();
    page.text(&format!("Assumed of loops: {}.", assumed.join("; ")));
    for gpu in &p.gpus {
        page.subheading(&format!("Predicted on {}", gpu.gpu));
        page.table(&operations(gpu));
    }
}

/// The figure of each GPU, and what was recorded.
pub(crate) fn summary(page: &mut Page, p: &Predicted) {
    let rows: Vec<(&str, String)> = p.gpus.iter().map(|g| (g.gpu, line(p.of, g))).collect();
    page.facts(&rows);
    page.text(&facts(p));
}

/// Measured operations beside the predicted ones of the same name, on the GPU of the device's name or the first one.
pub(crate) fn beside(p: &Predicted, device: &str, rows: &[OperationRow]) -> Table {
    let (l, r) = (Align::Left, Align::Right);
    let Some((gpu, _)) = p.beside(device) else { return Table::new(&[("operation", l)]) };
    let predicted = format!("predicted on {}, µs", gpu.gpu);
    let mut table = Table::new(&[("operation", l), ("measured here, µs", r), (&predicted, r), ("limited by", l)]);
    for row in rows {
        // Rows of several dispatches are called `kernel ×n`.
        let name = row.label.split(" ×").next().unwrap_or_default();
        let same = |o: &&Operation| o.demand.label == name || row.kernel == Some(name) && o.demand.is_of(name);
        let us: f64 = gpu.operations.iter().filter(same).map(|o| o.cost.us).sum();
        let longest = gpu.operations.iter().filter(same).max_by(|a, b| a.cost.us.total_cmp(&b.cost.us));
        table.row([
            row.label.clone(),
            format!("{:.1}", row.us),
            longest.map_or("–".into(), |_| format!("{us:.2}")),
            longest.map_or(String::new(), |o| o.cost.limited_by.to_owned()),
        ]);
    }
    table
}

/// The model and its constants.
pub(crate) fn model(page: &mut Page) {
    page.text(MODEL);
    page.table(&constants());
    let sheets: Vec<(&str, String)> = PROFILES.iter().map(|p| (p.name, p.sheet.to_owned())).collect();
    page.facts(&sheets);
}

/// The figure of a GPU.
fn line(of: Kind, gpu: &OnGpu) -> String {
    let (device, alone, rate) = (gpu.device_ms, gpu.one_at_a_time_ms, gpu.per_second);
    let figure = match of {
        Kind::Frame => {
            let beside: String =
                gpu.side_by_side.iter().map(|b| format!(", {:.0} with {} side by side", b.fps, b.frames)).collect();
            format!("{device:.3} ms on the device: {rate:.0} FPS in flight, {:.0} one at a time{beside}", 1e3 / alone)
        }
        Kind::Step => format!("{device:.3} ms on the device, {alone:.3} ms per step: {rate:.0} steps/s"),
    };
    figure + &gpu.goal.as_ref().map_or(String::new(), verdict)
}

fn verdict(goal: &Goal) -> String {
    format!("; goal {}: {}", goal.what, if goal.met { "reached" } else { "MISSED" })
}

/// What was recorded and counted, and what was not.
fn facts(p: &Predicted) -> String {
    let uncounted = p.gpus.first().map_or(Vec::new(), |g| uncounted(&g.operations));
    let mut text = format!(
        "Recorded: {} dispatches, {} barriers. Counted on the CPU for the first view: splats reach {:.0} % of the 8×8 subtiles of their tiles, and {:.0} % of these pairs are blended before the subtile is opaque; the longest list of a tile is {:.1} times the mean one.",
        p.dispatches,
        p.barriers,
        100.0 * p.subtiles.reached,
        100.0 * p.subtiles.blended,
        p.subtiles.longest
    );
    if !uncounted.is_empty() {
        let _ = write!(text, " Rounds of loops were not counted in {}: a lower bound.", uncounted.join(", "));
    }
    text
}

/// Kernels whose loops are counted once.
fn uncounted(operations: &[Operation]) -> Vec<&str> {
    let of = |o: &'_ Operation| o.demand.dispatch.as_ref().is_some_and(|d| d.uncounted_loop);
    let mut names: Vec<&str> = operations.iter().filter(|o| of(o)).map(|o| o.demand.label.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    names
}

/// One row per constant, one column per GPU.
fn constants() -> Table {
    let mut columns = vec![("constant", Align::Left)];
    columns.extend(PROFILES.iter().map(|p| (p.name, Align::Right)));
    columns.extend([("unit", Align::Left), ("source", Align::Left)]);
    let mut table = Table::new(&columns);
    let all = PROFILES.map(|p| p.constants());
    for (i, first) in all[0].iter().enumerate() {
        let mut sources: Vec<&str> = all.iter().map(|constants| constants[i].source).collect();
        sources.dedup();
        let mut cells = vec![first.name.to_owned()];
        cells.extend(all.iter().map(|constants| constants[i].value.to_string()));
        cells.extend([first.unit.to_owned(), sources.join("; ")]);
        table.row(cells);
    }
    table
}

/// One row per operation.
fn operations(gpu: &OnGpu) -> Table {
    let (l, r) = (Align::Left, Align::Right);
    let mut table = Table::new(&[
        ("operation", l),
        ("waits", l),
        ("µs", r),
        ("limited by", l),
        ("bytes, µs", r),
        ("issue, µs", r),
        ("atomics, µs", r),
        ("latency, µs", r),
        ("bytes", r),
        ("workgroups", r),
        ("instructions", r),
        ("issued", r),
        ("compiled as", l),
    ]);
    for Operation { demand: d, cost: c } in &gpu.operations {
        let us = |v: f64| format!("{v:.2}");
        let of = |f: fn(&super::demand::DispatchDemand) -> String| d.dispatch.as_ref().map_or("–".into(), f);
        table.row([
            d.label.clone(),
            if d.barrier { "yes" } else { "" }.to_owned(),
            us(c.us),
            c.limited_by.to_owned(),
            us(c.bytes_us),
            us(c.issue_us),
            us(c.atomics_us),
            us(c.latency_us),
            format!("{:.0}", d.bytes),
            of(|d| format!("{:.0}", d.workgroups)),
            of(|d| d.instructions.to_string()),
            of(|d| format!("{:.2e}", d.issued)),
            of(|d| d.compiled.clone()),
        ]);
    }
    let total = 1e3 * gpu.device_ms;
    table.row(["sum".to_owned(), String::new(), format!("{total:.2}")]);
    table
}
