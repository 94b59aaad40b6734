//! Recording of a step: the order of the paper's algorithm. What does not depend on each other then runs beside each other.

use super::{Profile, READBACK, Slot, Trainer, cost};
use crate::error::Result;
use crate::gpu::{Buffer, Commands, Recorder, Slice};
use crate::render::limits::COUNT_FAILED;
use crate::render::pipeline::{FrameBuffers, record_forward};
use crate::train::blend_backward::{self, BackwardInput, BackwardTarget};
use crate::train::deform_project_backward::{Output, ProjectBackward};
use crate::train::deformation::{ProjectInputs, StepInputs};
use crate::train::exposure::ExposureInputs;
use crate::train::image_loss::{LOSS_WORDS, LossPassBuffers, TargetFormat};
use crate::train::status;
use crate::train::target::Target;

impl Trainer {
    /// Records a step for a target and a place among the steps in flight: the order of the paper's algorithm.
    pub(super) fn record(&self, at: usize, slot: usize) -> Result<Commands> {
        let (t, Slot { step, readback }) = (&self.targets[at], &self.slots[slot]);
        let frame = &t.frames[slot];
        let profile = self.profile != Profile::Off;
        let mut r = self.gpu.recorder("train step").with_timestamps_on_request(profile).with_overlap(cost::of);
        let inputs = self.step_inputs(t, frame, step);
        if let Some(model) = &self.deformation {
            model.record_forward(&mut r, &inputs)?;
        }
        record_forward(&self.gpu, &mut r, &self.parameters.scene, &t.work, frame, &t.shape)?;
        if let Some(model) = &self.deformation {
            model.record_before_loss(&mut r, &inputs)?;
        }
        let exposure = self.exposure.as_ref().zip(t.exposure.as_ref());
        let exposed = ExposureInputs {
            frame: &frame.frame,
            step,
            color: &frame.color,
            image_gradient: &t.image_gradient,
            counters: &t.work.counters,
            status: &self.status,
        };
        if let Some((state, pass)) = exposure {
            state.record_forward(&mut r, pass, &exposed)?;
        }
        let loss = LossPassBuffers {
            frame: &frame.frame,
            step,
            color: exposure.map_or(&frame.color, |(_, pass)| &pass.exposed),
            target: &self.photos.buffer,
            image_gradient: &t.image_gradient,
            loss: &t.loss,
            status: &self.status,
        };
        let masked = self.transients.is_some() || self.pyramid.views.iter().any(|v| v.image.used.is_some());
        t.image_loss.record(&mut r, &loss, TargetFormat::of_photos(masked))?;
        if let Some((state, pass)) = exposure {
            state.record_backward(&mut r, pass, &exposed)?;
        }
        self.record_blend_backward(&mut r, t, frame)?;
        self.record_project_backward(&mut r, t, &inputs)?;
        if let Some(model) = &self.deformation {
            model.record_backward(&mut r, &inputs)?;
        }
        self.record_readback(&mut r, t, readback)?;
        r.finish()
    }

    fn step_inputs<'a>(&'a self, t: &'a Target, frame: &'a FrameBuffers, step: &'a Buffer) -> StepInputs<'a> {
        StepInputs {
            scene: &self.parameters.scene,
            frame: &frame.frame,
            step,
            counters: &t.work.counters,
            failed: &self.failed,
            status: &self.status,
            status_beside: &self.status_beside,
            pose_gradient: &self.pose_gradient,
        }
    }

    fn record_blend_backward(&self, r: &mut Recorder, t: &Target, frame: &FrameBuffers) -> Result<()> {
        let input = BackwardInput {
            absolute: self.config.density.enabled && self.config.density.absolute_gradient,
            ..BackwardInput::new(&t.work, frame, &t.image_gradient, self.parameters.count(), &t.shape)
        };
        let target = match (&t.shape.slots, &t.instance_gradient) {
            (Some(slots), Some(rows)) => BackwardTarget::Instances(slots.clone(), Slice::from(rows)),
            _ if self.gpu.info().capabilities.float_atomics => BackwardTarget::NativeAtomics,
            _ => BackwardTarget::CompareAndSwap,
        };
        blend_backward::record(&self.gpu, r, &input, &target, &Slice::from(&self.splat_gradient))
    }

    fn record_project_backward(&self, r: &mut Recorder, t: &Target, inputs: &StepInputs<'_>) -> Result<()> {
        let pass = ProjectBackward {
            scene: &self.parameters.scene,
            frame: inputs.frame,
            work: &t.work,
            step: inputs.step,
            status: &self.status,
            splat_gradient: &self.splat_gradient,
            pose_gradient: &self.pose_gradient,
            model: self.deformation.as_ref().map_or_else(ProjectInputs::default, |m| m.project_inputs()),
            output: Output::Adam(&self.parameters),
        };
        pass.record(r)
    }

    fn record_readback(&self, r: &mut Recorder, t: &Target, readback: &Buffer) -> Result<()> {
        let [counters, loss, property, status, status_beside] = READBACK;
        // What failed fails all that is submitted behind it, until the host has cleared it.
        let failed = 4 * u64::from(COUNT_FAILED);
        r.copy(t.work.zeroed.slice(t.work.counters.start + failed, 4), self.failed.slice(failed, 4))?;
        r.copy(t.work.counters.clone(), readback.slice(counters, t.work.counters.bytes))?;
        r.copy(&t.loss, readback.slice(loss, LOSS_WORDS as u64 * 4))?;
        if let Some(loss) = self.deformation.as_ref().and_then(|m| m.property_loss()) {
            r.copy(loss, readback.slice(property, 16))?;
        }
        r.copy(&self.status, readback.slice(status, status::STATUS_WORDS as u64 * 4))?;
        r.copy(&self.status_beside, readback.slice(status_beside, status::STATUS_WORDS as u64 * 4))?;
        r.host_read(readback);
        Ok(())
    }
}
