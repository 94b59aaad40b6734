//! What a training step records between Gaussians and superpoints.

use super::nearest::{ASSOCIATION_GROUP, NEAREST_SUPERPOINTS};
use super::segment::{SUPERPOINT_SUM, SuperpointSumPush};
use super::state::{StepBuffers, SuperpointState};
use super::update::{POSE_GROUP, SUPERPOINT_COMMIT, SUPERPOINT_GRADIENT};
use crate::error::Result;
use crate::gpu::{Buffer, Groups, Recorder, Slice};
use crate::render::radix_sort::rank_by_ballot;
use crate::render::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers};
use crate::render::sort_scatter::{SORT_SCATTER, SortScatterBuffers};
use crate::render::sort_spine::{SORT_SPINE, SPINE_GROUPS, SortSpineBuffers};
use crate::train::property_loss::PropertyLoss;
use crate::train::property_loss::backward::{PROPERTY_BACKWARD, PROPERTY_VALUES};
use crate::train::property_loss::residual::{PROPERTY_RESIDUAL, PROPERTY_TOTAL};

impl SuperpointState {
    /// The part before `deform_project_backward` (it needs the old means) and after the forward pass (a failed one is
    /// known by then): nearest superpoints, sort, property losses with the logits' update, sums for the next centres.
    pub fn record_before(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        self.record_nearest(r, b)?;
        self.record_sort(r)?;
        match self.options.property_loss {
            PropertyLoss::Off => self.record_sum(r, b, &self.first_sum, [1, 0, 0, 0], [None, None]),
            PropertyLoss::Code => self.record_code(r, b),
            PropertyLoss::Paper => self.record_paper(r, b),
        }
    }

    /// The part after `deform_project_backward`: `pose_gradient` `float[6][N]` → [`SuperpointState::gradient`].
    pub fn record_reduce_pose(&self, r: &mut Recorder, b: &StepBuffers, pose_gradient: &Slice) -> Result<()> {
        self.record_own_sum(r, b, &self.pose_sum, [0, 6], pose_gradient, POSE_GROUP)?;
        let (form, sums) = match self.options.property_loss {
            PropertyLoss::Off => (0, &self.first_sum),
            PropertyLoss::Code => (1, &self.first_sum),
            PropertyLoss::Paper => (2, &self.own_sum),
        };
        let buffers = [
            b.step.clone(),
            b.pose.clone(),
            Slice::from(&self.position),
            Slice::from(sums),
            Slice::from(&self.pose_sum),
            Slice::from(&self.gradient),
            b.status.clone(),
        ];
        let groups = Groups::Direct(self.superpoints().div_ceil(256).into());
        r.dispatch_untyped(&SUPERPOINT_GRADIENT, &[form], &[], &buffers, groups)
    }

    /// The end of the step, after everything that reads the assignment or the centres: both become the next step's.
    pub fn record_commit(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let buffers = [
            b.step.clone(),
            b.counters.clone(),
            Slice::from(&self.first_sum),
            Slice::from(&self.work.next_superpoint),
            b.superpoint_of_gaussian.clone(),
            Slice::from(&self.position),
            b.status.clone(),
        ];
        let groups = Groups::Direct(self.gaussians().max(self.superpoints()).div_ceil(256).into());
        r.dispatch_untyped(&SUPERPOINT_COMMIT, &[], &[], &buffers, groups)
    }

    fn per_gaussian(&self) -> Groups {
        Groups::Direct(self.gaussians().div_ceil(256).into())
    }

    fn shape(&self) -> [u32; 2] {
        [self.options.neighbors, self.options.slots]
    }

    fn logits(&self) -> [Slice; 3] {
        [&self.rows.logit, &self.rows.moment_1, &self.rows.moment_2].map(Slice::from)
    }

    pub(super) fn record_nearest(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let [logit, moment_1, moment_2] = self.logits();
        let buffers = [
            b.step.clone(),
            b.counters.clone(),
            b.mean.clone(),
            Slice::from(&self.position),
            b.superpoint_of_gaussian.clone(),
            Slice::from(&self.rows.neighbor),
            logit,
            moment_1,
            moment_2,
            Slice::from(&self.work.weight),
            Slice::from(&self.work.next_superpoint),
            Slice::from(&self.work.keys[0]),
            Slice::from(&self.work.values[0]),
            b.status.clone(),
        ];
        r.dispatch_untyped(&NEAREST_SUPERPOINTS, &self.shape(), &[], &buffers, self.per_gaussian())
    }

    fn record_sort(&self, r: &mut Recorder) -> Result<()> {
        let w = &self.work;
        let count = Slice::from(&w.pair_count);
        let groups = || Groups::Direct(w.plan.partitions.into());
        for histogram in &w.histograms[1..] {
            r.fill(histogram, 0)?;
        }
        let buffers = SortHistogramBuffers {
            counters: count.clone(),
            keys: w.keys[0].whole(),
            histogram: w.histograms[0].whole(),
        };
        let push = w.plan.histogram_push(0);
        r.dispatch_labelled("sort_histogram pairs", &SORT_HISTOGRAM, (), push, buffers, groups())?;
        for pass in 0..w.plan.digits.len() {
            let (from, to) = (pass % 2, (pass + 1) % 2);
            let histogram = w.histograms[pass].whole();
            if w.plan.prescanned {
                let buffers = SortSpineBuffers { counters: count.clone(), histogram: histogram.clone() };
                let label = format!("sort_spine pairs {pass}");
                let spine = Groups::Direct(SPINE_GROUPS.into());
                r.dispatch_labelled(&label, &SORT_SPINE, (), w.plan.spine_push(0), buffers, spine)?;
            }
            let buffers = SortScatterBuffers {
                counters: count.clone(),
                histogram,
                keys_in: w.keys[from].whole(),
                values_in: Some(w.values[from].whole()),
                keys_out: w.keys[to].whole(),
                values_out: Some(w.values[to].whole()),
                next_histogram: w.histograms.get(pass + 1).map(Buffer::whole),
            };
            let push = w.plan.scatter_push(pass, 0);
            let constants = w.plan.scatter_constants(pass, true, rank_by_ballot(r.subgroup_size_of(&SORT_SCATTER)));
            let label = format!("sort_scatter pairs {pass}");
            r.dispatch_labelled(&label, &SORT_SCATTER, constants, push, buffers, groups())?;
        }
        Ok(())
    }

