//! Density control in the trainer: what a pass needs and what it replaces.

use super::blend_backward::ROW_WORDS;
use super::density::{
    Density, DensityBuffers, DensityChange, DensityOptions, DensityOutcome, NewRows, RowArray, reset_opacity,
};
use super::trainer::{Trainer, pose_gradient_bytes};
use crate::data::dataset::View;
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Memory};
use crate::scene::parameter::{PARAMETERS, in_degree};

/// Opacity that a reset leaves at most (3DGS).
const RESET_OPACITY: f64 = 0.01;

/// Bytes of a step's buffers per Gaussian: splats, tile counts, keys and values by depth, gradients.
const WORK_BYTES: u64 = 192;
/// Tile instances per Gaussian to have room for.
const INSTANCES: u64 = 8;
/// Bytes of a tile instance: keys and values for sorting, its row of gradients.
const INSTANCE_BYTES: u64 = 72;
/// Bytes per pixel: photo, rendering, gradient, work space of SSIM.
const PIXEL_BYTES: u64 = 96;
impl Trainer {
    /// Whether [`Trainer::adapt_density`] does anything after `iteration`.
    pub(super) fn adapts_density(&self, iteration: u64) -> bool {
        let s = &self.schedule;
        s.grows(iteration) || s.prunes(iteration) || s.resets_opacity(iteration) || s.prunes_unseen(iteration)
    }

    /// Clone, split, prune and reset after `iteration`, as the schedule says.
    pub(super) fn adapt_density(&mut self, iteration: u64) -> Result<()> {
        let (grows, prunes) = (self.schedule.grows(iteration), self.schedule.prunes(iteration));
        let n = self.parameters.count();
        let mut change = DensityChange { before: n, after: n, ..DensityChange::default() };
        if (grows || prunes) && n > 0 {
            match self.pass(iteration, grows, prunes)? {
                Some(o) => {
                    (change.after, change.cloned, change.split) = (o.new_count, o.cloned, o.split);
                    (change.pruned, change.refused) = (o.pruned, o.refused);
                }
                None => change.refused = n,
            }
        }
        if self.schedule.resets_opacity(iteration) {
            reset_opacity(&self.gpu, self.parameters.opacity_rows(), RESET_OPACITY)?;
            change.opacity_reset = true;
        }
        let unseen = self.schedule.prunes_unseen(iteration) && self.parameters.count() > 0;
        if let Some(o) = if unseen { self.prune_unseen(iteration)? } else { None } {
            (change.after, change.unseen) = (o.new_count, o.pruned);
        }
        if change.opacity_reset || grows || prunes || unseen {
            self.density_change = Some(change);
        }
        Ok(())
    }

    /// `None` where there is no room for a second copy of an array: the Gaussians are as they were then.
    pub(super) fn pass(&mut self, iteration: u64, grows: bool, prunes: bool) -> Result<Option<DensityOutcome>> {
        // Recorded commands hold the old buffers.
        self.targets.clear();
        let d = &self.schedule.config().density;
        let large = prunes && self.schedule.prunes_large(iteration);
        let options = DensityOptions {
            gradient_threshold: if grows { d.gradient_threshold } else { f32::INFINITY },
            // The smallest opacity there is when nothing is to be pruned.
            min_opacity: if prunes { f64::from(d.min_opacity).max(1e-30) } else { 1e-30 },
            percent_dense: f64::from(d.clone_extent),
            extent: self.schedule.extent(),
            world_size: (large && d.max_extent > 0.0).then_some(f64::from(d.max_extent)),
            max_screen_radius: (large && d.max_radius_px > 0.0).then_some(d.max_radius_px),
            max_gaussians: self.most_gaussians(),
            seed: self.config.seed,
            iteration: iteration as u32,
        };
        let n = self.parameters.count();
        let outcome = match Density::new(&self.gpu).run(self.density_buffers(), n, &options) {
            Ok(outcome) => outcome,
            Err(Error::OutOfMemory { .. }) => return Ok(None),
            Err(e) => return Err(e),
        };
        self.take(outcome.new_count, outcome.buffers.clone())?;
        Ok(Some(outcome))
    }

