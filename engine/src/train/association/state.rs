//! [`SuperpointState`]: buffers and recording of everything between Gaussians and superpoints in a training step.

use super::association_init::{ASSOCIATION_INIT, AssociationInitBuffers, AssociationInitPush};
use super::superpoint_sum::SUM_PLANES;
use super::{AssociationInit, MAX_NEIGHBORS, MAX_SLOTS, NEW_LOGIT, NO_SUPERPOINT, PAIR_SHIFT};
use crate::error::{Error, Result};
use crate::gpu::product::Stage;
use crate::gpu::{Buffer, Gpu, Groups, Memory, Recorder, Slice};
use crate::render::radix_sort::SortPlan;
use crate::render::superpoint_motion::{BlendSlices, index_planes};
use crate::scene::{Association, Blend, Superpoints};
use crate::train::farthest_point::FarthestPoint;
use crate::train::property_loss::PropertyLoss;
use crate::train::status;
use crate::train::step::Step;

/// Shape of the association and form of its losses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AssociationOptions {
    /// M asked for; at most one superpoint per Gaussian is made.
    pub superpoints: u32,
    /// K, superpoints in use per Gaussian (1..=7); at most M.
    pub neighbors: u32,
    /// K', superpoints remembered per Gaussian (K..=16).
    pub slots: u32,
    /// The superpoints in use move the Gaussian together, weighted by the softmax of its logits; else its own one does.
    pub soft: bool,
    /// First logits.
    pub init: AssociationInit,
    /// Form of the property losses.
    pub property_loss: PropertyLoss,
    /// Farthest-point sampling starts at Gaussian `seed` mod N.
    pub seed: u64,
}

impl AssociationOptions {
    /// K of soft superpoints; 0 without. A Gaussian with a single superpoint moves with that.
    pub fn blend_slots(&self) -> u32 {
        if self.soft && self.neighbors > 1 { self.neighbors } else { 0 }
    }
}

impl Default for AssociationOptions {
    fn default() -> Self {
        Self {
            superpoints: 300,
            neighbors: 5,
            slots: 8,
            soft: false,
            init: AssociationInit::default(),
            property_loss: PropertyLoss::default(),
            seed: 0,
        }
    }
}

/// Buffers of the training step that belong to others.
#[derive(Debug, Clone)]
pub struct StepBuffers {
    /// `Step`; counts = N, M, K', iteration.
    pub step: Slice,
    /// `uint[8]` of the frame.
    pub counters: Slice,
    /// What they begin with: whether a step before this one failed.
    pub failed: Slice,
    /// Not-finite reports.
    pub status: Slice,
    /// `float[3][N]` canonical means.
    pub mean: Slice,
    /// `uint[N]`.
    pub superpoint_of_gaussian: Slice,
    /// `vec4[M][2]` at the step's time.
    pub pose: Slice,
}

/// Association rows that live as long as their Gaussians: gathered by density control, K' words per Gaussian in each.
#[derive(Debug, Clone)]
pub struct Rows {
    /// `uint[N][K']` superpoints: K in use, nearest first, then remembered ones; [`NO_SUPERPOINT`] where never used.
    pub neighbor: Buffer,
    /// `float[N][K']`.
    pub logit: Buffer,
    /// `float[N][K']` Adam's first moment.
    pub moment_1: Buffer,
    /// `float[N][K']` Adam's second moment.
    pub moment_2: Buffer,
}

/// Buffers whose size follows N; nothing in them outlives a step.
#[derive(Debug)]
pub(super) struct Work {
    pub(super) gaussians: u32,
    pub(super) weight: Buffer,
    /// Soft superpoints: `blend_index` of the frame, and the property losses' gradient of the logits; tiny otherwise.
    pub(super) blend_index: Buffer,
    pub(super) logit_gradient: Buffer,
    pub(super) next_superpoint: Buffer,
    pub(super) keys: [Buffer; 2],
    pub(super) values: [Buffer; 2],
    pub(super) plan: SortPlan,
    pub(super) histograms: Vec<Buffer>,
    pub(super) pair_count: Buffer,
    pub(super) residual: Buffer,
    /// Paper's form: properties of the Gaussians, then their gradients; tiny otherwise.
    pub(super) own: Buffer,
    pub(super) mean_gradient: Buffer,
    pub(super) loss_partial: Buffer,
}

