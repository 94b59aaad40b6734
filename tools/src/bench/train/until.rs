//! `spgs bench train --until-psnr X --cameras DATA`: iterations per second and time to a PSNR of a real run.

use engine::error::{Error, Result};
use serde_json::{Value, json};

use super::session::{Milestone, Session, Timed, Until};
use crate::cli::args::{Global, TrainBenchArgs};
use crate::cli::{gpu_session, output, progress};
use crate::report::page::{Align, Axis, Chart, Mark, Page, Series, Table, field};
use crate::report::provenance;

/// Iterations of a run where the arguments do not say: the paper's.
const ITERATIONS: u64 = 40_000;
/// Evaluations on the way.
const EVALUATIONS: u64 = 40;

/// Trains, times, reports.
pub(super) fn run(args: &TrainBenchArgs, global: &Global, wanted: f64) -> Result<()> {
    let Some(path) = &args.cameras else {
        return Err(Error::usage("--until-psnr", "no data set", "--cameras DATA"));
    };
    let gpu = gpu_session::open_to_train(global)?;
    let session = Session::new(&gpu, path, args.downscale)?;
    let config = session.config(args.iterations.unwrap_or(ITERATIONS));
    let bar = progress::training(config.iterations, 0, global.quiet);
    let (timed, _) = session.run(&config, Until { psnr: Some(wanted), end: None }, EVALUATIONS, &|| bar.inc(1))?;
    bar.finish_and_clear();
    gpu_session::report_validation(&gpu);
    let numbers = json!({
        "data": path,
        "views": session.describe(),
        "iterations": config.iterations,
        "wanted_psnr": wanted,
        "run": timed,
    });
    let record = provenance::record(Some("until_psnr"), &gpu, numbers);
    args.results.write(&record, || html(&record, &timed, wanted))?;
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("data    {}: {}", path.display(), session.describe()));
        output::line(table(&timed).text().trim_end());
        output::line(&verdict(&timed, wanted));
    }
    Ok(())
}

fn verdict(timed: &Timed, wanted: f64) -> String {
    let rate = format!(
        "{:.2} iterations/s, {:.2} ms median, {:.2} p95",
        timed.iterations_per_second, timed.step_ms.median, timed.step_ms.p95
    );
    match timed.seconds_to_psnr {
        Some(seconds) => format!("{wanted} dB after {seconds:.1} s of training; {rate}"),
        None => format!(
            "{wanted} dB not reached: {:.2} dB after {:.1} s; {rate}",
            timed.last().map_or(f64::NAN, |m| m.psnr),
            timed.seconds
        ),
    }
}

/// One row per evaluation.
pub(crate) fn table(timed: &Timed) -> Table {
    let columns = ["iteration", "seconds", "PSNR, dB", "SSIM", "Gaussians"].map(|n| (n, Align::Right));
    let mut table = Table::new(&columns);
    for m in &timed.milestones {
        table.row([
            m.iteration.to_string(),
            format!("{:.1}", m.seconds),
            format!("{:.2}", m.psnr),
            format!("{:.4}", m.ssim),
            m.gaussians.to_string(),
        ]);
    }
    table
}

fn html(record: &Value, timed: &Timed, wanted: f64) -> Result<String> {
    let mut page = Page::new("spgs bench train --until-psnr");
    page.provenance(record);
    page.facts(&[
        ("Data", field(record, "/data")),
        ("Views", field(record, "/views")),
        ("Result", verdict(timed, wanted)),
    ]);
    let of = |f: fn(&Milestone) -> f64| timed.milestones.iter().map(|m| (m.seconds, f(m))).collect();
    page.chart(
        &Chart::new("PSNR on held-out views", Axis::linear("training time, s"), Axis::linear("PSNR, dB"))
            .series(Series::new("PSNR", Mark::LineAndPoints, of(|m| m.psnr))),
    )?;
    page.table(&table(timed));
    Ok(page.finish())
}
