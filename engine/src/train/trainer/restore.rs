//! What a run goes on from and what it leaves: checkpoints, scenes, poses.

use super::{Trainer, TrainingData};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::scene::{Deformation, Motion, Scene};
use crate::train::checkpoint::Checkpoint;
use crate::train::config::Config;
use crate::train::deformation;
use crate::train::exposure::{EXPOSURE_WORDS, ExposureState};
use crate::train::keys::KeyOptions;
use crate::train::parameters::{ParameterState, with_sh_degree};
use crate::train::saved::Saved;
use crate::train::schedule::Stage;
use crate::train::target::Target;
use crate::train::transients::Transients;
use crate::train::widen::widen;

/// Its name in a checkpoint.
const EXPOSURE: &str = "exposure";
/// As above.
const TRANSIENTS: &str = "transients";

impl Trainer {
    /// Goes on from a checkpoint.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    pub fn resume(gpu: &Gpu, data: &TrainingData, checkpoint: &Checkpoint) -> Result<Self> {
        let c = checkpoint;
        let mut trainer = Self::assemble(gpu, &c.config, data, c.stage, c.iteration, &c.parameters)?;
        if let Some(window) = &mut trainer.window {
            window.restore(&c.saved, c.iteration)?;
        }
        trainer.restore_photos(&c.saved)?;
        if let Some(model) = deformation::restore(gpu, &c.config, &c.stored())? {
            trainer.set_deformation(model);
        }
        Ok(trainer)
    }

    /// Begins the non-rigid stage on a trained model: all Gaussians and network G are trained, network F and the association
    /// are not. Moments start at zero.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    pub fn nonrigid(gpu: &Gpu, config: &Config, data: &TrainingData, trained: &Checkpoint) -> Result<Self> {
        let state = ParameterState {
            superpoint_of_gaussian: trained.parameters.superpoint_of_gaussian.clone(),
            ..ParameterState::new(&trained.parameters.gaussians, trained.parameters.gaussians.sh_degree)
        };
        let mut trainer = Self::assemble(gpu, config, data, Stage::Nonrigid, 0, &state)?;
        trainer.restore_photos(&trained.saved)?;
        trainer.set_deformation(deformation::nonrigid(gpu, config, &trained.stored())?);
        Ok(trainer)
    }

    /// Trains a finished scene: its Gaussians, and the key poses of its superpoints as `keys` says; which superpoint a Gaussian moves
    /// with stays, and so do the Gaussians in number. There are no checkpoints of it.
    ///
    /// # Errors
    /// As [`Trainer::new`]; `Usage` for a scene without a key-time table, and for density control.
    pub fn table(gpu: &Gpu, config: &Config, data: &TrainingData, scene: &Scene, keys: KeyOptions) -> Result<Self> {
        let Some(moved) = scene.deformation.superpoint_deformation() else {
            return Err(Error::usage("model to train", "no superpoints", "superpoints with a key-time table"));
        };
        if config.density.enabled {
            return Err(Error::usage("density.enabled", "true", "false, to train a key-time table"));
        }
        let gaussians = &scene.gaussians;
        let state = ParameterState {
            superpoint_of_gaussian: moved.superpoints.of_gaussian.clone(),
            ..ParameterState::new(gaussians, gaussians.sh_degree)
        };
        let mut config = config.clone();
        config.gaussians.sh_degree = gaussians.sh_degree;
        config.motion.blend = moved.blend.as_ref().map_or(1, |blend| blend.neighbors as u32);
        let mut trainer = Self::assemble(gpu, &config, data, Stage::Table, 0, &state)?;
        trainer.set_deformation(deformation::of_table(gpu, moved, gaussians.len() as u32, keys)?);
        Ok(trainer)
    }

    /// Everything that the next step depends on.
    ///
    /// # Errors
    /// `NonFinite` when a number has gone bad: that is no state to go on from; `Usage` while steps are in flight; `DeviceLost`,
    /// `OutOfMemory`.
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        self.settled()?;
        self.check_numbers()?;
        let mut checkpoint = Checkpoint {
            config: self.config.clone(),
            stage: self.schedule.stage(),
            iteration: self.iteration,
            parameters: self.parameters.download(&self.gpu)?,
            saved: Saved::default(),
        };
        if let Some(model) = &self.deformation {
            model.save(&self.gpu, &self.parameters.scene, &mut checkpoint.saved)?;
        }
        if let Some(window) = &self.window {
            window.save(&mut checkpoint.saved);
        }
        if let Some(exposure) = &self.exposure {
            checkpoint.saved.put_floats(EXPOSURE, vec![exposure.photos(), EXPOSURE_WORDS], &exposure.rows(&self.gpu)?);
        }
        if let Some(transients) = &self.transients {
            let words = transients.words();
            checkpoint.saved.put_indices(TRANSIENTS, vec![words.len()], &words);
        }
        Ok(checkpoint)
    }

    /// What was found of each photo.
    fn restore_photos(&mut self, saved: &Saved) -> Result<()> {
        if self.transients.is_some() && saved.has(TRANSIENTS) {
            self.set_transients(&saved.indices(TRANSIENTS, None)?)?;
        }
        match &self.exposure {
            Some(exposure) if saved.has(EXPOSURE) => {
                let count = exposure.photos() * EXPOSURE_WORDS;
                self.set_exposures(&saved.floats(EXPOSURE, Some(count))?)
            }
            _ => Ok(()),
        }
    }

    /// `[photos][40]` exposures with their moments, in the order of the photos ([`exposure`](crate::train::exposure)); `None` where photos
    /// are taken as they are.
    ///
    /// # Errors
    /// `Usage` while steps are in flight; `DeviceLost`, `OutOfMemory`.
    pub fn exposures(&self) -> Result<Option<Vec<f32>>> {
        self.settled()?;
        self.exposure.as_ref().map(|exposure| exposure.rows(&self.gpu)).transpose()
    }

    /// Goes on from these exposures.
    ///
    /// # Errors
    /// `Usage` for another number of photos, and while steps are in flight; `OutOfMemory`.
    pub fn set_exposures(&mut self, rows: &[f32]) -> Result<()> {
        self.settled()?;
        let photos = self.exposure.as_ref().map_or(0, ExposureState::photos);
        self.exposure = Some(ExposureState::new(&self.gpu, photos, rows, self.config.loss.lambda_exposure)?);
        self.targets.iter_mut().for_each(Target::forget_commands);
        Ok(())
    }

    /// What is left out of photos, as [`Transients::words`] has it; `None` where photos are believed.
    pub fn transients(&self) -> Option<Vec<u32>> {
        self.transients.as_ref().map(Transients::words)
    }

    /// Leaves this out of photos.
    ///
    /// # Errors
    /// `Usage` for words of other photos, and while steps are in flight.
    pub fn set_transients(&mut self, words: &[u32]) -> Result<()> {
        self.settled()?;
        self.transients = Some(Transients::from_words(words, self.pyramid.full().len())?);
        self.photos.forget();
        self.targets.iter_mut().for_each(Target::forget_commands);
        Ok(())
    }

    /// The scene as it is: Gaussians at the SH degree in use, as wide at full size as in the photos that they are trained on, and what
    /// moves them.
    ///
    /// # Errors
    /// `Usage` while steps are in flight; `DeviceLost`, `OutOfMemory`.
    pub fn scene(&self) -> Result<Scene> {
        let mut scene = self.scene_of_step()?;
        if !scene.gaussians.antialiased {
            let halvings = self.pyramid.halvings(self.iteration.max(1));
            widen(&mut scene.gaussians, &self.pyramid, self.config.near.into(), halvings);
        }
        Ok(scene)
    }

    /// [`Trainer::scene`], but as wide as in the photos of their size.
    fn scene_of_step(&self) -> Result<Scene> {
        self.settled()?;
        let degree = self.schedule.sh_degree(self.iteration.max(1)).min(self.parameters.sh_degree);
        let gaussians = with_sh_degree(&self.parameters.download_gaussians(&self.gpu)?, degree);
        let model = self.deformation.as_ref();
        let deformation = model.map_or(Ok(Deformation::None), |m| m.download(&self.gpu, &self.parameters.scene))?;
        Ok(Scene { gaussians, deformation, ..Scene::default() })
    }

    /// [`Trainer::scene`] for pictures at these times: its poses stand in a table of just them, so that no picture evaluates
    /// network F, which takes a CPU seconds. Between them they are interpolated.
    ///
    /// # Errors
    /// As [`Trainer::scene`].
    pub fn scene_at(&self, times: impl IntoIterator<Item = f64>) -> Result<Scene> {
        self.posed_at(self.scene()?, times)
    }

    /// The same, for photos of the size that they have now.
    pub(in crate::train) fn scene_of_photos(&self, times: impl IntoIterator<Item = f64>) -> Result<Scene> {
        self.posed_at(self.scene_of_step()?, times)
    }

    fn posed_at(&self, mut scene: Scene, times: impl IntoIterator<Item = f64>) -> Result<Scene> {
        let mut times: Vec<f32> = times.into_iter().map(|t| t as f32).collect();
        times.sort_by(f32::total_cmp);
        times.dedup();
        if times.is_empty() {
            return Ok(scene);
        }
        if let (Some(motion), Some(moved)) = (self.motion_at(&times)?, scene.deformation.superpoint_deformation_mut()) {
            (moved.table, moved.network, moved.association) = (Some(motion), None, None);
        }
        Ok(scene)
    }

    /// Poses of network F at `times`, as a table; `None` before motion begins.
    ///
    /// # Errors
    /// `Usage` while steps are in flight; `DeviceLost`, `OutOfMemory`.
    pub fn motion_at(&self, times: &[f32]) -> Result<Option<Motion>> {
        self.settled()?;
        let model = self.deformation.as_ref();
        model.map_or(Ok(None), |m| m.table_at(&self.gpu, &self.slots[0].step, times))
    }
}
