//! Kernel `learn_keys`: Adam of the key poses around a step's time; in f64 it is [`Keys::learn`](super::definition::Keys::learn).

use glam::Vec3;

use super::{
    BETA, EPSILON, KEY_DECAY, KEY_FIRST_PLACE, KEY_FIRST_ROTATION, KEY_MOMENT_1, KEY_MOMENT_2, KEY_PLACE, KEY_ROTATION,
    KEY_WORDS, LARGEST_TURN, NO_TWIN,
};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::limits::COUNT_FAILED;
use crate::render::quaternion::{displacement, exp, left_jacobian_transposed};
use crate::render::twin::{f32_at, set_f32, struct_at};
use crate::train::association::superpoint_sum::FIRST_OWN_VALUE;
use crate::train::status;
use crate::train::step::Step;

crate::gpu_struct! {
    /// Push constants of [`LEARN_KEYS`].
    pub struct LearnKeysPush {
        /// T.
        pub keys: u32,
        /// λ of the term that holds a key to where it began.
        pub hold: f32,
        /// λ of the term that holds it to the keys next to it.
        pub smoothness: f32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`LEARN_KEYS`].
    pub struct LearnKeysBuffers {
        /// M, the keys around the image's time, rate, fade, pixels.
        step: Read Struct(Step),
        /// Nothing changes when the frame failed.
        counters: Read U32,
        /// `[22][M]` of the rendering's gradients by the pose ([`superpoint_sum`](crate::train::association::superpoint_sum)).
        pose_sum: Read F32,
        /// `[5][M]` ([`SUPERPOINT_WORDS`](super::SUPERPOINT_WORDS)).
        key_superpoint: Read F32,
        /// `[T]`: the other one of two keys of one time, or [`NO_TWIN`].
        key_twin: Read U32,
        /// `[T][22][M]` ([`KEY_WORDS`]).
        key: Update F32,
        status: Atomic U32,
    }
}

crate::kernel! {
    /// A step of Adam for the two keys around the image's time. Dispatch ceil(M / 256) workgroups.
    pub static LEARN_KEYS: LearnKeys = {
        name: "learn_keys",
        doc: "gradients and Adam of the two key poses around the step's time, with terms that hold them",
        local_size: 256,
        constants: (),
        push: LearnKeysPush,
        buffers: LearnKeysBuffers,
        twin: learn_keys_twin,
        tolerance: Tolerance { absolute: 2e-6, relative: 1e-4, flips: 0.0 },
        bytes: |work| work.get("superpoints") * 4 * (6 + 5 + 2 * (2 * KEY_WORDS as u64 + 12)),
    }
}

/// Turn and shift of a key.
type Six = [Vec3; 2];

/// A superpoint's keys.
struct Keys<'a> {
    key: &'a mut [u32],
    step: Step,
    push: LearnKeysPush,
    m: usize,
    j: usize,
    center: Vec3,
    scale: [f32; 2],
}

