//! A key-time table under training: poses stand between key poses, which learn. Which superpoint a Gaussian moves with stays.

use super::super::keys::{KeyOptions, KeyState, PoseSums};
use super::super::saved::Saved;
use super::super::step::Step;
use super::super::usage::TrainingMemory;
use super::{Numbers, Rows, StepInputs, Trained, TrainedDeformation};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Memory, Recorder, Slice};
use crate::render::deformation::{DeformationBuffers, Poses};
use crate::render::scene_buffers::SceneBuffers;
use crate::render::superpoint_motion::BlendSlices;
use crate::scene::parameter::MEAN;
use crate::scene::{Deformation, SuperpointDeformation};

/// The model on the device.
#[derive(Debug)]
pub(super) struct TableTraining {
    scene: SuperpointDeformation,
    keys: KeyState,
    sums: PoseSums,
    blend: Option<BlendSlices>,
    pose: Buffer,
    gaussians: u32,
}

impl TableTraining {
    /// Of superpoints with a table.
    pub(super) fn new(gpu: &Gpu, scene: &SuperpointDeformation, gaussians: u32, options: KeyOptions) -> Result<Self> {
        let Some(table) = &scene.table else {
            return Err(Error::usage("model to train", "no key-time table", "superpoints with one"));
        };
        let m = scene.superpoints.position.len();
        Ok(Self {
            keys: KeyState::new(gpu, table, options)?,
            sums: PoseSums::new(gpu, scene, gaussians)?,
            blend: scene.blend.as_ref().map(|b| BlendSlices::upload(gpu, b, m)).transpose()?,
            pose: gpu.buffer("pose", 32 * m as u64, Memory::Device)?,
            scene: scene.clone(),
            gaussians,
        })
    }
}

impl TrainedDeformation for TableTraining {
    fn attach(&self, buffers: &mut DeformationBuffers) {
        buffers.superpoints = self.scene.superpoints.position.len() as u32;
        buffers.poses = Poses::Given;
        buffers.pose = self.pose.clone();
        buffers.blend = self.blend.clone();
    }

    fn prepare(&self, step: &mut Step, time: f64, pixels: f64) {
        self.keys.prepare(step, time, pixels);
    }

    fn record_forward(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()> {
        self.keys.record_interpolate(r, inputs.step, &self.pose)
    }

    fn record_backward(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()> {
        let mean = Slice::from(&inputs.scene.parameter[MEAN]);
        self.sums.record(r, inputs.step, &mean, &Slice::from(inputs.pose_gradient), inputs.status)?;
        self.keys.record_learn(r, inputs.step, inputs.counters, &self.sums, inputs.status)
    }

    fn numbers(&self) -> Vec<Numbers> {
        let (state, words) = self.keys.state();
        vec![("key poses", Slice::from(state), words)]
    }

    fn bytes_per_gaussian(&self) -> u64 {
        self.sums.bytes() / u64::from(self.gaussians.max(1))
    }

    fn resized(self: Box<Self>, _: &Gpu, gaussians: u32, _: &mut Rows<'_>) -> Result<Option<Trained>> {
        Err(Error::usage("Gaussians with a key-time table", gaussians.to_string(), self.gaussians.to_string()))
    }

    fn add_memory(&self, used: &mut TrainingMemory) {
        used.parameters += self.pose.bytes() + self.keys.bytes();
        used.gradients += self.sums.bytes();
    }

    fn download(&self, gpu: &Gpu, _: &SceneBuffers) -> Result<Deformation> {
        Ok(SuperpointDeformation { table: Some(self.keys.table(gpu)?), ..self.scene.clone() }.into())
    }

    fn save(&self, _: &Gpu, _: &SceneBuffers, _: &mut Saved) -> Result<()> {
        Err(Error::usage("checkpoint", "a key-time table under training", "superpoints with network F"))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use glam::DVec3;

    use super::*;
    use crate::gpu::GpuOptions;
    use crate::scene::synthetic::moving_scene;
    use crate::train::check_finite::check_finite;

    /// With an odd number of keys a buffer is longer than they are, and has what was there before.
    #[test]
    fn only_key_poses_are_watched() {
        let gpu = Gpu::open(&GpuOptions { pipeline_cache: false, ..GpuOptions::default() }).unwrap();
        let scene = moving_scene(60, 9, 7, 3, false);
        let moved = scene.deformation.superpoint_deformation().unwrap();
        let keys = moved.table.as_ref().unwrap().times.len();
        assert_eq!(keys * 9 % 2, 1);
        let (center, ones) = (vec![DVec3::ZERO; 9], vec![1.0; 9]);
        let (reach, unit) = (ones.clone(), ones);
        let options = KeyOptions { center, reach, unit, rate_px: [0.1; 2], hold: 0.0, smooth: 0.0, iterations: 10 };
        let training = TableTraining::new(&gpu, moved, 60, options).unwrap();
        let (state, words) = training.keys.state();
        let good = gpu.download(state.slice(0, 4 * u64::from(words))).unwrap();
        gpu.upload(state, &vec![0xff; state.bytes() as usize]).unwrap();
        assert!(check_finite(&gpu, &training.numbers()).is_err());
        gpu.upload(state, &good).unwrap();
        check_finite(&gpu, &training.numbers()).unwrap();
        assert!(state.bytes() > good.len() as u64);
    }
}
