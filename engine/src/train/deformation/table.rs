//! A key-time table under training: each step's poses come from the host, and its key poses learn there. Which superpoint a
//! Gaussian moves with stays.

mod keys;

use super::super::deform_project_backward::SLOT_PLANES;
use super::super::photo_loss::superpoint_sums;
use super::super::saved::Saved;
use super::super::step::Step;
use super::super::usage::TrainingMemory;
use super::{Numbers, Rows, StepInputs, Trained, TrainedDeformation};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Memory, Recorder, Slice};
use crate::render::deformation::{DeformationBuffers, Poses};
use crate::render::scene_buffers::SceneBuffers;
use crate::render::superpoint_motion::BlendSlices;
use crate::scene::{Deformation, SuperpointDeformation};

pub use keys::KeyOptions;
pub(super) use keys::Keys;

/// The step that is under way.
#[derive(Debug, Clone, Copy, Default)]
struct Now {
    iteration: u64,
    time: f64,
    pixels: f64,
}

/// The model on the device.
#[derive(Debug)]
pub(super) struct TableTraining {
    scene: SuperpointDeformation,
    keys: Keys,
    blend: Option<BlendSlices>,
    pose: Buffer,
    readback: Buffer,
    gaussians: u32,
    now: Now,
}

impl TableTraining {
    /// Of superpoints with a table.
    pub(super) fn new(gpu: &Gpu, scene: &SuperpointDeformation, gaussians: u32, options: KeyOptions) -> Result<Self> {
        let Some(table) = &scene.table else {
            return Err(Error::usage("model to train", "no key-time table", "superpoints with one"));
        };
        let m = scene.superpoints.position.len();
        let blend = scene.blend.as_ref().map(|b| BlendSlices::upload(gpu, b, m)).transpose()?;
        let planes = blend.as_ref().map_or(6, |b| b.slots * SLOT_PLANES);
        let bytes = 4 * u64::from(planes) * u64::from(gaussians.max(1));
        Ok(Self {
            keys: Keys::new(table, options)?,
            scene: scene.clone(),
            pose: gpu.buffer("pose", 32 * m as u64, Memory::Upload)?,
            readback: gpu.buffer("pose gradient readback", bytes, Memory::Readback)?,
            blend,
            gaussians,
            now: Now::default(),
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

    fn most_in_flight(&self) -> usize {
        1
    }

    fn prepare(&mut self, step: &Step, time: f64, pixels: f64) -> Result<()> {
        self.now = Now { iteration: step.iteration.into(), time, pixels };
        let rows = self.keys.poses(time).into_iter();
        let rows: Vec<[[f32; 4]; 2]> =
            rows.map(|p| [p.rotation, p.translation].map(|v| v.as_vec3().extend(0.0).to_array())).collect();
        self.pose.write(0, bytemuck::cast_slice(&rows))
    }

    fn record_forward(&self, _: &mut Recorder, _: &StepInputs<'_>) -> Result<()> {
        Ok(())
    }

    fn record_backward(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()> {
        r.copy(inputs.pose_gradient.slice(0, self.readback.bytes()), &self.readback)?;
        r.host_read(&self.readback);
        Ok(())
    }

    fn learn(&mut self) -> Result<()> {
        let mut planes = vec![0.0_f32; self.readback.bytes() as usize / 4];
        self.readback.read(0, bytemuck::cast_slice_mut(&mut planes))?;
        let mut sums = superpoint_sums(&planes, self.gaussians as usize, &self.scene);
        let Now { iteration, time, pixels } = self.now;
        // The loss is a mean over the pixels; how far a key goes should not depend on their number.
        sums.iter_mut().for_each(|s| (s.rotation, s.translation) = (s.rotation * pixels, s.translation * pixels));
        self.keys.learn(iteration, time, &sums);
        Ok(())
    }

    fn numbers(&self) -> Vec<Numbers> {
        vec![("poses", Slice::from(&self.pose), (self.pose.bytes() / 4) as u32)]
    }

    fn bytes_per_gaussian(&self) -> u64 {
        self.readback.bytes() / u64::from(self.gaussians.max(1))
    }

    fn resized(self: Box<Self>, _: &Gpu, gaussians: u32, _: &mut Rows<'_>) -> Result<Option<Trained>> {
        Err(Error::usage("Gaussians with a key-time table", gaussians.to_string(), self.gaussians.to_string()))
    }

    fn add_memory(&self, used: &mut TrainingMemory) {
        used.parameters += self.pose.bytes();
        used.gradients += self.readback.bytes();
    }

    fn download(&self, _: &Gpu, _: &SceneBuffers) -> Result<Deformation> {
        Ok(SuperpointDeformation { table: Some(self.keys.table()), ..self.scene.clone() }.into())
    }

    fn save(&self, _: &Gpu, _: &SceneBuffers, _: &mut Saved) -> Result<()> {
        Err(Error::usage("checkpoint", "a key-time table under training", "superpoints with network F"))
    }
}
