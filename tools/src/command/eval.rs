//! `spgs eval`: a model scored on the held-out views of a data set, with the paper's figures beside it.

mod beside;
mod confidence;
mod evaluation;
mod exposure;
mod protocol;
mod report;
mod session;
mod setting;

use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use engine::file::picture::{self, Alpha};
use engine::image::Image;
use engine::metrics::flicker::Flicker;
use engine::metrics::{Planes, flip, mean_of};
use serde_json::{Value, json};

use self::beside::Beside;
use self::confidence::{Foretold, Summary};
use self::evaluation::{Evaluation, our_row, paper_rows, paper_title};
use self::session::{FloatScores, Session, ViewResult};
use self::setting::Setting;
use crate::cli::args::{EvalArgs, Global};
use crate::cli::{gpu_session, model, output, progress};
use crate::report::files::create_folder;
use crate::report::paper;
use crate::report::scores::{self, AllScores, cell};
use crate::report::{error_image, provenance};

/// Scores every view, then writes and prints: a mistake leaves nothing behind.
pub fn run(args: &EvalArgs, global: &Global) -> Result<()> {
    let loaded = model::load(&args.model)?;
    let setting = Setting::decide(args, &loaded.scene)?;
    let weights = scores::read_weights(&args.lpips_weights)?;
    let beside = args.beside.iter().map(|path| Beside::read(path)).collect::<Result<Vec<_>>>()?;
    let gpu = gpu_session::open(global)?;
    let mut session = Session::new(&gpu, &loaded.scene, &setting, &weights)?;
    let staged = args.out.as_deref().map(Staged::new).transpose()?;
    let bar = progress::bar((setting.views.len() + setting.training.len()) as u64, global.quiet);
    let foretold = args.confidence.then(|| Foretold::new(&gpu, &loaded.scene, &setting, &bar));
    let mut foretold = foretold.transpose()?;
    let begin = std::time::Instant::now();
    let (views, flicker) = session.score_all(|index, rendered, truth| {
        bar.inc(1);
        let expected = foretold.as_mut().map(|f| f.view(&setting, index, [rendered, truth])).transpose()?;
        staged.as_ref().map_or(Ok(()), |s| s.write(index, rendered, truth, expected.as_ref()))
    })?;
    let seconds = begin.elapsed().as_secs_f64();
    bar.finish_and_clear();
    if let (Some(path), Some(foretold)) = (&args.save_confidence, &foretold) {
        foretold.evidence.write(path, &loaded.scene)?;
    }
    let confidence = foretold.map(Foretold::summary);
    let evaluation = Evaluation { confidence, beside, ..summarise(views, flicker, &setting, &weights)? };
    let record = record(args, &gpu, &loaded.scene, &setting, &evaluation, seconds)?;
    args.results.write(&record, || report::page(&record, &setting, &evaluation, &mut session))?;
    gpu_session::report_validation(&gpu);
    staged.map_or(Ok(()), Staged::publish)?;
    if !global.quiet {
        print(&setting, &evaluation)?;
    }
    Ok(())
}

fn summarise(
    views: Vec<ViewResult>,
    flicker: Option<Flicker>,
    setting: &Setting,
    weights: &engine::metrics::lpips::WeightsFile,
) -> Result<Evaluation> {
    let all: Vec<AllScores> = views.iter().map(|v| v.scores).collect();
    let float: Vec<FloatScores> = views.iter().map(|v| v.float).collect();
    let masked: Vec<AllScores> = views.iter().filter_map(|v| v.masked).collect();
    let (Some(mean), Some(mean_float)) = (AllScores::mean(&all), FloatScores::mean(&float)) else {
        return Err(Error::corrupt(&setting.path, "views", "none", "at least one"));
    };
    let mut notes = scores::notes(weights, &all);
    if flicker.is_none() {
        notes.push("flicker is absent: no two views have the same camera at different times".into());
    }
    if setting.masks {
        notes.push(format!("masked scores: of {} of {} views, whose mask is not empty", masked.len(), views.len()));
    }
    let mean_lpips_paper = mean_of(views.iter().map(|v| v.lpips_paper));
    Ok(Evaluation {
        views,
        mean,
        mean_float,
        mean_masked: AllScores::mean(&masked),
        mean_lpips_paper,
        flicker,
        confidence: None,
        beside: Vec::new(),
        notes,
    })
}

/// The JSON.
fn record(
    args: &EvalArgs,
    gpu: &engine::gpu::Gpu,
    scene: &engine::scene::Scene,
    setting: &Setting,
    e: &Evaluation,
    seconds: f64,
) -> Result<Value> {
    let mut mean = json!(e.mean);
    if let Some(mean) = mean.as_object_mut() {
        mean.insert("float".into(), json!(e.mean_float));
        mean.insert("masked".into(), json!(e.mean_masked));
        mean.insert("lpips_paper".into(), json!(e.mean_lpips_paper));
    }
    let numbers = json!({
        "model": { "file": args.model, "gaussians": scene.gaussians.len(), "description": model::describe(scene) },
        "data": { "folder": args.data, "format": setting.kind.name(), "split": setting.split.name(),
                  "downscale": setting.downscale, "background": setting.background },
        "seconds": seconds,
        "mean": mean,
        "flicker": e.flicker,
        "confidence": e.confidence,
        "images": e.views,
        "paper": paper_record(setting)?,
        "notes": e.notes,
    });
    Ok(provenance::record(None, gpu, numbers))
}

