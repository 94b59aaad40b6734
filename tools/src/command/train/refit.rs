//! The last iterations of a run, without network F.

use engine::distill;
use engine::error::{Error, Result};
use engine::scene::Scene;
use engine::train::schedule::Stage;
use serde_json::json;

use super::finish::End;
use crate::cli::progress;

impl End<'_> {
    /// What the last iterations of a run that moves make of its model, and lines on them: see [`distill::refit()`].
    pub(super) fn refit(&mut self, scene: &Scene) -> Result<(Option<Scene>, Vec<String>)> {
        let (config, begin) = (self.schedule.config(), self.reached);
        if self.schedule.stage() != Stage::Rigid || config.refit_iterations() == 0 {
            return Ok((None, Vec::new()));
        }
        let bar = progress::training(config.refit_iterations(), 0, self.quiet);
        let mut logged = Ok(());
        let mut smooth = f64::NAN;
        let refitted = distill::refit(
            self.gpu,
            scene,
            &self.data.train,
            config,
            self.of_photos.clone(),
            &mut |what, done, _| bar.set_message(format!("rigid parts: {what} {done}")),
            &mut |step| {
                smooth = if smooth.is_nan() { step.psnr } else { 0.95 * smooth + 0.05 * step.psnr };
                bar.set_message(format!("rigid parts: loss {:.4}, PSNR {smooth:.2} dB", step.loss));
                bar.inc(1);
                if logged.is_ok() && config.log.logs(step.iteration) {
                    let line = json!({
                        "loss": step.loss, "l1": step.l1, "ssim": step.ssim, "psnr": step.psnr,
                        "gaussians": step.gaussians, "superpoints": step.superpoints, "view": step.view,
                    });
                    logged = self.log.line(begin + step.iteration, line);
                }
            },
        );
        bar.finish_and_clear();
        logged?;
        let refitted = match refitted {
            // Nothing is lost: the model is what network F has made of it.
            Err(error @ Error::OutOfMemory { .. }) => {
                log::warn!("the last {} iterations are left out: {error}", config.refit_iterations());
                None
            }
            other => other?,
        };
        let iterations = config.refit_iterations();
        let Some(r) = refitted else {
            return Ok((None, vec![format!("refit: the last {iterations} iterations are left out")]));
        };
        self.of_photos.exposures = r.exposures;
        let ([before, after], [first, last]) = (r.superpoints, r.loss);
        let parts = match r.error_px {
            Some([bound, off]) => {
                format!("{after} superpoints, {before} before, off by {off:.2} px of {bound:.2} allowed, then")
            }
            None if !scene.deformation.moves() => "nothing moves;".into(),
            None => format!("{after} superpoints, as before, for there are many Gaussians;"),
        };
        let mut lines = vec![format!(
            "refit: {parts} trained for {iterations} iterations without network F: loss {first:.4} → {last:.4}"
        )];
        for found in r.lost_objects {
            self.log.line(begin + 1, json!({ "lost_object": found }))?;
            lines.push(found.to_string());
        }
        Ok((Some(r.scene), lines))
    }
}
