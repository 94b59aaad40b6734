//! The end of a run: model, evaluation of the test split, pictures, report.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::data::dataset::Dataset;
use engine::data::loader::ImageLoader;
use engine::distill::OfPhotos;
use engine::error::Result;
use engine::file::picture::{self, Alpha};
use engine::gpu::Gpu;
use engine::scene::{Camera, Scene};
use engine::train::config::Config;
use engine::train::evaluate::{self, Coverage, ViewScore};
use engine::train::export::{Exported, export};
use engine::train::schedule::Schedule;
use serde_json::json;

use super::exposures;
use super::log::SharedLog;
use super::report::{self, Pair};
use super::run::{Run, options};
use super::transients;
use crate::cli::{gpu_session, model, output};
use crate::report::files::create_folder;
use crate::report::provenance;

/// Views that the report shows.
const SHOWN: usize = 6;
/// Share of the photos' opaque pixels above which emptiness is worth a word. Measured: 0.049 where a ball was lost
/// (`bending_creature`), 0.011 and 0.024 where nothing was (`robot_dance`, `dnerf_lego`).
const MOST_EMPTY: f64 = 0.04;

/// What is left of a run when its trainer is gone.
pub(super) struct End<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) out: PathBuf,
    pub(super) data: &'a Dataset,
    held_out: ImageLoader,
    pub(super) log: SharedLog,
    pub(super) quiet: bool,
    /// As given, not scaled.
    config: Config,
    pub(super) schedule: Schedule,
    /// The trainer's last iteration.
    pub(super) reached: u64,
    /// What was found of each training photo.
    pub(super) of_photos: OfPhotos,
}

impl<'a> Run<'a> {
    pub(super) fn finish(self, data_path: &Path, as_json: bool) -> Result<()> {
        let Run { gpu, out, data, held_out, trainer, log, quiet, .. } = self;
        let cameras: Vec<Camera> = data.train.iter().map(|v| Camera { time: v.time, ..v.camera.clone() }).collect();
        let exported = export(gpu, &trainer, &cameras)?;
        let (config, schedule, reached) = (trainer.config().clone(), trainer.schedule().clone(), trainer.iteration());
        let of_photos = OfPhotos { exposures: trainer.exposures()?, transients: trainer.transients() };
        // What comes trains again, and needs the room.
        drop(trainer);
        let end: End<'a> = End { gpu, out, data, held_out, log, quiet, config, schedule, reached, of_photos };
        end.finish(exported, data_path, as_json)
    }
}