/// Superpoints, the association matrix and the property losses on the device.
#[derive(Debug)]
pub struct SuperpointState {
    pub(super) options: AssociationOptions,
    /// How the nearest are looked for on this device.
    pub(super) stage: Stage,
    pub(super) rows: Rows,
    pub(super) work: Work,
    /// `float[M][3]` canonical centres p^c.
    pub position: Buffer,
    /// `float[6][M]` planes: dL/dr, dL/dτ.
    pub gradient: Buffer,
    /// `float[4]`: property losses of position, rotation, translation (unweighted means), weighted total.
    pub property_loss: Buffer,
    /// Σa, Σa·mean and (code) residuals or (paper) properties.
    pub(super) first_sum: Buffer,
    pub(super) residual_sum: Buffer,
    pub(super) own_sum: Buffer,
    pub(super) pose_sum: Buffer,
    /// Where each superpoint's pairs start in the step's order.
    pub(super) range: Buffer,
}

impl SuperpointState {
    /// Samples min(M, N) superpoint centres, assigns every Gaussian to its nearest (written to
    /// `superpoint_of_gaussian`), fills the association. `mean` is `float[3][N]`. Blocks.
    ///
    /// # Errors
    /// `Usage` for K or K' out of range or no Gaussian, `Limit` for too many, or when memory runs out.
    pub fn init(
        gpu: &Gpu,
        mean: &Slice,
        superpoint_of_gaussian: &Slice,
        gaussians: u32,
        options: AssociationOptions,
    ) -> Result<Self> {
        let superpoints = options.superpoints.min(gaussians);
        let state = Self::allocate(gpu, gaussians, AssociationOptions { superpoints, ..options })?;
        let m = state.superpoints();
        let mut r = gpu.recorder("superpoint init");
        let chosen = gpu.buffer("chosen", 4 * u64::from(m), Memory::Device)?;
        let sampling = FarthestPoint::new(gpu, gaussians, options.seed)?;
        sampling.record(&mut r, mean, m, &Slice::from(&chosen), &Slice::from(&state.position))?;
        let step = Step { gaussians, superpoints: m, neighbors: state.options.slots, ..Step::default() };
        let step = gpu.buffer_with("init step", bytemuck::bytes_of(&step))?;
        let counters = Slice::from(&gpu.buffer_with("init counters", &[0; 32])?);
        let b = StepBuffers {
            step: Slice::from(&step),
            counters: counters.clone(),
            failed: counters,
            status: Slice::from(&gpu.buffer_with("init status", bytemuck::cast_slice(&status::clear()))?),
            mean: mean.clone(),
            superpoint_of_gaussian: superpoint_of_gaussian.clone(),
            pose: Slice::from(&state.gradient),
        };
        state.clear_rows(&mut r)?;
        r.fill(superpoint_of_gaussian, 0)?;
        state.record_nearest(&mut r, &b)?;
        let (logit, paper) = match options.init {
            AssociationInit::Code => (1.0, 0),
            AssociationInit::Paper => (0.9, 1),
        };
        let buffers = AssociationInitBuffers {
            step: b.step,
            neighbor: state.rows.neighbor.whole(),
            chosen: chosen.whole(),
            logit: state.rows.logit.whole(),
            superpoint_of_gaussian: superpoint_of_gaussian.clone(),
        };
        let push = AssociationInitPush { logit, paper };
        let groups = Groups::Direct(gaussians.div_ceil(256).into());
        r.dispatch(&ASSOCIATION_INIT, state.constants(), push, buffers, groups)?;
        gpu.run(r)?;
        Ok(state)
    }

    /// From a model or checkpoint: centres, rows (K' per Gaussian) and moments (empty: zero).
    ///
    /// # Errors
    /// As [`SuperpointState::init`], and `Usage` when lengths do not fit or a neighbour is out of range.
    pub fn from_parts(
        gpu: &Gpu,
        position: &[[f32; 3]],
        association: &Association,
        moments: [&[f32]; 2],
        options: AssociationOptions,
    ) -> Result<Self> {
        let (m, slots) = (position.len() as u32, association.neighbors);
        let n = association.neighbor.len() / slots.max(1);
        let bad = association.neighbor.iter().find(|&&j| j != NO_SUPERPOINT && j >= m);
        if let Some(j) = bad {
            return Err(Error::usage("association.neighbor", j.to_string(), format!("less than {m}")));
        }
        let lengths = [association.neighbor.len(), association.logit.len()];
        let moments_fit = moments.iter().all(|v| v.is_empty() || v.len() == n * slots);
        if lengths != [n * slots; 2] || !moments_fit {
            let found = format!("{lengths:?} and {:?}", moments.map(<[f32]>::len));
            return Err(Error::usage("association", found, format!("{n} rows of {slots}")));
        }
        // Pruning may have left fewer Gaussians than superpoints.
        let options = AssociationOptions { superpoints: m, slots: slots as u32, ..options };
        let state = Self::allocate(gpu, n as u32, options)?;
        let mut r = gpu.recorder("clear association");
        state.clear_rows(&mut r)?;
        gpu.run(r)?;
        gpu.upload(&state.position, bytemuck::cast_slice(position))?;
        gpu.upload(&state.rows.neighbor, bytemuck::cast_slice(&association.neighbor))?;
        gpu.upload(&state.rows.logit, bytemuck::cast_slice(&association.logit))?;
        gpu.upload(&state.rows.moment_1, bytemuck::cast_slice(moments[0]))?;
        gpu.upload(&state.rows.moment_2, bytemuck::cast_slice(moments[1]))?;
        Ok(state)
    }

