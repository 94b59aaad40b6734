//! The self-test of the device: kernels of frames, networks, fields and training against their CPU twins, at every subgroup size that
//! the device can be pinned to. What no suite of it runs (LPIPS, stores into a host's image) is for the integration tests.

use std::time::Instant;

use engine::error::Result;
use engine::gpu::{DeviceInfo, Gpu, GpuOptions, SelfTest};
use engine::self_test::Suite;
use serde::Serialize;
use serde_json::json;

use super::clock::Context;
use super::outcome::{Done, Figure, Outcome};
use crate::cli::gpu_session;
use crate::report::page::{Align, Page, Standing, Table};
use crate::report::provenance;

/// A suite at a subgroup size.
#[derive(Debug, Serialize)]
struct Row {
    /// The size that was asked for; none: the engine's own choice for each kernel.
    subgroup_size: Option<u32>,
    suite: &'static str,
    passed: bool,
    why: Option<String>,
    seconds: f64,
}

/// Runs every suite at every size while there is time.
pub(super) fn run(context: &Context<'_>) -> Result<Done> {
    let gpu = context.open()?;
    let (mut rows, mut left_out, mut failure) = (Vec::new(), Vec::new(), None);
    for size in sizes(gpu.info()) {
        let options = GpuOptions {
            subgroup_size: size,
            self_test: SelfTest::Skip,
            training: true,
            ..gpu_session::options(context.global)
        };
        let tested = Gpu::open(&options)?;
        for suite in Suite::ALL {
            let name = name(size, suite);
            if !suite.fits(tested.info()) {
                left_out.push(format!("{name}: the device lacks what it needs"));
                continue;
            }
            if !rows.is_empty() && context.clock.left().is_zero() {
                left_out.push(format!("{name}: no time"));
                continue;
            }
            let start = Instant::now();
            let verdict = tested.self_test(suite);
            let why = verdict.as_ref().err().map(ToString::to_string);
            let seconds = start.elapsed().as_secs_f64();
            rows.push(Row { subgroup_size: size, suite: suite.name(), passed: why.is_none(), why, seconds });
            failure = failure.or(verdict.err());
            context.tick();
        }
    }
    let passed = rows.iter().filter(|r| r.passed).count();
    let figures = vec![Figure::new(format!("suites passed, of {}", rows.len()), "", passed as f64)];
    let record = provenance::record(Some("self_tests"), &gpu, json!({ "suites": rows, "left_out": left_out }));
    let section = Box::new(move |page: &mut Page| {
        page.table(&table(&rows));
        Ok(())
    });
    Ok(Done::Ran(Box::new(Outcome { record, figures, reduced: left_out, failure, section })))
}

fn name(size: Option<u32>, suite: Suite) -> String {
    let at = size.map_or("the chosen subgroup sizes".to_owned(), |s| format!("subgroups of {s}"));
    format!("suite {} at {at}", suite.name())
}

/// The engine's choice first, then every size that some kernel can be pinned to.
fn sizes(info: &DeviceInfo) -> Vec<Option<u32>> {
    let powers = (2..=7).map(|bit| 1_u32 << bit);
    let pinned = powers.filter(|size| engine::kernels().any(|k| info.can_pin(*size, k.local_size)));
    [None].into_iter().chain(pinned.map(Some)).collect()
}

fn table(rows: &[Row]) -> Table {
    let (l, r) = (Align::Left, Align::Right);
    let mut table = Table::new(&[("subgroups", r), ("suite", l), ("result", l), ("s", r)]);
    for row in rows {
        let standing = if row.passed { Standing::Good } else { Standing::Bad };
        table.marked(
            standing,
            [
                row.subgroup_size.map_or("chosen".to_owned(), |s| s.to_string()),
                row.suite.to_owned(),
                row.why.clone().unwrap_or("passed".into()),
                format!("{:.2}", row.seconds),
            ],
        );
    }
    table
}
