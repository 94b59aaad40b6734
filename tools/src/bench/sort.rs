//! `spgs bench sort`: the radix sort by itself, beside the device's copy rate.

use engine::error::{Error, Result};
use engine::gpu::Gpu;
use engine::render::radix_sort::DeviceSort;
use engine::scene::synthetic::Random;
use serde::Serialize;
use serde_json::{Value, json};

use crate::cli::args::{Global, SortArgs};
use crate::cli::{gpu_session, output, progress};
use crate::report::measure::Quantiles;
use crate::report::page::{Align, Axis, Chart, Mark, Page, Series, Table, field};
use crate::report::provenance;

/// Bits of a key that are sorted.
const KEY_BITS: u32 = 32;
/// Bytes that a sort must move per key: it is counted once, then key and value are read and written in each of four passes.
const BYTES_PER_KEY: f64 = 4.0 + 4.0 * 16.0;

/// A sort of so many keys.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Row {
    pub(super) keys: usize,
    dispatches: usize,
    /// Device time, milliseconds.
    ms: Quantiles,
    pub(super) keys_per_s: f64,
    /// Bytes that must be moved over the median time, GB/s.
    gb_per_s: f64,
    pub(super) of_copy_bandwidth: f64,
}

/// Measures and reports.
///
/// # Errors
/// Those of the device; `Kernel` when the keys come back unsorted.
pub fn run(args: &SortArgs, global: &Global) -> Result<()> {
    let gpu = gpu_session::open(global)?;
    let copy = engine::render::copy_rate::copy_rate(&gpu)?;
    let bar = progress::bar((args.keys.len() as u64) * u64::from(args.runs + 1), global.quiet);
    let mut rows = Vec::new();
    for &keys in &args.keys {
        rows.push(measure(&gpu, keys as usize, args.runs, copy, &|| bar.inc(1))?);
    }
    bar.finish_and_clear();
    gpu_session::report_validation(&gpu);
    let record = provenance::record(Some("sort"), &gpu, numbers(copy, &rows));
    args.results.write(&record, || html(&record, &rows))?;
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("copies  {copy:.1} GB/s (device to device, read + written)"));
        output::line(table(&rows).text().trim_end());
    }
    Ok(())
}

/// Sorts `count` keys `runs` times after a first, checked one. `copy`: rate of copies, GB/s; `tick` is called after each.
///
/// # Errors
/// Those of the device; `Kernel` when the keys come back unsorted.
pub(super) fn measure(gpu: &Gpu, count: usize, runs: u32, copy: f64, tick: &dyn Fn()) -> Result<Row> {
    let mut random = Random::new(count as u64);
    let keys: Vec<u32> = (0..count).map(|_| random.bits() as u32).collect();
    let mut sort = DeviceSort::new(gpu, &keys, KEY_BITS)?;
    // The first run compiles the kernels; its result is looked at.
    sort.run()?;
    check(&keys, &sort.download()?)?;
    tick();
    let mut ms = Vec::new();
    for _ in 0..runs {
        ms.push(sort.run()? / 1e3);
        tick();
    }
    let ms = Quantiles::of(ms);
    let rate = count as f64 / (ms.median / 1e3).max(1e-9);
    let gb_per_s = rate * BYTES_PER_KEY / 1e9;
    Ok(Row {
        keys: count,
        dispatches: sort.dispatches(),
        ms,
        keys_per_s: rate,
        gb_per_s,
        of_copy_bandwidth: gb_per_s / copy,
    })
}

/// For a record.
pub(super) fn numbers(copy: f64, rows: &[Row]) -> Value {
    json!({ "copy_gb_per_s": copy, "key_bits": KEY_BITS, "sorts": rows })
}

/// The result must be the keys in order, and of equal ones the first first.
fn check(keys: &[u32], [sorted, positions]: &[Vec<u32>; 2]) -> Result<()> {
    let mut expected: Vec<u64> = keys.iter().zip(0..).map(|(&key, at)| u64::from(key) << 32 | at).collect();
    expected.sort_unstable();
    let found = sorted.iter().zip(positions).map(|(&key, &at)| u64::from(key) << 32 | u64::from(at));
    match expected.iter().zip(found).position(|(&expected, found)| expected != found) {
        None => Ok(()),
        Some(at) => Err(Error::Kernel {
            kernel: "sort_scatter".into(),
            why: format!(
                "of {} keys it puts {:#x} of position {} at place {at}, expected {:#x} of position {}",
                keys.len(),
                sorted[at],
                positions[at],
                expected[at] >> 32,
                expected[at] as u32
            ),
        }),
    }
}

/// One row per size.
pub(super) fn table(rows: &[Row]) -> Table {
    let columns = ["keys", "dispatches", "ms", "million keys/s", "GB/s", "of copy"];
    let mut table = Table::new(&columns.map(|c| (c, Align::Right)));
    for row in rows {
        table.row([
            row.keys.to_string(),
            row.dispatches.to_string(),
            format!("{:.3}", row.ms.median),
            format!("{:.1}", row.keys_per_s / 1e6),
            format!("{:.2}", row.gb_per_s),
            format!("{:.0} %", 100.0 * row.of_copy_bandwidth),
        ]);
    }
    table
}

fn html(record: &Value, rows: &[Row]) -> Result<String> {
    let mut page = Page::new("spgs bench sort");
    page.provenance(record);
    page.facts(&[("Copies", format!("{} GB/s", field(record, "/copy_gb_per_s")))]);
    page.table(&table(rows));
    let points = rows.iter().map(|r| (r.keys as f64, r.keys_per_s / 1e6)).collect();
    page.chart(
        &Chart::new("Sorting keys of 32 bits with values", Axis::log("keys"), Axis::linear("million keys/s"))
            .series(Series::new("radix sort", Mark::LineAndPoints, points)),
    )?;
    Ok(page.finish())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn a_wrong_sort_is_told() {
        let keys = [7, 3, 7];
        assert!(check(&keys, &[vec![3, 7, 7], vec![1, 0, 2]]).is_ok());
        let unstable = check(&keys, &[vec![3, 7, 7], vec![1, 2, 0]]).unwrap_err().to_string();
        assert!(unstable.contains("0x7 of position 2 at place 1, expected 0x7 of position 0"), "{unstable}");
        assert!(check(&keys, &[vec![7, 3, 7], vec![0, 1, 2]]).is_err());
    }
}
