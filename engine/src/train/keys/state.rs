//! Key poses on the device, and the sums of gradients that they learn from.

use super::interpolate_keys::{INTERPOLATE_KEYS, InterpolateKeysBuffers};
use super::learn_keys::{LEARN_KEYS, LearnKeysBuffers, LearnKeysPush};
use super::words::{key_words, superpoint_words, table_of, twin_words};
use super::{KEY_WORDS, KeyOptions};
use crate::error::Result;
use crate::gpu::{Buffer, Gpu, Groups, Memory, Recorder, Slice};
use crate::scene::{Motion, SuperpointDeformation};
use crate::train::association::PAIR_SHIFT;
use crate::train::association::superpoint_sum::{
    self, SUM_PLANES, SUPERPOINT_SUM, SuperpointSumBuffers, SuperpointSumConstants, SuperpointSumPush,
};
use crate::train::deform_project_backward::SLOT_PLANES;
use crate::train::status;
use crate::train::step::Step;

const THREADS: u32 = 256;

/// A table that learns.
#[derive(Debug)]
pub(in crate::train) struct KeyState {
    options: KeyOptions,
    /// Times alone.
    times: Motion,
    key: Buffer,
    superpoint: Buffer,
    twin: Buffer,
}

impl KeyState {
    /// Of a table.
    ///
    /// # Errors
    /// `Usage` for another number of superpoints, no key, or a rate that is not above 0; `OutOfMemory`.
    pub(in crate::train) fn new(gpu: &Gpu, table: &Motion, options: KeyOptions) -> Result<Self> {
        options.check(table)?;
        Ok(Self {
            key: gpu.buffer_with("key", bytemuck::cast_slice(&key_words(table, &options)))?,
            superpoint: gpu.buffer_with("key_superpoint", bytemuck::cast_slice(&superpoint_words(&options)))?,
            twin: gpu.buffer_with("key_twin", bytemuck::cast_slice(&twin_words(&table.times)))?,
            times: Motion { times: table.times.clone(), ..Motion::default() },
            options,
        })
    }

    fn groups(&self) -> Groups {
        Groups::Direct((self.options.center.len() as u32).div_ceil(THREADS).into())
    }

    /// What a step says of them: the time of its image, and its number of pixels.
    pub(in crate::train) fn prepare(&self, step: &mut Step, time: f64, pixels: f64) {
        let between = self.times.interval(time);
        (step.key_first, step.key_second) = (between.first, between.second);
        step.key_weight = between.weight as f32;
        // The loss is a mean over the pixels; how far a key goes should not depend on their number.
        step.pixels = pixels as f32;
        let iteration = step.iteration.into();
        (step.rate_key, step.key_fade) = (self.options.rate(iteration) as f32, self.options.fade(iteration) as f32);
    }

    /// Poses at a step's time.
    pub(in crate::train) fn record_interpolate(&self, r: &mut Recorder, step: &Buffer, pose: &Buffer) -> Result<()> {
        let buffers = InterpolateKeysBuffers {
            step: step.whole(),
            key: self.key.whole(),
            key_superpoint: self.superpoint.whole(),
            pose: pose.whole(),
        };
        r.dispatch(&INTERPOLATE_KEYS, (), (), buffers, self.groups())
    }

    /// Adam, from the sums of gradients by poses.
    pub(in crate::train) fn record_learn(
        &self,
        r: &mut Recorder,
        step: &Buffer,
        counters: &Slice,
        sums: &PoseSums,
        status: &Buffer,
    ) -> Result<()> {
        let buffers = LearnKeysBuffers {
            step: step.whole(),
            counters: counters.clone(),
            pose_sum: sums.sum.whole(),
            key_superpoint: self.superpoint.whole(),
            key_twin: self.twin.whole(),
            key: self.key.whole(),
            status: status.whole(),
        };
        let push = LearnKeysPush {
            keys: self.times.times.len() as u32,
            hold: self.options.hold as f32,
            smoothness: self.options.smooth as f32,
        };
        r.dispatch(&LEARN_KEYS, (), push, buffers, self.groups())
    }

    /// The state that the next step depends on, and its words: a buffer may be longer, and nobody writes the rest.
    pub(in crate::train) fn state(&self) -> (&Buffer, u32) {
        (&self.key, (self.times.times.len() * KEY_WORDS * self.options.center.len()) as u32)
    }

    /// Device memory, bytes.
    pub(in crate::train) fn bytes(&self) -> u64 {
        self.key.bytes() + self.superpoint.bytes() + self.twin.bytes()
    }

    /// The table as it is.
    pub(in crate::train) fn table(&self, gpu: &Gpu) -> Result<Motion> {
        let words: Vec<f32> = bytemuck::pod_collect_to_vec(&gpu.download(&self.key)?);
        Ok(table_of(&words, &self.times.times, &self.options))
    }
}