    /// The configured number, or fewer where the device's memory ends: of what is free now, the images of a step come off,
    /// the rest goes to new Gaussians. Nothing here depends on which images the run has seen, so that a resumed run decides
    /// alike.
    fn most_gaussians(&self) -> u32 {
        let (used, budget) = self.gpu.memory_used();
        let n = u64::from(self.parameters.count());
        let (rows, work) = self.deformation.as_ref().map_or((0, 0), |m| (m.row_bytes(), m.bytes_per_gaussian()));
        // Parameters and moments exist twice while they are moved.
        let kept = 2 * (3 * 4 * u64::from(self.parameters.planes()) + rows + 16);
        let each = kept + WORK_BYTES + work + INSTANCES * INSTANCE_BYTES;
        let pixels = |v: &View| u64::from(v.camera.width) * u64::from(v.camera.height);
        let images = PIXEL_BYTES * self.pyramid.views.iter().map(pixels).max().unwrap_or(0);
        // The step's own buffers for the Gaussians there are were freed before this.
        let own = n * (WORK_BYTES + INSTANCES * INSTANCE_BYTES);
        let free = budget.saturating_sub(used + images + own);
        self.config.budget.max_gaussians.min(u32::try_from(n + free / each).unwrap_or(u32::MAX))
    }

    fn density_buffers(&self) -> DensityBuffers {
        let (p, s) = (&self.parameters, &self.parameters.scene);
        let row = |buffer: &Buffer, [planes, width]: [u32; 2], new_rows: NewRows| RowArray {
            buffer: buffer.clone(),
            planes,
            width,
            new_rows,
        };
        let parameters = PARAMETERS.iter().zip(&s.parameter).enumerate().map(|(i, (parameter, buffer))| {
            let shape = if in_degree(i, p.sh_degree) { parameter.planes_and_width() } else { [0, 0] };
            row(buffer, shape, parameter.new_rows)
        });
        let moments = [&p.moment_1, &p.moment_2].map(|moment| row(moment, [p.planes(), 1], NewRows::Zero));
        let mut rows = moments.to_vec();
        rows.push(row(&s.deformation.superpoint_of_gaussian, [1, 1], NewRows::Copy));
        rows.extend(s.optional.iter().map(|buffer| row(buffer, [s.present.planes(), 1], NewRows::Copy)));
        rows.extend(self.deformation.iter().flat_map(|m| m.density_rows()));
        DensityBuffers {
            parameters: parameters.collect(),
            density: p.density.clone(),
            max_radius: p.max_radius.clone(),
            rows,
        }
    }

    /// Goes on with `n` Gaussians in these buffers, in the order of [`Trainer::density_buffers`].
    fn take(&mut self, n: u32, b: DensityBuffers) -> Result<()> {
        let mut rows = b.rows.into_iter().map(|r| r.buffer);
        let mut next = || rows.next().ok_or_else(|| Error::usage("density control", "too few arrays", "all of them"));
        let p = &mut self.parameters;
        p.scene.gaussians = n;
        p.scene.parameter = b.parameters.into_iter().map(|row| row.buffer).collect();
        (p.density, p.max_radius) = (b.density, b.max_radius);
        (p.moment_1, p.moment_2) = (next()?, next()?);
        p.scene.deformation.superpoint_of_gaussian = next()?;
        if p.scene.optional.is_some() {
            p.scene.optional = Some(next()?);
        }
        p.scene.deformation.rest();
        if let Some(model) = self.deformation.take() {
            self.deformation = model.resized(&self.gpu, n, &mut rows)?;
        }
        if let Some(model) = &self.deformation {
            model.attach(&mut self.parameters.scene.deformation);
        }
        self.allocate_gradients()
    }

    /// Buffers of a step that follow the number of Gaussians.
    pub(super) fn allocate_gradients(&mut self) -> Result<()> {
        let n = u64::from(self.parameters.count().max(1));
        self.splat_gradient = self.gpu.buffer("splat_gradient", n * u64::from(ROW_WORDS) * 4, Memory::Device)?;
        let bytes = n * pose_gradient_bytes(&self.config);
        self.pose_gradient = self.gpu.buffer("pose_gradient", bytes, Memory::Device)?;
        Ok(())
    }
}
