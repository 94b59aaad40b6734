//! What a training step records between Gaussians and superpoints.

use super::nearest::{ASSOCIATION_GROUP, NEAREST_SUPERPOINTS};
use super::segment::{SUPERPOINT_SUM, SuperpointSumPush};
use super::state::{StepBuffers, SuperpointState};
use super::update::{POSE_GROUP, SUPERPOINT_COMMIT, SUPERPOINT_GRADIENT};
use crate::error::Result;
use crate::gpu::{Buffer, Groups, Recorder, Slice};
use crate::render::radix_sort::*;
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
        r.dispatch(&SUPERPOINT_GRADIENT, &[form], &[], &buffers, groups)
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
        r.dispatch(&SUPERPOINT_COMMIT, &[], &[], &buffers, groups)
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
        r.dispatch(&NEAREST_SUPERPOINTS, &self.shape(), &[], &buffers, self.per_gaussian())
    }

    fn record_sort(&self, r: &mut Recorder) -> Result<()> {
        let w = &self.work;
        let count = Slice::from(&w.pair_count);
        let groups = || Groups::Direct(w.plan.partitions.into());
        for histogram in &w.histograms[1..] {
            r.fill(histogram, 0)?;
        }
        let buffers = [count.clone(), Slice::from(&w.keys[0]), Slice::from(&w.histograms[0])];
        let push = w.plan.histogram_push(0);
        r.dispatch_labelled(
            "sort_histogram pairs",
            &SORT_HISTOGRAM,
            &[],
            bytemuck::bytes_of(&push),
            &buffers,
            groups(),
        )?;
        for pass in 0..w.plan.digits.len() {
            let (from, to) = (pass % 2, (pass + 1) % 2);
            let histogram = Slice::from(&w.histograms[pass]);
            if w.plan.prescanned {
                let push = w.plan.spine_push(0);
                let buffers = [count.clone(), histogram.clone()];
                let label = format!("sort_spine pairs {pass}");
                let spine = Groups::Direct(SPINE_GROUPS.into());
                r.dispatch_labelled(&label, &SORT_SPINE, &[], bytemuck::bytes_of(&push), &buffers, spine)?;
            }
            // The last pass counts nothing; another buffer stands in for the next histogram.
            let next = w.histograms.get(pass + 1).unwrap_or(&self.own_sum);
            let buffers = [
                count.clone(),
                histogram,
                Slice::from(&w.keys[from]),
                Slice::from(&w.values[from]),
                Slice::from(&w.keys[to]),
                Slice::from(&w.values[to]),
                Slice::from(next),
            ];
            let push = w.plan.scatter_push(pass, 0);
            let spec = w.plan.scatter_spec(pass, true, rank_by_ballot(r.subgroup_size_of(&SORT_SCATTER)));
            let label = format!("sort_scatter pairs {pass}");
            r.dispatch_labelled(&label, &SORT_SCATTER, &spec, bytemuck::bytes_of(&push), &buffers, groups())?;
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
        r.dispatch(&PROPERTY_VALUES, &[], &[], &buffers, self.per_gaussian())?;
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
        r.dispatch(&PROPERTY_BACKWARD, &self.shape(), &[], &buffers, self.per_gaussian())?;
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
        r.dispatch(&PROPERTY_RESIDUAL, &[neighbors, slots, paper], &[], &buffers, self.per_gaussian())
    }

    fn record_total(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let buffers = [b.step.clone(), Slice::from(&self.work.loss_partial), Slice::from(&self.property_loss)];
        r.dispatch(&PROPERTY_TOTAL, &[], &[], &buffers, Groups::Direct(1))
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
        r.dispatch_labelled(&label, &SUPERPOINT_SUM, &spec, bytemuck::bytes_of(&push), &buffers, groups)
    }
}
