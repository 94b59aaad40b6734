//! The radix sort at the sizes of `spgs bench sort`, while there is time.

use std::time::Instant;

use engine::error::Result;

use super::clock::Context;
use super::outcome::{Done, Figure, Outcome};
use crate::bench::sort;
use crate::report::page::Page;
use crate::report::provenance;

/// Keys.
const KEYS: [u32; 3] = [1 << 17, 1 << 20, 1 << 25];
/// Runs of each, after a first one.
const RUNS: u32 = 5;

/// Sorts, checks and times.
pub(super) fn run(context: &Context<'_>) -> Result<Done> {
    let gpu = context.open()?;
    let copy = engine::render::copy_rate::copy_rate(&gpu)?;
    let (mut rows, mut reduced) = (Vec::new(), Vec::new());
    let mut seconds_per_key = 0.0;
    for keys in KEYS {
        let expected = seconds_per_key * f64::from(keys);
        if expected > context.clock.left().as_secs_f64() {
            reduced.push(format!("not {keys} keys: they would take about {expected:.0} s"));
            continue;
        }
        let start = Instant::now();
        rows.push(sort::measure(&gpu, keys as usize, RUNS, copy, &|| context.tick())?);
        seconds_per_key = start.elapsed().as_secs_f64() / f64::from(keys);
    }
    let of = |row: &sort::Row| Figure::new(format!("{} keys", row.keys), "million keys/s", row.keys_per_s / 1e6);
    let mut figures: Vec<Figure> = rows.iter().map(of).collect();
    if let Some(last) = rows.last() {
        figures.push(Figure::new(format!("{} keys, of the copy rate", last.keys), "%", 100.0 * last.of_copy_bandwidth));
    }
    let record = provenance::record(Some("sort"), &gpu, sort::numbers(copy, &rows));
    let section = Box::new(move |page: &mut Page| {
        page.text(&format!("Copies: {copy:.1} GB/s (read and written)."));
        page.table(&sort::table(&rows));
        Ok(())
    });
    Ok(Done::Ran(Box::new(Outcome { record, figures, reduced, failure: None, section })))
}