fn paper_record(setting: &Setting) -> Result<Value> {
    let Some(protocol) = &setting.protocol else { return Ok(Value::Null) };
    let tables = paper::tables()?;
    let scene = setting.scene.as_deref();
    Ok(json!({
        "protocol": protocol,
        "deviations": setting.deviations,
        "scene": scene,
        "rows": scene.map(|s| tables.scene(protocol.benchmark, s)),
        "training": scene.and_then(|s| tables.training(protocol.benchmark, s)),
        "means": tables.means(protocol.benchmark),
        "contradictions": tables.contradictions(protocol.benchmark),
    }))
}

fn print(setting: &Setting, e: &Evaluation) -> Result<()> {
    let width = e.views.iter().map(|v| v.name.chars().count()).max().unwrap_or(0).max(12);
    output::line(&scores::header(width));
    e.views.iter().for_each(|v| output::line(&scores::line(&v.name, width, &v.scores)));
    output::line(&scores::line("mean", width, &e.mean));
    let floats = e.mean_float.cells().into_iter().zip([2, 4, 4, 4]).map(|(v, d)| format!(" {:>10}", cell(v, d)));
    output::line(&format!("{:width$}{}", "mean, floats", floats.collect::<String>()));
    if let Some(masked) = &e.mean_masked {
        output::line(&scores::line("mean, masked", width, masked));
    }
    if let Some(f) = e.flicker {
        let (rms, share) = (cell(f.rms, 5), 100.0 * f.static_share);
        output::line(&format!("flicker {rms} rms on static pixels ({share:.1} %), {} pairs of frames", f.pairs));
    }
    e.confidence.iter().for_each(|c: &Summary| output::line(&c.line()));
    e.notes.iter().for_each(|n| output::line(n));
    e.beside.iter().for_each(|other| output::line(&other.line(&e.views)));
    let Some(protocol) = &setting.protocol else { return Ok(()) };
    output::line(&format!("\nthe paper on {}, {}:", protocol.benchmark.name(), paper_title(setting)));
    setting.deviations.iter().for_each(|d| output::line(&format!("not as there: {d}")));
    output::line(&format!("{:16} {:>8} {:>8} {:>8}", "", "PSNR", protocol.similarity, "LPIPS"));
    let line = |name: &str, [psnr, similarity, lpips]: [Option<f64>; 3]| {
        let (p, s, l) = (cell(psnr, 2), cell(similarity, 4), cell(lpips, 4));
        output::line(&format!("{name:16} {p:>8} {s:>8} {l:>8}"));
    };
    paper_rows(setting)?.iter().for_each(|r| line(&r.method, [r.psnr, r.similarity, r.lpips]));
    line("this model", our_row(setting, e));
    protocol.remarks.iter().for_each(|r| output::line(r));
    Ok(())
}

/// Pictures of the views, in a folder of their own until all are there.
struct Staged {
    staging: tempfile::TempDir,
    out: PathBuf,
}

impl Staged {
    fn new(out: &Path) -> Result<Self> {
        let parent = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        create_folder(parent)?;
        let staging = tempfile::Builder::new().prefix(".spgs-eval-").tempdir_in(parent);
        Ok(Self { staging: staging.map_err(|e| Error::io(parent, "make folder", e))?, out: out.into() })
    }

    fn write(&self, index: usize, rendered: &Planes, truth: &Planes, expected: Option<&Image>) -> Result<()> {
        let file = |kind: &str| self.staging.path().join(format!("{index:05}{kind}.png"));
        let map = flip(truth, rendered, engine::metrics::PIXELS_PER_DEGREE)?;
        for (kind, image) in [
            ("", error_image::image(rendered)),
            ("_truth", error_image::image(truth)),
            ("_flip", error_image::flip(&map)),
            ("_error", error_image::absolute(truth, rendered)),
        ] {
            picture::write_png(&file(kind), &image, Alpha::Drop)?;
        }
        if let Some(image) = expected {
            picture::write_png(&file("_expected"), image, Alpha::Drop)?;
        }
        Ok(())
    }

    fn publish(self) -> Result<()> {
        create_folder(&self.out)?;
        let list = |e| Error::io(self.staging.path(), "list", e);
        for entry in std::fs::read_dir(self.staging.path()).map_err(list)? {
            let entry = entry.map_err(list)?;
            let to = self.out.join(entry.file_name());
            std::fs::rename(entry.path(), &to).map_err(|e| Error::io(&to, "rename", e))?;
        }
        Ok(())
    }
}
