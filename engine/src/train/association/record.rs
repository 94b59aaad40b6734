//! What a training step records between Gaussians and superpoints.

use super::AssociationConstants;
use super::association_update::{ASSOCIATION_UPDATE, AssociationUpdateBuffers, AssociationUpdateConstants};
use super::nearest_superpoints::{NEAREST_SUPERPOINTS, NearestSuperpointsBuffers, NearestSuperpointsConstants};
use super::state::{StepBuffers, SuperpointState};
use super::superpoint_commit::{SUPERPOINT_COMMIT, SuperpointCommitBuffers};
use super::superpoint_gradient::{SUPERPOINT_GRADIENT, SuperpointGradientBuffers, SuperpointGradientConstants};
use super::superpoint_sum::{self, SUPERPOINT_SUM, SuperpointSumBuffers, SuperpointSumConstants, SuperpointSumPush};
use crate::error::Result;
use crate::gpu::{Buffer, Groups, Recorder, Slice};
use crate::render::radix_sort::{self, SortSlices};
use crate::render::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers};
use crate::train::deform_project_backward::SLOT_PLANES;
use crate::train::property_loss::PropertyLoss;
use crate::train::property_loss::property_backward::{PROPERTY_BACKWARD, PropertyBackwardBuffers};
use crate::train::property_loss::property_residual::{
    PROPERTY_RESIDUAL, PropertyResidualBuffers, PropertyResidualConstants,
};
use crate::train::property_loss::property_total::{PROPERTY_TOTAL, PropertyTotalBuffers};
use crate::train::property_loss::property_values::{PROPERTY_VALUES, PropertyValuesBuffers};
use crate::train::status;

/// The first sum of a step: of the weights and the weighted means. What it finds of the sort's order is stored.
const FIRST: SuperpointSumConstants = SuperpointSumConstants {
    moments: 1,
    pair_values: 0,
    own_first: 0,
    own_values: 0,
    by_subgroup: 0,
    slot_planes: 0,
    own_row: 0,
    ranges: 1,
};
/// Values of a Gaussian that the property losses sum: three vectors.
const ROW: u32 = 9;

impl SuperpointState {
    /// The part before the frame: soft superpoints' weights. A frame that fails and runs again finds the same.
    pub fn record_blend(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        if self.options.blend_slots() == 0 { Ok(()) } else { self.record_nearest(r, b) }
    }

    /// The part before `deform_project_backward` (it needs the old means): nearest superpoints and sort, then, after the forward
    /// pass (a failed one is known by then), property losses with the logits' update, sums for the next centres.
    pub fn record_before(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        if self.options.blend_slots() == 0 {
            self.record_nearest(r, b)?;
        }
        self.record_sort(r)?;
        match self.options.property_loss {
            PropertyLoss::Off => self.record_sum(r, b, &self.first_sum, FIRST, [None, None], status::ASSOCIATION),
            PropertyLoss::Code => self.record_code(r, b),
            PropertyLoss::Paper => self.record_paper(r, b),
        }
    }

    /// The part after `deform_project_backward`: `pose_gradient` `float[6][N]` (soft: `float[K][7][N]`) →
    /// [`SuperpointState::gradient`].
    pub fn record_reduce_pose(&self, r: &mut Recorder, b: &StepBuffers, pose_gradient: &Slice) -> Result<()> {
        self.record_own_sum(r, b, &self.pose_sum, [6, 0], pose_gradient, status::POSE)?;
        self.record_association_update(r, b, pose_gradient)?;
        let (properties, property_sum) = match self.options.property_loss {
            PropertyLoss::Off => (0, None),
            PropertyLoss::Code => (1, Some(self.first_sum.whole())),
            PropertyLoss::Paper => (2, Some(self.own_sum.whole())),
        };
        let buffers = SuperpointGradientBuffers {
            step: b.step.clone(),
            pose: b.pose.clone(),
            superpoint_position: self.position.whole(),
            property_sum,
            pose_sum: self.pose_sum.whole(),
            superpoint_gradient: self.gradient.whole(),
            status: b.status.clone(),
        };
        let groups = Groups::Direct(self.superpoints().div_ceil(256).into());
        r.dispatch(&SUPERPOINT_GRADIENT, SuperpointGradientConstants { properties }, (), buffers, groups)
    }

