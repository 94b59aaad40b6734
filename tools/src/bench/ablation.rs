//! `spgs bench ablation DATA`: the paper's ablations on one data set, each beside the paper's row.

mod plan;

use std::collections::BTreeMap;
use std::time::Instant;

use engine::error::{Error, Result};
use engine::render::{RenderOptions, Renderer};
use engine::scene::{MotionSource, Scene};
use engine::train::config::Config;
use engine::train::export::export;
use serde::Serialize;
use serde_json::{Value, json};

use self::plan::{Plan, Variant, plans};
use crate::bench::train::session::{Session, Timed, Until};
use crate::cli::args::{AblationArgs, Global};
use crate::cli::{gpu_session, output, progress};
use crate::report::measure::Quantiles;
use crate::report::page::{Align, Axis, Chart, Mark, Page, Series, Table, field};
use crate::report::{paper, provenance};

/// Frames by which play-back is timed.
const FRAMES: u32 = 30;

/// What a run gave.
#[derive(Debug, Clone, Serialize)]
struct Score {
    psnr: f64,
    ssim: f64,
    gaussians: u32,
    superpoints: u32,
    seconds: f64,
    iterations_per_second: f64,
    /// Play-back, frames per second; only where that is what is compared.
    fps: Option<f64>,
}

/// A row of an ablation.
#[derive(Debug, Clone, Serialize)]
struct Row {
    setting: String,
    /// Ours.
    score: Score,
    /// PSNR of the paper's row, dB.
    paper_psnr: Option<f64>,
}

/// An ablation, done or not.
#[derive(Debug, Clone, Serialize)]
struct Ablation {
    id: &'static str,
    title: String,
    rows: Vec<Row>,
    /// Why there is no row of ours, if so.
    left_out: Option<&'static str>,
}

/// Runs the ablations and reports.
///
/// # Errors
/// Those of the data set and of training.
pub fn run(args: &AblationArgs, global: &Global) -> Result<()> {
    let chosen = chosen(&args.only)?;
    let gpu = gpu_session::open_to_train(global)?;
    let session = Session::new(&gpu, &args.data, args.downscale)?;
    let base = session.config(args.iterations);
    let total: usize = chosen.iter().map(|p| p.variants.len()).sum();
    let bar = progress::training(base.iterations * total as u64, 0, global.quiet);
    let mut runs = Runs { session: &session, done: BTreeMap::new(), tick: &|| bar.inc(1) };
    let mut found = Vec::new();
    for plan in &chosen {
        bar.set_message(plan.id);
        found.push(runs.ablation(plan, &base)?);
    }
    bar.finish_and_clear();
    gpu_session::report_validation(&gpu);
    let numbers = json!({
        "data": args.data,
        "views": session.describe(),
        "iterations": base.iterations,
        "trained": runs.done.len(),
        "ablations": found,
    });
    let record = provenance::record(Some("ablation"), &gpu, numbers);
    args.results.write(&record, || html(&record, &found))?;
    if !global.quiet {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("data    {}: {}", args.data.display(), session.describe()));
        output::line(&format!("runs    {} of {} iterations each", runs.done.len(), base.iterations));
        for a in &found {
            output::line(&format!("\n{} ({})", a.title, a.id));
            a.left_out.iter().for_each(|why| output::line(&format!("not run: {why}")));
            output::line(table(a)?.text().trim_end());
        }
    }
    Ok(())
}

/// The ablations of `--only`, or all.
fn chosen(only: &[String]) -> Result<Vec<Plan>> {
    let all = plans();
    let names: Vec<&str> = all.iter().map(|p| p.id).collect();
    if let Some(bad) = only.iter().find(|o| !names.contains(&o.as_str())) {
        return Err(Error::usage("--only", bad.as_str(), names.join(", ")));
    }
    Ok(all.into_iter().filter(|p| only.is_empty() || only.iter().any(|o| o == p.id)).collect())
}

/// Runs that are done, by their configuration: settings that several ablations share are trained once.
struct Runs<'a> {
    session: &'a Session<'a>,
    done: BTreeMap<String, Score>,
    tick: &'a dyn Fn(),
}