    fn allocate(gpu: &Gpu, gaussians: u32, mut options: AssociationOptions) -> Result<Self> {
        let in_range = |what, value: u32, low, high| match (low..=high).contains(&value) {
            true => Ok(()),
            false => Err(Error::usage(what, value.to_string(), format!("{low} to {high}"))),
        };
        in_range("gaussians with superpoints", gaussians, 1, (1 << PAIR_SHIFT) - 1)?;
        in_range("association neighbors", options.neighbors, 1, MAX_NEIGHBORS)?;
        in_range("association slots", options.slots, options.neighbors, MAX_SLOTS)?;
        let most_superpoints = if options.soft { 1 << 16 } else { u32::MAX };
        in_range("superpoints", options.superpoints, 1, most_superpoints)?;
        let most_soft = Blend::MOST_NEIGHBORS as u32;
        in_range("soft superpoints per Gaussian", if options.soft { options.neighbors } else { 1 }, 1, most_soft)?;
        options.neighbors = options.neighbors.min(options.superpoints);
        let m = u64::from(options.superpoints);
        let device = |name: &str, words: u64| gpu.buffer(name, 4 * words, Memory::Device);
        let sums = |name| device(name, SUM_PLANES as u64 * m);
        Ok(Self {
            stage: Stage::of(gpu),
            rows: allocate_rows(gpu, gaussians, options.slots)?,
            work: Work::new(gpu, gaussians, &options)?,
            position: device("superpoint_position", 3 * m)?,
            gradient: device("superpoint_gradient", 8 * m)?,
            property_loss: device("property_loss", 4)?,
            first_sum: sums("property_sum")?,
            residual_sum: sums("residual_sum")?,
            own_sum: sums("own_sum")?,
            pose_sum: sums("pose_sum")?,
            range: device("superpoint_range", 3 * m)?,
            options,
        })
    }

    fn clear_rows(&self, r: &mut Recorder) -> Result<()> {
        r.fill(&self.rows.neighbor, NO_SUPERPOINT)?;
        r.fill(&self.rows.logit, NEW_LOGIT.to_bits())?;
        r.fill(&self.rows.moment_1, 0)?;
        r.fill(&self.rows.moment_2, 0)
    }

    /// M.
    pub fn superpoints(&self) -> u32 {
        self.options.superpoints
    }

    /// N.
    pub fn gaussians(&self) -> u32 {
        self.work.gaussians
    }

    /// Options with M and K as they are.
    pub fn options(&self) -> &AssociationOptions {
        &self.options
    }

    /// The rows, for density control to gather from.
    pub fn rows(&self) -> &Rows {
        &self.rows
    }

    /// Gradient of the property losses by the canonical means, `float[3][N]`: only the paper's form has one.
    pub fn mean_gradient(&self) -> Option<&Buffer> {
        (self.options.property_loss == PropertyLoss::Paper).then_some(&self.work.mean_gradient)
    }

    /// After density control: `gaussians` Gaussians with these gathered rows. Commands recorded before are void.
    ///
    /// # Errors
    /// `Usage` without Gaussians, or when memory runs out.
    pub fn resize(&mut self, gpu: &Gpu, gaussians: u32, rows: Rows) -> Result<()> {
        if gaussians == 0 || gaussians >= 1 << PAIR_SHIFT {
            let range = format!("1 to {}", (1 << PAIR_SHIFT) - 1);
            return Err(Error::usage("gaussians with superpoints", gaussians.to_string(), range));
        }
        self.rows = rows;
        if gaussians != self.work.gaussians {
            self.work = Work::new(gpu, gaussians, &self.options)?;
        }
        Ok(())
    }