    /// Soft superpoints: the logits' Adam.
    fn record_association_update(&self, r: &mut Recorder, b: &StepBuffers, pose_gradient: &Slice) -> Result<()> {
        if self.options.blend_slots() == 0 {
            return Ok(());
        }
        let AssociationConstants { neighbors, slots } = self.constants();
        let property = self.options.property_loss != PropertyLoss::Off;
        let buffers = AssociationUpdateBuffers {
            step: b.step.clone(),
            counters: b.counters.clone(),
            neighbor: self.rows.neighbor.whole(),
            weight: self.work.weight.whole(),
            pose_gradient: pose_gradient.clone(),
            logit: self.rows.logit.whole(),
            logit_moment_1: self.rows.moment_1.whole(),
            logit_moment_2: self.rows.moment_2.whole(),
            status: b.status.clone(),
            logit_gradient: property.then(|| self.work.logit_gradient.whole()),
        };
        let constants = AssociationUpdateConstants { neighbors, slots, property: property.into() };
        r.dispatch(&ASSOCIATION_UPDATE, constants, (), buffers, self.per_gaussian())
    }

    /// The end of the step, after everything that reads the assignment or the centres: both become the next step's.
    pub fn record_commit(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let buffers = SuperpointCommitBuffers {
            step: b.step.clone(),
            counters: b.counters.clone(),
            superpoint_sum: self.first_sum.whole(),
            next_superpoint: self.work.next_superpoint.whole(),
            superpoint_of_gaussian: b.superpoint_of_gaussian.clone(),
            superpoint_position: self.position.whole(),
            status: b.status.clone(),
        };
        let groups = Groups::Direct(self.gaussians().max(self.superpoints()).div_ceil(256).into());
        r.dispatch(&SUPERPOINT_COMMIT, (), (), buffers, groups)
    }

    fn per_gaussian(&self) -> Groups {
        Groups::Direct(self.gaussians().div_ceil(256).into())
    }

    pub(super) fn constants(&self) -> AssociationConstants {
        AssociationConstants { neighbors: self.options.neighbors, slots: self.options.slots }
    }

    pub(super) fn record_nearest(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let blend = self.options.blend_slots();
        // It waits for no frame: of this one, which may yet fail and run again, it finds the same again. Of one behind a failed
        // one nothing may be found.
        let buffers = NearestSuperpointsBuffers {
            step: b.step.clone(),
            counters: b.failed.clone(),
            mean: b.mean.clone(),
            superpoint_position: self.position.whole(),
            superpoint_of_gaussian: b.superpoint_of_gaussian.clone(),
            neighbor: self.rows.neighbor.whole(),
            logit: self.rows.logit.whole(),
            logit_moment_1: self.rows.moment_1.whole(),
            logit_moment_2: self.rows.moment_2.whole(),
            weight: self.work.weight.whole(),
            next_superpoint: self.work.next_superpoint.whole(),
            pair_key: self.work.keys[0].whole(),
            pair_value: self.work.values[0].whole(),
            status: b.status.clone(),
            blend_index: (blend > 0).then(|| self.work.blend_index.whole()),
        };
        let AssociationConstants { neighbors, slots } = self.constants();
        let stage = self.stage as u32;
        let constants = NearestSuperpointsConstants { neighbors, slots, blend, stage };
        r.dispatch(&NEAREST_SUPERPOINTS, constants, (), buffers, self.per_gaussian())
    }