impl Keys<'_> {
    fn at(&self, key: usize, word: usize) -> usize {
        (key * KEY_WORDS + word) * self.m + self.j
    }

    fn word(&self, key: usize, word: usize) -> f32 {
        f32_at(self.key, self.at(key, word))
    }

    fn words(&self, key: usize, word: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|c| self.word(key, word + c)))
    }

    fn set(&mut self, key: usize, word: usize, value: f32) {
        let at = self.at(key, word);
        set_f32(self.key, at, value);
    }

    fn set_words(&mut self, key: usize, word: usize, value: Vec3) {
        value.to_array().into_iter().enumerate().for_each(|(c, v)| self.set(key, word + c, v));
    }

    fn gradient(&self, key: usize, weight: f32, r: Vec3, by_pose: Six) -> Six {
        let (own, transposed) = (self.words(key, KEY_ROTATION), |r: Vec3, w: Vec3| {
            Vec3::from_array(left_jacobian_transposed(r.into(), w.into()))
        });
        let arm = self.center + Vec3::from_array(displacement(exp(own.into()), self.center.into()));
        let turn = transposed(r, by_pose[0]) + transposed(own, by_pose[1].cross(arm));
        [turn * (weight * self.scale[0]), by_pose[1] * (weight * self.scale[1])]
    }

    fn way(&self, key: usize) -> Six {
        [
            (self.words(key, KEY_ROTATION) - self.words(key, KEY_FIRST_ROTATION)) / self.scale[0],
            (self.words(key, KEY_PLACE) - self.words(key, KEY_FIRST_PLACE)) / self.scale[1],
        ]
    }

    fn with_terms(&self, key: usize, gradient: Six) -> Six {
        let (own, fade) = (self.way(key), self.step.key_fade);
        let mut sum = [0, 1].map(|part| gradient[part] + fade * self.push.hold * own[part]);
        let neighbours = [key.checked_sub(1), Some(key + 1).filter(|k| *k < self.push.keys as usize)];
        for next in neighbours.into_iter().flatten().map(|next| self.way(next)) {
            (0..2).for_each(|part| sum[part] += fade * self.push.smoothness * (own[part] - next[part]));
        }
        sum
    }

    fn adam(&mut self, key: usize, part: usize, gradient: Vec3, decay: [f32; 2]) -> Vec3 {
        let [beta_1, beta_2] = BETA.map(|b| b as f32);
        let moment_1 = beta_1 * self.words(key, KEY_MOMENT_1 + 3 * part) + (1.0 - beta_1) * gradient;
        let moment_2 = beta_2 * self.word(key, KEY_MOMENT_2 + part) + (1.0 - beta_2) * gradient.dot(gradient);
        self.set_words(key, KEY_MOMENT_1 + 3 * part, moment_1);
        self.set(key, KEY_MOMENT_2 + part, moment_2);
        let size = (moment_2 / (1.0 - decay[1])).sqrt() + EPSILON as f32;
        moment_1 * (-self.step.rate_key * self.scale[part] / ((1.0 - decay[0]) * size))
    }

    fn update(&mut self, key: usize, twin: u32, gradient: Six) {
        let twin = (twin != NO_TWIN).then_some(twin as usize);
        if twin.is_some_and(|twin| self.words(twin, KEY_ROTATION) != self.words(key, KEY_ROTATION)) {
            return;
        }
        let decay = [0, 1].map(|k| self.word(key, KEY_DECAY + k) * BETA[k] as f32);
        let [turn, shift] = [0, 1].map(|part| self.adam(key, part, gradient[part], decay));
        let turn = turn * (LARGEST_TURN as f32 / turn.length().max(1e-30)).min(1.0);
        self.set_words(key, KEY_ROTATION, self.words(key, KEY_ROTATION) + turn);
        self.set_words(key, KEY_PLACE, self.words(key, KEY_PLACE) + shift);
        (0..2).for_each(|k| self.set(key, KEY_DECAY + k, decay[k]));
        if let Some(twin) = twin {
            (0..KEY_WORDS).for_each(|word| self.set(twin, word, self.word(key, word)));
        }
    }
}

fn learn_keys_twin(call: Call<'_, LearnKeys>) {
    let Call { push, buffers: b, .. } = call;
    let step: Step = struct_at(b.step, 0);
    let m = step.superpoints as usize;
    if b.counters[COUNT_FAILED as usize] != 0 {
        return;
    }
    for j in 0..m {
        let planes = |words: &[u32], plane: usize| [0, 1, 2].map(|c| f32_at(words, (plane + c) * m + j));
        let sums = |plane: usize| step.pixels * Vec3::from_array(planes(b.pose_sum, plane));
        let by_pose = [sums(FIRST_OWN_VALUE), sums(FIRST_OWN_VALUE + 3)];
        let total = (by_pose[0].abs() + by_pose[1].abs()).element_sum();
        if !total.is_finite() {
            status::report(b.status, status::POSE, j as u32);
            continue;
        }
        let scale = [3, 4].map(|plane| f32_at(b.key_superpoint, plane * m + j));
        if total <= 0.0 || scale[1] <= 0.0 {
            continue;
        }
        let center = Vec3::from_array(planes(b.key_superpoint, 0));
        let mut keys = Keys { key: &mut *b.key, step, push, m, j, center, scale };
        let ends = [step.key_first, step.key_second].map(|key| key as usize);
        let weight = if ends[0] == ends[1] { 0.0 } else { step.key_weight };
        let [p, q] = ends.map(|key| keys.words(key, KEY_ROTATION));
        let r = (1.0 - weight) * p + weight * q;
        let gradients = [(ends[0], 1.0 - weight), (ends[1], weight)]
            .map(|(key, weight)| keys.with_terms(key, keys.gradient(key, weight, r, by_pose)));
        keys.update(ends[0], b.key_twin[ends[0]], gradients[0]);
        if ends[0] != ends[1] {
            keys.update(ends[1], b.key_twin[ends[1]], gradients[1]);
        }
    }
}