impl Runs<'_> {
    fn ablation(&mut self, plan: &Plan, base: &Config) -> Result<Ablation> {
        let printed = paper::tables()?.ablation(plan.id);
        let mut rows = Vec::new();
        for variant in &plan.variants {
            let mut config = base.clone();
            (variant.change)(&mut config);
            config.check()?;
            let paper_psnr = printed.and_then(|a| {
                let column = a.columns.iter().position(|c| c == "psnr")?;
                a.rows.get(variant.paper_row)?.get(column)?.number()
            });
            rows.push(Row { setting: variant.name.clone(), score: self.score(&config, variant)?, paper_psnr });
        }
        let title = printed.map_or_else(|| plan.id.to_owned(), |a| a.title.clone());
        Ok(Ablation { id: plan.id, title, rows, left_out: plan.left_out }.clone())
    }

    fn score(&mut self, config: &Config, variant: &Variant) -> Result<Score> {
        let key = format!("{}{:?}", config.to_toml()?, variant.playback);
        if let Some(score) = self.done.get(&key) {
            (0..config.iterations).for_each(|_| (self.tick)());
            return Ok(score.clone());
        }
        let (timed, trainer) = self.session.run(config, Until::default(), 1, self.tick)?;
        let mut score = Score::from(&timed);
        if let Some(motion) = variant.playback {
            let scene = match motion {
                MotionSource::Table => export(self.session.gpu(), &trainer, &self.session.cameras())?.scene,
                _ => trainer.scene()?,
            };
            [score.psnr, score.ssim] = self.session.score(&scene, config, motion)?;
            score.fps = self.fps(&scene, config, motion)?;
        }
        self.done.insert(key, score.clone());
        Ok(score)
    }

    /// Frames per second of play-back, one frame at a time, median.
    fn fps(&self, scene: &Scene, config: &Config, motion: MotionSource) -> Result<Option<f64>> {
        let Some((camera, time)) = self.session.first_view() else { return Ok(None) };
        let options =
            RenderOptions { background: config.background, near: config.near, motion, ..RenderOptions::default() };
        let mut renderer = Renderer::new(self.session.gpu(), scene, &options)?;
        (0..3).try_for_each(|_| renderer.draw(&camera, time).map(|_| ()))?;
        let mut ms = Vec::new();
        for _ in 0..FRAMES {
            let start = Instant::now();
            renderer.draw(&camera, time)?;
            ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
        Ok(Some(1e3 / Quantiles::of(ms).median))
    }
}

impl From<&Timed> for Score {
    fn from(timed: &Timed) -> Self {
        let last = timed.last();
        Self {
            psnr: last.map_or(0.0, |m| m.psnr),
            ssim: last.map_or(0.0, |m| m.ssim),
            gaussians: last.map_or(0, |m| m.gaussians),
            superpoints: timed.superpoints,
            seconds: timed.seconds,
            iterations_per_second: timed.iterations_per_second,
            fps: None,
        }
    }
}

/// Ours beside the paper's; the paper alone where nothing was run.
fn table(a: &Ablation) -> Result<Table> {
    if a.left_out.is_some() {
        let printed = paper::tables()?.ablation(a.id);
        let mut table = Table::new(&printed.map_or(Vec::new(), |p| {
            p.columns.iter().map(|c| (format!("{c} (paper)"), Align::Right)).collect::<Vec<_>>()
        }));
        printed.iter().flat_map(|p| &p.rows).for_each(|r| table.row(r.iter().map(ToString::to_string)));
        return Ok(table);
    }
    let columns = ["PSNR, dB", "SSIM", "PSNR (paper)", "Gaussians", "superpoints", "s", "iterations/s", "FPS"];
    let right = columns.into_iter().map(|c| (c, Align::Right));
    let mut table = Table::new(&std::iter::once(("setting", Align::Left)).chain(right).collect::<Vec<_>>());
    for row in &a.rows {
        let s = &row.score;
        table.row([
            row.setting.clone(),
            format!("{:.3}", s.psnr),
            format!("{:.4}", s.ssim),
            row.paper_psnr.map_or("–".into(), |p| p.to_string()),
            s.gaussians.to_string(),
            s.superpoints.to_string(),
            format!("{:.1}", s.seconds),
            format!("{:.2}", s.iterations_per_second),
            s.fps.map_or("–".into(), |f| format!("{f:.1}")),
        ]);
    }
    Ok(table)
}

fn html(record: &Value, found: &[Ablation]) -> Result<String> {
    let mut page = Page::new("spgs bench ablation");
    page.provenance(record);
    page.facts(&[
        ("Data", field(record, "/data")),
        ("Views", field(record, "/views")),
        ("Runs", format!("{} of {} iterations each", field(record, "/trained"), field(record, "/iterations"))),
    ]);
    page.note(
        "The paper's figures are means over the D-NeRF scenes after 40,000 iterations at 800×800: compare how a setting \
         changes the result, not the level.",
    );
    for a in found {
        page.heading(&format!("{} ({})", a.title, a.id));
        if let Some(why) = a.left_out {
            page.note(&format!("Not run: {why}."));
        }
        if a.rows.len() > 2 {
            let at = |of: fn(&Row) -> Option<f64>| {
                a.rows.iter().enumerate().filter_map(|(i, r)| Some((i as f64, of(r)?))).collect::<Vec<_>>()
            };
            // Both as differences from their first row: the levels belong to other data and other lengths of run.
            let from_first = |points: Vec<(f64, f64)>| {
                let first = points.first().map_or(0.0, |p| p.1);
                points.into_iter().map(|(x, y)| (x, y - first)).collect::<Vec<_>>()
            };
            page.chart(
                &Chart::new(a.title.clone(), Axis::linear("row of the table"), Axis::linear("PSNR − first row, dB"))
                    .series(Series::new("ours", Mark::LineAndPoints, from_first(at(|r| Some(r.score.psnr)))))
                    .series(Series::new("paper", Mark::LineAndPoints, from_first(at(|r| r.paper_psnr))))
                    .height(320),
            )?;
        }
        page.table(&table(a)?);
    }
    Ok(page.finish())
}