    fn record_sort(&self, r: &mut Recorder) -> Result<()> {
        let w = &self.work;
        let count = w.pair_count.whole();
        let groups = || Groups::Direct(w.plan.partitions.into());
        if !w.plan.counted_apart {
            w.histograms[1..].iter().try_for_each(|histogram| r.fill(histogram, 0))?;
        }
        let buffers = SortHistogramBuffers {
            counters: count.clone(),
            keys: w.keys[0].whole(),
            histogram: w.histograms[0].whole(),
        };
        let push = w.plan.histogram_push(0, 0);
        r.dispatch_labelled("sort_histogram pairs", &SORT_HISTOGRAM, (), push, buffers, groups())?;
        let slices = SortSlices {
            counters: count,
            count_word: 0,
            keys: [0, 1].map(|i: usize| w.keys[i].whole()),
            values: [0, 1].map(|i: usize| w.values[i].whole()),
            histograms: w.histograms.iter().map(Buffer::whole).collect(),
        };
        radix_sort::record(r, "pairs", &w.plan, &slices, groups)
    }

    fn record_code(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        self.record_residual(r, b, None)?;
        let residual = self.work.residual.whole();
        // Position (planes 0-2) is a constant of each Gaussian: only rotation and translation pull at its own superpoint.
        let constants = SuperpointSumConstants { pair_values: ROW, own_first: 3, own_values: 6, own_row: ROW, ..FIRST };
        self.record_sum(r, b, &self.first_sum, constants, [Some(&residual), Some(&residual)], status::ASSOCIATION)?;
        self.record_total(r, b)
    }

    fn record_paper(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let (own, residual) = (self.work.own.whole(), self.work.residual.whole());
        let buffers = PropertyValuesBuffers {
            step: b.step.clone(),
            mean: b.mean.clone(),
            superpoint_of_gaussian: b.superpoint_of_gaussian.clone(),
            pose: b.pose.clone(),
            property_value: own.clone(),
        };
        r.dispatch(&PROPERTY_VALUES, (), (), buffers, self.per_gaussian())?;
        let constants = SuperpointSumConstants { pair_values: ROW, ..FIRST };
        self.record_sum(r, b, &self.first_sum, constants, [Some(&own), None], status::ASSOCIATION)?;
        self.record_residual(r, b, Some(&self.first_sum))?;
        let constants = SuperpointSumConstants { pair_values: ROW, ranges: 2, ..Default::default() };
        self.record_sum(r, b, &self.residual_sum, constants, [Some(&residual), None], status::ASSOCIATION)?;
        self.record_property_backward(r, b)?;
        self.record_own_sum(r, b, &self.own_sum, [ROW, ROW], &own, status::ASSOCIATION)?;
        self.record_total(r, b)
    }

    fn record_property_backward(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let buffers = PropertyBackwardBuffers {
            step: b.step.clone(),
            counters: b.counters.clone(),
            mean: b.mean.clone(),
            superpoint_of_gaussian: b.superpoint_of_gaussian.clone(),
            pose: b.pose.clone(),
            property_sum: self.first_sum.whole(),
            residual_sum: self.residual_sum.whole(),
            neighbor: self.rows.neighbor.whole(),
            weight: self.work.weight.whole(),
            logit: self.rows.logit.whole(),
            logit_moment_1: self.rows.moment_1.whole(),
            logit_moment_2: self.rows.moment_2.whole(),
            residual: self.work.residual.whole(),
            own_gradient: self.work.own.whole(),
            property_mean_gradient: self.work.mean_gradient.whole(),
            status: b.status.clone(),
        };
        r.dispatch(&PROPERTY_BACKWARD, self.constants(), (), buffers, self.per_gaussian())
    }

