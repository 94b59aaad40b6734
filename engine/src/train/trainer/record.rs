//! Recording of a step: the order of the paper's algorithm.

use super::{READBACK, Trainer};
use crate::error::Result;
use crate::gpu::{Commands, Recorder, Slice};
use crate::render::pipeline::record_forward;
use crate::train::blend_backward::{self, BackwardInput, BackwardTarget};
use crate::train::deform_project_backward::{Output, ProjectBackward};
use crate::train::deformation::{ProjectInputs, StepInputs};
use crate::train::image_loss::{LOSS_WORDS, LossPassBuffers, TargetFormat};
use crate::train::status;
use crate::train::target::Target;

impl Trainer {
    /// Records a step for a target: the order of the paper's algorithm.
    pub(super) fn record(&self, at: usize) -> Result<Commands> {
        let t = &self.targets[at];
        let mut r = self.gpu.recorder("train step").with_timestamps(self.profile);
        r.copy(&t.upload, &t.photo)?;
        let inputs = self.step_inputs(t);
        if let Some(model) = &self.deformation {
            model.record_forward(&mut r, &inputs)?;
        }
        record_forward(&self.gpu, &mut r, &self.parameters.scene, &t.work, &t.frame, &t.shape)?;
        if let Some(model) = &self.deformation {
            model.record_before_loss(&mut r, &inputs)?;
        }
        let loss = LossPassBuffers {
            frame: &t.frame.frame,
            step: &self.step,
            color: &t.frame.color,
            target: &t.photo,
            image_gradient: &t.image_gradient,
            loss: &t.loss,
            status: &self.status,
        };
        t.image_loss.record(&mut r, &loss, TargetFormat::Rgba8)?;
        self.record_blend_backward(&mut r, t)?;
        self.record_project_backward(&mut r, t)?;
        if let Some(model) = &self.deformation {
            model.record_backward(&mut r, &inputs)?;
        }
        self.record_readback(&mut r, t)?;
        r.finish()
    }

    fn step_inputs<'a>(&'a self, t: &'a Target) -> StepInputs<'a> {
        StepInputs {
            scene: &self.parameters.scene,
            frame: &t.frame.frame,
            step: &self.step,
            counters: &t.work.counters,
            status: &self.status,
            pose_gradient: &self.pose_gradient,
        }
    }

    fn record_blend_backward(&self, r: &mut Recorder, t: &Target) -> Result<()> {
        let input = BackwardInput {
            frame: Slice::from(&t.frame.frame),
            counters: t.work.counters.clone(),
            ranges: t.work.ranges.clone(),
            values: Slice::from(t.work.tile_values()),
            tile_count: Slice::from(&t.work.tile_count),
            splats: Slice::from(&t.work.splats),
            color: Slice::from(&t.frame.color),
            image_gradient: Slice::from(&t.image_gradient),
            gaussians: self.parameters.count(),
            tiles: t.shape.tiles,
        };
        let target = match (&t.shape.slots, &t.instance_gradient) {
            (Some(slots), Some(rows)) => BackwardTarget::Instances(slots.clone(), Slice::from(rows)),
            _ if self.gpu.info().capabilities.float_atomics => BackwardTarget::NativeAtomics,
            _ => BackwardTarget::CompareAndSwap,
        };
        blend_backward::record(&self.gpu, r, &input, &target, &Slice::from(&self.splat_gradient))
    }

    fn record_project_backward(&self, r: &mut Recorder, t: &Target) -> Result<()> {
        let pass = ProjectBackward {
            scene: &self.parameters.scene,
            frame: &t.frame.frame,
            work: &t.work,
            step: &self.step,
            status: &self.status,
            splat_gradient: &self.splat_gradient,
            pose_gradient: &self.pose_gradient,
            model: self.deformation.as_ref().map_or_else(ProjectInputs::default, |m| m.project_inputs()),
            output: Output::Adam(&self.parameters),
        };
        pass.record(r)
    }

    fn record_readback(&self, r: &mut Recorder, t: &Target) -> Result<()> {
        let [counters, loss, property, status] = READBACK;
        r.copy(t.work.counters.clone(), self.readback.slice(counters, t.work.counters.bytes))?;
        r.copy(&t.loss, self.readback.slice(loss, LOSS_WORDS as u64 * 4))?;
        if let Some(loss) = self.deformation.as_ref().and_then(|m| m.property_loss()) {
            r.copy(loss, self.readback.slice(property, 16))?;
        }
        r.copy(&self.status, self.readback.slice(status, status::STATUS_WORDS as u64 * 4))?;
        r.host_read(&self.readback);
        Ok(())
    }
}
