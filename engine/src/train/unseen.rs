//! Gaussians that the photos hardly show: behind others, or specks. They cost time and memory, and show where no photo looked.
//!
//! What a Gaussian makes up of a photo is Σ αT over its pixels ([`Contributions`]). Those that make up least go, as long as they
//! are together no more than a share of what all make up, whatever the size of photos and their number. (That contributions say
//! who is needed: Fan et al. 2023, LightGaussian; Niemeyer et al. 2024, RadSplat, by the largest αT.)

use super::contribution::Contributions;
use super::density::DensityOutcome;
use super::trainer::Trainer;
use crate::error::{Error, Result};
use crate::render::RenderOptions;
use crate::scene::parameter::OPACITY_LOGIT;

/// Photos that are looked at; of more, so many at equal distances.
const MOST_PHOTOS: usize = 200;
/// Opacity, as a logit, below everything that density control lets live.
const GONE: f32 = -80.0;

impl Trainer {
    /// Removes those that the photos show least; `None` where there was no room to.
    pub(super) fn prune_unseen(&mut self, iteration: u64) -> Result<Option<DensityOutcome>> {
        // What a step needs besides is made again: its memory is wanted here.
        self.targets.clear();
        let contributions = match self.contributions(iteration) {
            Err(Error::OutOfMemory { .. } | Error::Limit { .. }) => return Ok(None),
            other => other?,
        };
        let least = least_seen(&contributions, self.schedule.config().density.unseen_share);
        let buffer = &self.parameters.scene.parameter[OPACITY_LOGIT];
        let before = self.gpu.download(buffer)?;
        let mut logits: Vec<f32> = bytemuck::pod_collect_to_vec(&before);
        for i in least {
            logits[i] = GONE;
        }
        self.gpu.upload(buffer, bytemuck::cast_slice(&logits))?;
        let outcome = self.pass(iteration, false, false)?;
        if outcome.is_none() {
            self.gpu.upload(&self.parameters.scene.parameter[OPACITY_LOGIT], &before)?;
        }
        Ok(outcome)
    }

    /// `[N]` Σ αT over the photos as they are at `iteration`.
    fn contributions(&self, iteration: u64) -> Result<Vec<f64>> {
        let photos = self.pyramid.places(iteration);
        let step = photos.len().div_ceil(MOST_PHOTOS).max(1);
        let photos = photos.step_by(step);
        let scene = self.scene_of_photos(photos.clone().map(|photo| self.pyramid.views[photo].time))?;
        let (background, near) = (self.config.background, self.config.near);
        let options = RenderOptions { background, near, ..RenderOptions::default() };
        let mut of = Contributions::new(&self.gpu, &scene, &options)?;
        let mut sums = vec![0.0; scene.gaussians.len()];
        for photo in photos {
            let view = &self.pyramid.views[photo];
            let weight = vec![[1.0, 0.0, 0.0]; view.camera.width as usize * view.camera.height as usize];
            for (sum, [seen, ..]) in sums.iter_mut().zip(of.of_view(&view.camera, view.time, &weight)?) {
                *sum += f64::from(seen);
            }
        }
        Ok(sums)
    }
}

/// The places of the smallest values, as many as together are at most this share of the sum; of equal ones the first. None
/// where the sum is 0.
fn least_seen(contributions: &[f64], share: f64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..contributions.len()).collect();
    order.sort_by(|&a, &b| contributions[a].total_cmp(&contributions[b]));
    let most = share * contributions.iter().sum::<f64>();
    let mut sum = 0.0;
    order.retain(|&i| {
        sum += contributions[i];
        most > 0.0 && sum <= most
    });
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_go_until_they_are_a_share() {
        let values = [5.0, 0.0, 90.0, 1.0, 3.0, 1.0];
        assert_eq!(least_seen(&values, 0.05), [1, 3, 5, 4]);
        assert_eq!(least_seen(&values, 0.02), [1, 3, 5]);
        assert_eq!(least_seen(&[0.0; 3], 0.5), [0; 0], "nothing was seen at all");
        assert_eq!(least_seen(&[f64::NAN, 1.0], 0.5), [0; 0]);
        assert_eq!(least_seen(&[], 0.5), [0; 0]);
    }
}