    /// `blend_index` and `blend_weight` of soft superpoints: all but the last plane of `weight`.
    pub fn blend(&self) -> Option<BlendSlices> {
        let slots = self.options.blend_slots();
        let (index, weight) = (self.work.blend_index.whole(), self.work.weight.whole());
        (slots > 0).then_some(BlendSlices { slots, index, weight })
    }

    /// Superpoints in use per Gaussian: the first of each row.
    pub fn neighbors(&self) -> u32 {
        self.options.neighbors
    }

    /// Reads back superpoints and the whole rows of the association. Blocks.
    pub fn download(&self, gpu: &Gpu, superpoint_of_gaussian: &Slice) -> Result<(Superpoints, Association)> {
        let (n, m) = (self.gaussians() as usize, self.superpoints() as usize);
        let words = |slice: Slice, count: usize| -> Result<Vec<u32>> {
            let bytes = gpu.download(slice.buffer.slice(slice.start, 4 * count as u64))?;
            Ok(bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
        };
        let slots = self.options.slots as usize;
        let floats = |w: Vec<u32>| w.into_iter().map(f32::from_bits).collect::<Vec<f32>>();
        let position = floats(words(Slice::from(&self.position), 3 * m)?);
        let superpoints = Superpoints {
            of_gaussian: words(superpoint_of_gaussian.clone(), n)?,
            position: position.as_chunks::<3>().0.to_vec(),
        };
        let association = Association {
            neighbors: slots,
            neighbor: words(Slice::from(&self.rows.neighbor), n * slots)?,
            logit: floats(words(Slice::from(&self.rows.logit), n * slots)?),
        };
        Ok((superpoints, association))
    }

    /// Reads back Adam's moments of the logits, `[N,K']` each, for a checkpoint. Blocks.
    pub fn download_moments(&self, gpu: &Gpu) -> Result<[Vec<f32>; 2]> {
        let bytes = 4 * u64::from(self.gaussians()) * u64::from(self.options.slots);
        let read = |b: &Buffer| gpu.download(b.slice(0, bytes)).map(|b| bytemuck::pod_collect_to_vec(&b));
        Ok([read(&self.rows.moment_1)?, read(&self.rows.moment_2)?])
    }
}

fn allocate_rows(gpu: &Gpu, gaussians: u32, slots: u32) -> Result<Rows> {
    let row = |name| gpu.buffer(name, 4 * u64::from(gaussians) * u64::from(slots), Memory::Device);
    Ok(Rows {
        neighbor: row("neighbor")?,
        logit: row("logit")?,
        moment_1: row("logit_moment_1")?,
        moment_2: row("logit_moment_2")?,
    })
}

impl Work {
    fn new(gpu: &Gpu, gaussians: u32, options: &AssociationOptions) -> Result<Self> {
        let n = u64::from(gaussians);
        let pairs = n * u64::from(options.neighbors + 1);
        let capacity = u32::try_from(pairs).map_err(|_| Error::Limit {
            what: "pairs of Gaussians and superpoints".into(),
            need: pairs.into(),
            have: u32::MAX.into(),
        })?;
        let plan = SortPlan::new(capacity, (u32::BITS - (options.superpoints - 1).leading_zeros()).max(1))?;
        let device = |name: &str, words: u64| gpu.buffer(name, 4 * words, Memory::Device);
        let histograms = (0..plan.digits.len())
            .map(|_| gpu.buffer("pair_histogram", plan.histogram_bytes(), Memory::Device))
            .collect::<Result<_>>()?;
        let paper = u64::from(options.property_loss == PropertyLoss::Paper);
        Ok(Self {
            gaussians,
            weight: device("weight", n * u64::from(options.neighbors))?,
            blend_index: device("blend_index", n * u64::from(index_planes(options.blend_slots())))?,
            logit_gradient: device("logit_gradient", n * u64::from(options.blend_slots()))?,
            next_superpoint: device("next_superpoint", n)?,
            keys: [device("pair_key", pairs)?, device("pair_key", pairs)?],
            values: [device("pair_value", pairs)?, device("pair_value", pairs)?],
            plan,
            histograms,
            pair_count: gpu.buffer_with("pair_count", bytemuck::cast_slice(&[capacity, 0, 0, 0]))?,
            residual: device("residual", 9 * n)?,
            own: device("own_gradient", 9 * n * paper)?,
            mean_gradient: device("property_mean_gradient", 3 * n * paper)?,
            loss_partial: device("loss_partial", 4 * n.div_ceil(256))?,
        })
    }
}