    /// In the paper's form from the sums of the Gaussians' properties, in the code's form without.
    fn record_residual(&self, r: &mut Recorder, b: &StepBuffers, property_sum: Option<&Buffer>) -> Result<()> {
        let AssociationConstants { neighbors, slots } = self.constants();
        let soft = self.options.blend_slots() > 0;
        let paper = property_sum.is_some().into();
        let constants = PropertyResidualConstants { neighbors, slots, paper, defer: soft.into() };
        let buffers = PropertyResidualBuffers {
            step: b.step.clone(),
            counters: b.counters.clone(),
            mean: b.mean.clone(),
            superpoint_of_gaussian: b.superpoint_of_gaussian.clone(),
            pose: b.pose.clone(),
            superpoint_position: self.position.whole(),
            property_sum: property_sum.map(Buffer::whole),
            neighbor: self.rows.neighbor.whole(),
            weight: self.work.weight.whole(),
            logit: self.rows.logit.whole(),
            logit_moment_1: self.rows.moment_1.whole(),
            logit_moment_2: self.rows.moment_2.whole(),
            residual: self.work.residual.whole(),
            loss_partial: self.work.loss_partial.whole(),
            status: b.status.clone(),
            logit_gradient: soft.then(|| self.work.logit_gradient.whole()),
        };
        r.dispatch(&PROPERTY_RESIDUAL, constants, (), buffers, self.per_gaussian())
    }

    fn record_total(&self, r: &mut Recorder, b: &StepBuffers) -> Result<()> {
        let buffers = PropertyTotalBuffers {
            step: b.step.clone(),
            loss_partial: self.work.loss_partial.whole(),
            property_loss: self.property_loss.whole(),
        };
        r.dispatch(&PROPERTY_TOTAL, (), (), buffers, Groups::Direct(1))
    }

    /// The first values of `data`, planes or `ROW`s, summed over each superpoint's own Gaussians; with soft superpoints of
    /// poses, over all that it moves in part.
    fn record_own_sum(
        &self,
        r: &mut Recorder,
        b: &StepBuffers,
        sums: &Buffer,
        [own_values, own_row]: [u32; 2],
        data: &Slice,
        group: usize,
    ) -> Result<()> {
        let soft = self.options.blend_slots() > 0 && group == status::POSE;
        let slot_planes = if soft { SLOT_PLANES } else { 0 };
        let constants = SuperpointSumConstants { own_values, slot_planes, own_row, ranges: 2, ..Default::default() };
        self.record_sum(r, b, sums, constants, [None, Some(data)], group)
    }

    /// `superpoint_sum` of the data of pairs and of own Gaussians.
    fn record_sum(
        &self,
        r: &mut Recorder,
        b: &StepBuffers,
        sums: &Buffer,
        constants: SuperpointSumConstants,
        data: [Option<&Slice>; 2],
        group: usize,
    ) -> Result<()> {
        let (w, superpoints) = (&self.work, self.superpoints());
        let by_subgroup = superpoint_sum::by_subgroup(w.plan.capacity, superpoints);
        let constants = SuperpointSumConstants { by_subgroup: by_subgroup.into(), ..constants };
        let sorted = w.plan.result_in();
        let [pair_data, own_data] = data.map(Option::<&Slice>::cloned);
        let buffers = SuperpointSumBuffers {
            step: b.step.clone(),
            pair_key: w.keys[sorted].whole(),
            pair_value: w.values[sorted].whole(),
            weight: w.weight.whole(),
            mean: b.mean.clone(),
            pair_data,
            own_data,
            superpoint_sum: sums.whole(),
            status: b.status.clone(),
            superpoint_range: Some(self.range.whole()),
        };
        let push =
            SuperpointSumPush { neighbors: self.options.neighbors, pairs: w.plan.capacity, status_group: group as u32 };
        let label = format!("superpoint_sum {}", sums.name());
        let groups = superpoint_sum::groups(by_subgroup, r.subgroup_size_of(&SUPERPOINT_SUM), superpoints);
        let groups = Groups::Direct(groups.into());
        r.dispatch_labelled(&label, &SUPERPOINT_SUM, constants, push, buffers, groups)
    }
}
