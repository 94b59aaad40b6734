//! Exposures on the device, and how they are recorded in a step.

use super::expose::{EXPOSE, ExposeBuffers};
use super::exposure_backward::{EXPOSURE_BACKWARD, ExposureBackwardBuffers};
use super::learn_exposure::{LEARN_EXPOSURE, LearnExposureBuffers, LearnExposurePush};
use super::{EXPOSURE_DECAY, EXPOSURE_PIXELS, EXPOSURE_THREADS, EXPOSURE_VALUES, EXPOSURE_WORDS};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Groups, Memory, Recorder, Slice};

/// Rows of photos whose exposure changes nothing, before the first step.
pub fn identities(photos: usize) -> Vec<f32> {
    let mut row = [0.0; EXPOSURE_WORDS];
    (0..EXPOSURE_VALUES).step_by(5).for_each(|k| row[k] = 1.0);
    row[EXPOSURE_DECAY..EXPOSURE_DECAY + 2].fill(1.0);
    row.repeat(photos)
}

/// The exposures of all photos.
#[derive(Debug)]
pub(in crate::train) struct ExposureState {
    row: Buffer,
    photos: usize,
    hold: f32,
}

/// What a step with exposures needs for one image size.
#[derive(Debug)]
pub(in crate::train) struct ExposurePass {
    /// `vec4[H·W]`: the mapped image.
    pub(in crate::train) exposed: Buffer,
    partial: Buffer,
    pixels: u64,
}

impl ExposurePass {
    pub(in crate::train) fn new(gpu: &Gpu, [width, height]: [u32; 2]) -> Result<Self> {
        let pixels = u64::from(width) * u64::from(height);
        let groups = pixels.div_ceil(EXPOSURE_PIXELS.into());
        Ok(Self {
            exposed: gpu.buffer("exposed", 16 * pixels, Memory::Device)?,
            partial: gpu.buffer("exposure_partial", 4 * EXPOSURE_VALUES as u64 * groups, Memory::Device)?,
            pixels,
        })
    }
}

/// Buffers of a step that belong to others.
#[derive(Debug, Clone, Copy)]
pub(in crate::train) struct ExposureInputs<'a> {
    pub(in crate::train) frame: &'a Buffer,
    pub(in crate::train) step: &'a Buffer,
    pub(in crate::train) color: &'a Buffer,
    pub(in crate::train) image_gradient: &'a Buffer,
    pub(in crate::train) counters: &'a Slice,
    pub(in crate::train) status: &'a Buffer,
}

impl ExposureState {
    /// From the rows of [`identities`], or those that an earlier run left.
    ///
    /// # Errors
    /// `Usage` for rows of another number of photos; `OutOfMemory`.
    pub(in crate::train) fn new(gpu: &Gpu, photos: usize, rows: &[f32], hold: f32) -> Result<Self> {
        if rows.len() != photos * EXPOSURE_WORDS {
            let found = format!("{} numbers", rows.len());
            return Err(Error::usage("exposures", found, format!("{EXPOSURE_WORDS} for each of {photos} photos")));
        }
        Ok(Self { row: gpu.buffer_with("exposure", bytemuck::cast_slice(rows))?, photos, hold })
    }

    /// Number of photos.
    pub(in crate::train) fn photos(&self) -> usize {
        self.photos
    }

    /// Rows of all photos.
    ///
    /// # Errors
    /// `DeviceLost`, `OutOfMemory`.
    pub(in crate::train) fn rows(&self, gpu: &Gpu) -> Result<Vec<f32>> {
        Ok(bytemuck::pod_collect_to_vec(&gpu.download(&self.row)?))
    }

    /// Maps the rendered image; before the loss.
    pub(in crate::train) fn record_forward(
        &self,
        r: &mut Recorder,
        pass: &ExposurePass,
        of: &ExposureInputs<'_>,
    ) -> Result<()> {
        let buffers = ExposeBuffers {
            frame: of.frame.whole(),
            step: of.step.whole(),
            exposure: self.row.whole(),
            color: of.color.whole(),
            exposed: pass.exposed.whole(),
        };
        let groups = Groups::Direct(pass.pixels.div_ceil(EXPOSURE_THREADS.into()));
        r.dispatch(&EXPOSE, (), (), buffers, groups)
    }

    /// Takes the gradient back and learns; after the loss.
    pub(in crate::train) fn record_backward(
        &self,
        r: &mut Recorder,
        pass: &ExposurePass,
        of: &ExposureInputs<'_>,
    ) -> Result<()> {
        let buffers = ExposureBackwardBuffers {
            frame: of.frame.whole(),
            step: of.step.whole(),
            exposure: self.row.whole(),
            color: of.color.whole(),
            image_gradient: of.image_gradient.whole(),
            exposure_partial: pass.partial.whole(),
        };
        let groups = Groups::Direct(pass.pixels.div_ceil(EXPOSURE_PIXELS.into()));
        r.dispatch(&EXPOSURE_BACKWARD, (), (), buffers, groups)?;
        let buffers = LearnExposureBuffers {
            frame: of.frame.whole(),
            step: of.step.whole(),
            exposure: self.row.whole(),
            exposure_partial: pass.partial.whole(),
            counters: of.counters.clone(),
            status: of.status.whole(),
        };
        r.dispatch(&LEARN_EXPOSURE, (), LearnExposurePush { hold: self.hold }, buffers, Groups::Direct(1))
    }
}