impl End<'_> {
    fn finish(mut self, exported: Exported, data_path: &Path, as_json: bool) -> Result<()> {
        let Exported { mut scene, mut decisions } = exported;
        let mut i = self.reached;
        let (refitted, lines) = self.refit(&scene)?;
        decisions.extend(lines);
        decisions.extend(exposures::write(&self.out, &self.data.train, self.of_photos.exposures.as_deref())?);
        decisions.extend(transients::write(&self.out, &self.data.train, self.of_photos.transients.as_deref())?);
        if let Some(refitted) = refitted {
            i += self.schedule.config().refit_iterations();
            scene = refitted;
        }
        if scene.deformation.nonrigid().is_none() {
            scene.gaussians.fold_smoothing();
        }
        scene.metadata = self.provenance(data_path, i, &decisions)?;
        let path = self.out.join("model.safetensors");
        engine::file::save(&path, &scene)?;
        let (scores, pairs, coverage) = self.evaluate_all(&scene)?;
        self.warn_of_lost(&scene, &coverage);
        let [psnr, ssim] = evaluate::mean(&scores);
        let split = if self.data.test.is_empty() { "train" } else { "test" };
        self.log.line(i, json!({ "evaluation": { "split": split, "psnr": psnr, "ssim": ssim, "views": scores } }))?;
        let seconds = self.log.seconds();
        let mut facts = vec![
            ("Data set".into(), data_path.display().to_string()),
            ("Device".into(), gpu_session::describe(self.gpu)),
            ("Model".into(), model::describe(&scene)),
            (format!("PSNR, SSIM ({split} split, {} views)", scores.len()), format!("{psnr:.2} dB, {ssim:.4}")),
            ("Iterations, time".into(), format!("{i}, {seconds:.1} s")),
        ];
        facts.extend(decisions.iter().map(|d| ("Export".into(), d.clone())));
        report::write(&self.out, &facts, &pairs)?;
        if as_json {
            return output::json(&json!({
                "data": data_path, "model": path, "device": self.gpu.info(), "iterations": i, "seconds": seconds,
                "gaussians": scene.gaussians.len(), "split": split, "psnr": psnr, "ssim": ssim, "views": scores,
                "empty": coverage.empty_share(), "export": decisions, "model_bytes": std::fs::metadata(&path).map_or(0, |m| m.len()),
            }));
        }
        if !self.quiet {
            decisions.iter().for_each(|d| output::line(&format!("export  {d}")));
            output::line(&format!("{split:7} PSNR {psnr:.2} dB, SSIM {ssim:.4} over {} views", scores.len()));
            output::line(&format!(
                "model   {} in {} ({seconds:.1} s); curves and images in {}",
                model::describe(&scene),
                path.display(),
                self.out.join("report.html").display()
            ));
        }
        Ok(())
    }

    /// Says so when nothing moves, or when much of what the photos show is left empty: often what the static warm-up lost.
    fn warn_of_lost(&self, scene: &Scene, coverage: &Coverage) {
        let config = &self.config;
        if !config.motion.enabled || self.data.is_static || config.schedule.time_window > 0 {
            return;
        }
        let found = match coverage.empty_share() {
            Some(share) if share > MOST_EMPTY => {
                format!("{:.1} % of what the images show is left empty", 100.0 * share)
            }
            _ if !scene.deformation.moves() => "nothing moves in the model".into(),
            _ => return,
        };
        log::warn!(
            "{found}: objects that move by more than their size? `schedule.time_window` may follow them (`spgs help training`)"
        );
    }

    /// Scores every held-out view of the exported model; writes pictures of a few beside their photos.
    fn evaluate_all(&self, scene: &Scene) -> Result<(Vec<ViewScore>, Vec<Pair>, Coverage)> {
        let mut coverage = Coverage::default();
        let images = self.out.join("images");
        create_folder(&images)?;
        let total = self.held_out.views().len();
        let step = total.div_ceil(SHOWN).max(1);
        let mut pairs = Vec::new();
        let all: Vec<usize> = (0..total).collect();
        let scores = evaluate::evaluate(
            self.gpu,
            scene,
            &self.held_out,
            &all,
            &options(&self.config),
            |score, rendered, truth| {
                coverage.add(rendered, truth);
                if score.index.is_multiple_of(step) {
                    let names = ["rendered", "truth"].map(|kind| format!("{:05}_{kind}.png", score.index));
                    picture::write_png(&images.join(&names[0]), rendered, Alpha::Drop)?;
                    picture::write_png(&images.join(&names[1]), truth, Alpha::Drop)?;
                    let [rendered, truth] = names.map(|name| format!("images/{name}"));
                    pairs.push(Pair { name: score.name.clone(), rendered, truth, psnr: score.psnr });
                }
                Ok(())
            },
        )?;
        Ok((scores, pairs, coverage))
    }

    /// What the model file says of where it comes from.
    fn provenance(&self, data_path: &Path, iterations: u64, decisions: &[String]) -> Result<BTreeMap<String, String>> {
        let name =
            data_path.file_name().map_or_else(|| data_path.display().to_string(), |n| n.to_string_lossy().into());
        let data = json!({
            "name": name, "format": self.data.kind.name(), "train": self.data.train.len(),
            "test": self.data.test.len(), "decisions": self.data.decisions,
        });
        let info = self.gpu.info();
        let provenance = json!({
            "program": concat!("spgs ", env!("CARGO_PKG_VERSION")), "commit": provenance::commit(),
            "device": info.name, "driver": info.driver, "iterations": iterations,
            "seconds": self.log.seconds(), "export": decisions,
        });
        Ok(BTreeMap::from([
            ("training".into(), json!(self.config).to_string()),
            ("data".into(), data.to_string()),
            ("provenance".into(), provenance.to_string()),
        ]))
    }
}
