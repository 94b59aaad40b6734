//! The kernels of a step one by one, each against its twin, on what the device's own kernels before it left.

use super::case::*;
use engine::train::association::AssociationConstants;
use engine::train::association::association_update::{
    ASSOCIATION_UPDATE, AssociationUpdateBuffers, AssociationUpdateConstants,
};
use engine::train::association::nearest_superpoints::{
    NEAREST_SUPERPOINTS, NearestSuperpointsBuffers, NearestSuperpointsConstants,
};
use engine::train::association::superpoint_commit::{SUPERPOINT_COMMIT, SuperpointCommitBuffers};
use engine::train::association::superpoint_gradient::*;
use engine::train::association::superpoint_sum::*;
use engine::train::deform_project_backward::SLOT_PLANES;
use engine::train::linear::Stage;
use engine::train::property_loss::PropertyLoss;
use engine::train::property_loss::property_backward::{PROPERTY_BACKWARD, PropertyBackwardBuffers};
use engine::train::property_loss::property_residual::*;
use engine::train::property_loss::property_values::{PROPERTY_VALUES, PropertyValuesBuffers};
use engine::train::status;
use tests_harness::{KernelCase, TestGpu};

/// What a step's kernels read: the case, and what `nearest_superpoints` made of it.
struct Chain<'a> {
    gpu: &'a TestGpu,
    case: &'a Case,
    context: String,
    rows: NearestSuperpointsBuffers<Vec<u32>>,
}

/// Sums of the weights and of the weighted means only.
const MOMENTS: SuperpointSumConstants = SuperpointSumConstants {
    moments: 1,
    pair_values: 0,
    own_first: 0,
    own_values: 0,
    by_subgroup: 0,
    slot_planes: 0,
    own_row: 0,
    ranges: 0,
};
const NOTHING: SuperpointSumConstants = SuperpointSumConstants { moments: 0, ..MOMENTS };

impl Case {
    /// Runs the whole chain. Returns logits after it.
    pub fn chain(&self, gpu: &TestGpu, form: PropertyLoss, failed: u32) -> Vec<u32> {
        let chain = Chain::new(self, gpu, failed, false, format!("{form:?}, N = {}", self.mean.len()));
        let m = self.position.len();
        let (first, property_sum, properties, logit) = if form == PropertyLoss::Paper {
            let values = chain.values();
            let first = chain.sum(SuperpointSumConstants { pair_values: 9, ..MOMENTS }, &values);
            let (residual, _) = chain.residual(Some(&first));
            let residual_sum = chain.sum(SuperpointSumConstants { pair_values: 9, ..NOTHING }, &residual);
            let (own, logit) = chain.backward(&first, residual_sum, residual);
            let own_sum = chain.sum(SuperpointSumConstants { own_values: 9, own_row: 9, ..NOTHING }, &own);
            (first, own_sum, 2, logit)
        } else {
            let (residual, logit) = chain.residual(None);
            let constants =
                SuperpointSumConstants { pair_values: 9, own_first: 3, own_values: 6, own_row: 9, ..MOMENTS };
            let sums = chain.sum(constants, &residual);
            (sums.clone(), sums, 1, logit)
        };
        let mut rng = Rng(99);
        let pose_gradient = bits((0..6 * self.mean.len()).map(|_| rng.signed()));
        let pose_sum = chain.sum(SuperpointSumConstants { own_values: 6, ..NOTHING }, &pose_gradient);
        let buffers = SuperpointGradientBuffers {
            step: self.step_words(),
            pose: self.pose_words(),
            superpoint_position: self.position_words(),
            property_sum: Some(property_sum),
            pose_sum,
            superpoint_gradient: vec![0; 6 * m],
            status: status::clear().to_vec(),
        };
        let constants = SuperpointGradientConstants { properties };
        let groups = (m as u32).div_ceil(256);
        KernelCase { kernel: &SUPERPOINT_GRADIENT, constants, push: (), buffers, groups }.check(gpu, &chain.context);
        chain.commit(first);
        logit
    }

    /// Runs what soft superpoints add to the chain. Returns logits after it.
    pub fn soft_chain(&self, gpu: &TestGpu, failed: u32) -> Vec<u32> {
        let (n, k) = (self.mean.len(), self.neighbors as usize);
        let chain = Chain::new(self, gpu, failed, true, format!("soft, N = {n}, K = {k}"));
        let mut rng = Rng(98);
        let pose_gradient = bits((0..SLOT_PLANES as usize * k * n).map(|_| rng.signed()));
        let constants = SuperpointSumConstants { own_values: 6, slot_planes: SLOT_PLANES, ..NOTHING };
        chain.sum(constants, &pose_gradient);
        let (_, before) = chain.residual(None);
        assert_eq!(before, chain.rows.logit, "the property losses moved logits on their own");
        let with = chain.update(&pose_gradient, Some(bits((0..k * n).map(|_| rng.signed()))));
        let without = chain.update(&pose_gradient, None);
        assert_eq!(with == without, failed != 0, "the property losses' part");
        without
    }
}