    fn record_code(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        self.record_residual(r, b, 0)?;
        let residual = Slice::from(&self.work.residual);
        // Position (planes 0-2) is a constant of each Gaussian: only rotation and translation pull at its own superpoint.
        self.record_sum(r, b, &self.first_sum, [1, 9, 3, 6], [Some(&residual), Some(&residual)])?;
        self.record_total(r, b)
    }

    fn record_paper(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let (own, residual) = (Slice::from(&self.work.own), Slice::from(&self.work.residual));
        let buffers = [b.step.clone(), b.mean.clone(), b.superpoint_of_gaussian.clone(), b.pose.clone(), own.clone()];
        r.dispatch_untyped(&PROPERTY_VALUES, &[], &[], &buffers, self.per_gaussian())?;
        self.record_sum(r, b, &self.first_sum, [1, 9, 0, 0], [Some(&own), None])?;
        self.record_residual(r, b, 1)?;
        self.record_sum(r, b, &self.residual_sum, [0, 9, 0, 0], [Some(&residual), None])?;
        let [logit, moment_1, moment_2] = self.logits();
        let buffers = [
            b.step.clone(),
            b.counters.clone(),
            b.mean.clone(),
            b.superpoint_of_gaussian.clone(),
            b.pose.clone(),
            Slice::from(&self.first_sum),
            Slice::from(&self.residual_sum),
            Slice::from(&self.rows.neighbor),
            Slice::from(&self.work.weight),
            logit,
            moment_1,
            moment_2,
            residual,
            own.clone(),
            Slice::from(&self.work.mean_gradient),
            b.status.clone(),
        ];
        r.dispatch_untyped(&PROPERTY_BACKWARD, &self.shape(), &[], &buffers, self.per_gaussian())?;
        self.record_own_sum(r, b, &self.own_sum, [0, 9], &own, ASSOCIATION_GROUP)?;
        self.record_total(r, b)
    }

    fn record_residual(&self, r: &mut Recorder, b: &StepBuffers, paper: u32) -> Result<()> {
        let [logit, moment_1, moment_2] = self.logits();
        let buffers = [
            b.step.clone(),
            b.counters.clone(),
            b.mean.clone(),
            b.superpoint_of_gaussian.clone(),
            b.pose.clone(),
            Slice::from(&self.position),
            Slice::from(&self.first_sum),
            Slice::from(&self.rows.neighbor),
            Slice::from(&self.work.weight),
            logit,
            moment_1,
            moment_2,
            Slice::from(&self.work.residual),
            Slice::from(&self.work.loss_partial),
            b.status.clone(),
        ];
        let [neighbors, slots] = self.shape();
        r.dispatch_untyped(&PROPERTY_RESIDUAL, &[neighbors, slots, paper], &[], &buffers, self.per_gaussian())
    }

    fn record_total(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let buffers = [b.step.clone(), Slice::from(&self.work.loss_partial), Slice::from(&self.property_loss)];
        r.dispatch_untyped(&PROPERTY_TOTAL, &[], &[], &buffers, Groups::Direct(1))
    }

    fn record_own_sum(
        &self,
        r: &mut Recorder,
        b: &StepBuffers,
        sums: &Buffer,
        [first, planes]: [u32; 2],
        data: &Slice,
        group: usize,
    ) -> Result<()> {
        self.record_sum_of(r, b, sums, [0, 0, first, planes], [None, Some(data)], group)
    }

    fn record_sum(
        &self,
        r: &mut Recorder,
        b: &StepBuffers,
        sums: &Buffer,
        spec: [u32; 4],
        data: [Option<&Slice>; 2],
    ) -> Result<()> {
        self.record_sum_of(r, b, sums, spec, data, ASSOCIATION_GROUP)
    }

    /// `superpoint_sum` with its spec constants; the means stand in for data that is not summed.
    fn record_sum_of(
        &self,
        r: &mut Recorder,
        b: &StepBuffers,
        sums: &Buffer,
        spec: [u32; 4],
        data: [Option<&Slice>; 2],
        group: usize,
    ) -> Result<()> {
        let w = &self.work;
        let sorted = w.plan.result_in();
        let [pair_data, own_data] = data.map(|d| d.cloned().unwrap_or_else(|| b.mean.clone()));
        let buffers = [
            b.step.clone(),
            Slice::from(&w.keys[sorted]),
            Slice::from(&w.values[sorted]),
            Slice::from(&w.weight),
            b.mean.clone(),
            pair_data,
            own_data,
            Slice::from(sums),
            b.status.clone(),
        ];
        let push =
            SuperpointSumPush { neighbors: self.options.neighbors, pairs: w.plan.capacity, status_group: group as u32 };
        let label = format!("superpoint_sum {}", sums.name());
        let groups = Groups::Direct(self.superpoints().into());
        r.dispatch_untyped_labelled(&label, &SUPERPOINT_SUM, &spec, bytemuck::bytes_of(&push), &buffers, groups)
    }
}
