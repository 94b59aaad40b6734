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
        let state = self.keys.state();
        vec![("key poses", Slice::from(state), (state.bytes() / 4) as u32)]
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