impl<'a> Chain<'a> {
    fn new(case: &'a Case, gpu: &'a TestGpu, failed: u32, soft: bool, context: String) -> Self {
        let (n, k) = (case.mean.len(), case.neighbors as usize);
        let pairs = n * (k + 1);
        let [neighbor, logit, logit_moment_1, logit_moment_2] = case.rows(5);
        let buffers = NearestSuperpointsBuffers {
            step: case.step_words(),
            counters: vec![0, 0, 0, failed, 0, 0, 0, 0],
            mean: bits(planes(&case.mean)),
            superpoint_position: case.position_words(),
            superpoint_of_gaussian: case.own.clone(),
            neighbor,
            logit,
            logit_moment_1,
            logit_moment_2,
            weight: vec![0; n * k],
            next_superpoint: vec![0; n],
            pair_key: vec![0; pairs],
            pair_value: vec![0; pairs],
            status: status::clear().to_vec(),
            blend_index: soft.then(|| vec![0; k.div_ceil(2) * n]),
        };
        let kernel = &NEAREST_SUPERPOINTS;
        let AssociationConstants { neighbors, slots } = case.constants();
        let blend = if soft { neighbors } else { 0 };
        let by = |stage: Stage| {
            let constants = NearestSuperpointsConstants { neighbors, slots, blend, stage: stage as u32 };
            let case_of = KernelCase { kernel, constants, push: (), buffers: buffers.clone(), groups: case.groups() };
            case_of.check(gpu, &format!("{context}, {stage:?}"))
        };
        let mut rows = by(Stage::Shuffle);
        let shared = by(Stage::Shared);
        assert!(rows.neighbor == shared.neighbor && rows.pair_key == shared.pair_key, "{context}: the stages differ");
        // The sort is tested on its own: here the order comes from the host.
        let mut order: Vec<usize> = (0..pairs).collect();
        order.sort_by_key(|&p| rows.pair_key[p]);
        rows.pair_key = order.iter().map(|&p| rows.pair_key[p]).collect();
        rows.pair_value = order.iter().map(|&p| rows.pair_value[p]).collect();
        Self { gpu, case, context, rows }
    }

    fn groups(&self) -> u32 {
        self.case.groups()
    }

    fn sum(&self, constants: SuperpointSumConstants, data: &[u32]) -> Vec<u32> {
        let (rows, m) = (&self.rows, self.case.position.len());
        let push = SuperpointSumPush {
            neighbors: self.case.neighbors,
            pairs: rows.pair_key.len() as u32,
            status_group: status::ASSOCIATION as u32,
        };
        let buffers = SuperpointSumBuffers {
            step: rows.step.clone(),
            pair_key: rows.pair_key.clone(),
            pair_value: rows.pair_value.clone(),
            weight: rows.weight.clone(),
            mean: rows.mean.clone(),
            pair_data: (constants.pair_values > 0).then(|| data.to_vec()),
            own_data: (constants.own_values > 0).then(|| data.to_vec()),
            superpoint_sum: vec![0; SUM_PLANES * m],
            status: status::clear().to_vec(),
            superpoint_range: None,
        };
        // Ranges looked for, looked for and stored, stored before.
        let (mut sums, mut stored) = (Vec::new(), vec![0; 3 * m]);
        for (by_subgroup, ranges) in [(false, 1), (true, 1), (false, 2), (true, 2), (true, 0)] {
            let constants = SuperpointSumConstants { by_subgroup: by_subgroup.into(), ranges, ..constants };
            let groups = groups(by_subgroup, self.gpu.subgroup_size_of(&SUPERPOINT_SUM), m as u32);
            let buffers =
                SuperpointSumBuffers { superpoint_range: (ranges > 0).then(|| stored.clone()), ..buffers.clone() };
            let case = KernelCase { kernel: &SUPERPOINT_SUM, constants, push, buffers, groups };
            let done = case.check(self.gpu, &format!("{}, {constants:?}", self.context));
            (sums, stored) = (done.superpoint_sum, done.superpoint_range.unwrap_or(stored));
        }
        sums
    }