/// Sums over the Gaussians of each superpoint, whose order never changes here: pairs are sorted once.
#[derive(Debug)]
pub(in crate::train) struct PoseSums {
    key: Buffer,
    value: Buffer,
    range: Buffer,
    sum: Buffer,
    /// Superpoints of a Gaussian where they are soft, else 0.
    slots: u32,
    pairs: u32,
    superpoints: u32,
}

impl PoseSums {
    /// Of the Gaussians of superpoints.
    ///
    /// # Errors
    /// `OutOfMemory`.
    pub(in crate::train) fn new(gpu: &Gpu, motion: &SuperpointDeformation, gaussians: u32) -> Result<Self> {
        let m = motion.superpoints.position.len();
        let slots = motion.blend.as_ref().map_or(0, |blend| blend.neighbors as u32);
        let pairs = sorted_pairs(motion, gaussians as usize);
        let [key, value]: [Vec<u32>; 2] = [pairs.iter().map(|p| p.0).collect(), pairs.iter().map(|p| p.1).collect()];
        let start = |j: usize| key.partition_point(|k| (*k as usize) < j) as u32;
        // A superpoint's own Gaussians: all pairs, or none where each pair has its planes.
        let own = |j: usize| if slots > 0 { start(j + 1) } else { start(j) };
        let range: Vec<u32> = (0..m).map(start).chain((0..m).map(own)).chain((1..=m).map(start)).collect();
        let nonempty = |words: &[u32]| if words.is_empty() { vec![0] } else { words.to_vec() };
        let upload = |name: &str, words: &[u32]| gpu.buffer_with(name, bytemuck::cast_slice(&nonempty(words)));
        Ok(Self {
            key: upload("pair_key", &key)?,
            value: upload("pair_value", &value)?,
            range: upload("superpoint_range", &range)?,
            sum: gpu.buffer("pose_sum", 4 * (SUM_PLANES * m) as u64, Memory::Device)?,
            slots,
            pairs: pairs.len() as u32,
            superpoints: m as u32,
        })
    }

    /// From `float[6][N]`, or `float[K][7][N]` with soft superpoints.
    pub(in crate::train) fn record(
        &self,
        r: &mut Recorder,
        step: &Buffer,
        mean: &Slice,
        pose_gradient: &Slice,
        status: &Buffer,
    ) -> Result<()> {
        let by_subgroup = superpoint_sum::by_subgroup(self.pairs, self.superpoints);
        let constants = SuperpointSumConstants {
            own_values: 6,
            slot_planes: if self.slots > 0 { SLOT_PLANES } else { 0 },
            ranges: 2,
            by_subgroup: by_subgroup.into(),
            ..Default::default()
        };
        let buffers = SuperpointSumBuffers {
            step: step.whole(),
            pair_key: self.key.whole(),
            pair_value: self.value.whole(),
            // Nothing here is weighted.
            weight: mean.clone(),
            mean: mean.clone(),
            pair_data: None,
            own_data: Some(pose_gradient.clone()),
            superpoint_sum: self.sum.whole(),
            status: status.whole(),
            superpoint_range: Some(self.range.whole()),
        };
        let push = SuperpointSumPush { neighbors: self.slots, pairs: self.pairs, status_group: status::POSE as u32 };
        let groups = superpoint_sum::groups(by_subgroup, r.subgroup_size_of(&SUPERPOINT_SUM), self.superpoints);
        r.dispatch_labelled(
            "superpoint_sum pose_sum",
            &SUPERPOINT_SUM,
            constants,
            push,
            buffers,
            Groups::Direct(groups.into()),
        )
    }

    /// Device memory, bytes.
    pub(in crate::train) fn bytes(&self) -> u64 {
        self.key.bytes() + self.value.bytes() + self.range.bytes() + self.sum.bytes()
    }
}

/// Superpoint, slot and Gaussian, sorted by all three.
fn sorted_pairs(motion: &SuperpointDeformation, gaussians: usize) -> Vec<(u32, u32)> {
    let m = motion.superpoints.position.len() as u32;
    let mut pairs: Vec<(u32, u32)> = match &motion.blend {
        None => motion.superpoints.of_gaussian.iter().take(gaussians).zip(0..).map(|(&j, i)| (j, i)).collect(),
        Some(blend) => (0..gaussians.min(blend.len()))
            .flat_map(|i| {
                let row = blend.row(i).0.iter().zip(0_u32..);
                row.map(move |(&j, slot)| (j, slot << PAIR_SHIFT | i as u32)).collect::<Vec<_>>()
            })
            .collect(),
    };
    pairs.retain(|(j, _)| *j < m);
    pairs.sort_unstable();
    pairs
}