    /// Residual and logits; in the paper's form with the sums of the properties.
    fn residual(&self, property_sum: Option<&Vec<u32>>) -> (Vec<u32>, Vec<u32>) {
        let (rows, n) = (&self.rows, self.case.mean.len());
        let (neighbors, slots) = (self.case.neighbors, self.case.slots);
        let (paper, soft) = (property_sum.is_some(), rows.blend_index.is_some());
        let constants = PropertyResidualConstants { neighbors, slots, paper: paper.into(), defer: soft.into() };
        let buffers = PropertyResidualBuffers {
            step: rows.step.clone(),
            counters: rows.counters.clone(),
            mean: rows.mean.clone(),
            superpoint_of_gaussian: rows.superpoint_of_gaussian.clone(),
            pose: self.case.pose_words(),
            superpoint_position: rows.superpoint_position.clone(),
            property_sum: property_sum.cloned(),
            neighbor: rows.neighbor.clone(),
            weight: rows.weight.clone(),
            logit: rows.logit.clone(),
            logit_moment_1: rows.logit_moment_1.clone(),
            logit_moment_2: rows.logit_moment_2.clone(),
            residual: vec![0; 9 * n],
            loss_partial: vec![0; 4 * n.div_ceil(256)],
            status: status::clear().to_vec(),
            logit_gradient: soft.then(|| vec![0; n * neighbors as usize]),
        };
        let case = KernelCase { kernel: &PROPERTY_RESIDUAL, constants, push: (), buffers, groups: self.groups() };
        let done = case.check(self.gpu, &self.context);
        (done.residual, done.logit)
    }

    /// Logits after Adam with the gradient of the weights.
    fn update(&self, pose_gradient: &[u32], logit_gradient: Option<Vec<u32>>) -> Vec<u32> {
        let rows = &self.rows;
        let (neighbors, slots) = (self.case.neighbors, self.case.slots);
        let buffers = AssociationUpdateBuffers {
            step: rows.step.clone(),
            counters: rows.counters.clone(),
            neighbor: rows.neighbor.clone(),
            weight: rows.weight.clone(),
            pose_gradient: pose_gradient.to_vec(),
            logit: rows.logit.clone(),
            logit_moment_1: rows.logit_moment_1.clone(),
            logit_moment_2: rows.logit_moment_2.clone(),
            status: status::clear().to_vec(),
            logit_gradient,
        };
        let property = buffers.logit_gradient.is_some().into();
        let constants = AssociationUpdateConstants { neighbors, slots, property };
        let case = KernelCase { kernel: &ASSOCIATION_UPDATE, constants, push: (), buffers, groups: self.groups() };
        case.check(self.gpu, &self.context).logit
    }

    fn values(&self) -> Vec<u32> {
        let buffers = PropertyValuesBuffers {
            step: self.rows.step.clone(),
            mean: self.rows.mean.clone(),
            superpoint_of_gaussian: self.rows.superpoint_of_gaussian.clone(),
            pose: self.case.pose_words(),
            property_value: vec![0; 9 * self.case.mean.len()],
        };
        let case = KernelCase { kernel: &PROPERTY_VALUES, constants: (), push: (), buffers, groups: self.groups() };
        case.check(self.gpu, &self.context).property_value
    }

    /// Gradient by the own poses, and logits.
    fn backward(&self, property_sum: &[u32], residual_sum: Vec<u32>, residual: Vec<u32>) -> (Vec<u32>, Vec<u32>) {
        let (rows, n) = (&self.rows, self.case.mean.len());
        let buffers = PropertyBackwardBuffers {
            step: rows.step.clone(),
            counters: rows.counters.clone(),
            mean: rows.mean.clone(),
            superpoint_of_gaussian: rows.superpoint_of_gaussian.clone(),
            pose: self.case.pose_words(),
            property_sum: property_sum.to_vec(),
            residual_sum,
            neighbor: rows.neighbor.clone(),
            weight: rows.weight.clone(),
            logit: rows.logit.clone(),
            logit_moment_1: rows.logit_moment_1.clone(),
            logit_moment_2: rows.logit_moment_2.clone(),
            residual,
            own_gradient: vec![0; 9 * n],
            property_mean_gradient: vec![0; 3 * n],
            status: status::clear().to_vec(),
        };
        let constants = self.case.constants();
        let case = KernelCase { kernel: &PROPERTY_BACKWARD, constants, push: (), buffers, groups: self.groups() };
        let done = case.check(self.gpu, &self.context);
        (done.own_gradient, done.logit)
    }

    fn commit(self, superpoint_sum: Vec<u32>) {
        let groups = (self.case.mean.len().max(self.case.position.len()) as u32).div_ceil(256);
        let rows = self.rows;
        let buffers = SuperpointCommitBuffers {
            step: rows.step,
            counters: rows.counters,
            superpoint_sum,
            next_superpoint: rows.next_superpoint,
            superpoint_of_gaussian: rows.superpoint_of_gaussian,
            superpoint_position: rows.superpoint_position,
            status: status::clear().to_vec(),
        };
        let case = KernelCase { kernel: &SUPERPOINT_COMMIT, constants: (), push: (), buffers, groups };
        case.check(self.gpu, &self.context);
    }
}
