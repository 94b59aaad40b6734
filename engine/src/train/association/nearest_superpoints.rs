//! Kernel `nearest_superpoints`.

use super::{MAX_NEIGHBORS, NEW_LOGIT, NO_SUPERPOINT, PAIR_SHIFT};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::limits::COUNT_FAILED;
use crate::render::superpoint_motion::index_words;
use crate::render::twin;
use crate::train::status;
use crate::train::step::Step;

crate::gpu_constants! {
    /// Specialisation constants of [`NEAREST_SUPERPOINTS`].
    pub struct NearestSuperpointsConstants {
        /// K, superpoints in use per Gaussian.
        neighbors,
        /// K', superpoints remembered per Gaussian.
        slots,
        /// K, when they are soft superpoints: the kernel writes `blend_index` and runs before the frame. Else 0.
        blend,
        /// A [`Stage`](crate::gpu::product::Stage): superpoints go round by shuffles, or lie in shared memory.
        stage,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`NEAREST_SUPERPOINTS`].
    pub struct NearestSuperpointsBuffers {
        /// Counts.
        step: Read Struct(Step),
        /// A failed frame leaves the rows as they are.
        counters: Read U32,
        /// `[3][N]` canonical centres.
        mean: Read F32,
        /// `[M][3]` canonical centres.
        superpoint_position: Read F32,
        /// `[N]`.
        superpoint_of_gaussian: Read U32,
        /// `[N][K']`.
        neighbor: Update U32,
        /// `[N][K']`.
        logit: Update F32,
        /// `[N][K']`.
        logit_moment_1: Update F32,
        /// `[N][K']`.
        logit_moment_2: Update F32,
        /// `[K][N]` softmax of the logits in use.
        weight: Write F32,
        /// `[N]` the superpoint of the largest logit.
        next_superpoint: Write U32,
        /// `[K + 1][N]` superpoints, the Gaussian's own last.
        pair_key: Write U32,
        /// `[K + 1][N]` slot and Gaussian ([`PAIR_SHIFT`]).
        pair_value: Write U32,
        status: Atomic U32,
        /// `[ceil(K/2)][N]`, as [`crate::render::superpoint_motion`] says; of soft superpoints.
        blend_index: optional Write U32,
    }
}

crate::kernel! {
    /// The K nearest superpoints of each Gaussian, the row update, the softmax and the pairs for the sort. Dispatch
    /// ceil(gaussians / 256) workgroups; at least one superpoint and one Gaussian, NEIGHBORS ≤ superpoints.
    pub static NEAREST_SUPERPOINTS: NearestSuperpoints = {
        name: "nearest_superpoints",
        doc: "K nearest superpoints of each Gaussian (brute force, exact), rows of the association, softmax, sort pairs",
        local_size: 256,
        constants: NearestSuperpointsConstants,
        push: (),
        buffers: NearestSuperpointsBuffers,
        twin: nearest_superpoints_twin,
        tolerance: Tolerance { absolute: 1e-7, relative: 2e-6, flips: 0.0 },
        bytes: |w| (12 + 8 * w.get("slots") + 20 * w.get("neighbors") + w.get("blend_bytes")) * w.get("gaussians"),
    }
}

/// One remembered entry: superpoint, logit, moments.
#[derive(Clone, Copy)]
struct Entry {
    superpoint: u32,
    value: [f32; 3],
}

/// Squared distance, never NaN.
fn squared_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [0, 1, 2].map(|c| a[c] - b[c]);
    let d = x * x + y * y + z * z;
    if d.is_finite() { d } else { f32::MAX }
}

/// Indices of the `count` nearest positions (`float[M][3]`), nearest first, ties by lowest index.
fn nearest(x: [f32; 3], position: &[u32], superpoints: usize, count: usize) -> Vec<u32> {
    let mut order: Vec<(f32, u32)> = (0..superpoints)
        .map(|j| (squared_distance(x, [0, 1, 2].map(|c| twin::f32_at(position, 3 * j + c))), j as u32))
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    order.into_iter().take(count).map(|(_, j)| j).collect()
}

/// The row after the superpoints in use became `nearest`.
fn rearranged(old: &[Entry], nearest: &[u32]) -> Vec<Entry> {
    let mut row: Vec<Entry> = nearest
        .iter()
        .map(|&j| {
            let kept = old.iter().find(|e| e.superpoint == j).map_or([NEW_LOGIT, 0.0, 0.0], |e| e.value);
            Entry { superpoint: j, value: kept }
        })
        .collect();
    let left = old.iter().filter(|e| e.superpoint != NO_SUPERPOINT && !nearest.contains(&e.superpoint));
    row.extend(left.copied());
    row.truncate(old.len());
    row
}

/// Softmax of the logits; `None` when one is not finite.
pub(in crate::train) fn softmax(logits: &[f32]) -> Option<Vec<f32>> {
    if !logits.iter().all(|l| l.is_finite()) {
        return None;
    }
    let top = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let value: Vec<f32> = logits.iter().map(|l| (l - top).exp()).collect();
    let sum: f32 = value.iter().sum();
    Some(value.into_iter().map(|v| v / sum).collect())
}

fn nearest_superpoints_twin(call: Call<'_, NearestSuperpoints>) {
    let Call { constants, buffers: mut b, .. } = call;
    let (k, slots) = (constants.neighbors as usize, constants.slots as usize);
    debug_assert!(k <= MAX_NEIGHBORS as usize, "at most {MAX_NEIGHBORS} neighbours");
    let step: Step = twin::struct_at(b.step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    let may_change = constants.blend != 0 || b.counters[COUNT_FAILED as usize] == 0;
    for i in 0..n {
        let x = [0, 1, 2].map(|c| twin::f32_at(b.mean, c * n + i));
        let near = nearest(x, b.superpoint_position, m, k);
        let row = i * slots..(i + 1) * slots;
        if b.neighbor[row.start..row.start + k] != near[..] && may_change {
            let entry = |at: usize| Entry {
                superpoint: b.neighbor[at],
                value: [&*b.logit, &*b.logit_moment_1, &*b.logit_moment_2].map(|v| twin::f32_at(v, at)),
            };
            let old: Vec<Entry> = row.clone().map(entry).collect();
            for (at, e) in row.clone().zip(rearranged(&old, &near)) {
                b.neighbor[at] = e.superpoint;
                let row = [&mut *b.logit, &mut *b.logit_moment_1, &mut *b.logit_moment_2];
                for (v, x) in row.into_iter().zip(e.value) {
                    twin::set_f32(v, at, x);
                }
            }
        }
        let logits: Vec<f32> = row.take(k).map(|at| twin::f32_at(b.logit, at)).collect();
        let a = softmax(&logits);
        let best = (1..k).fold(0, |b, s| if logits[s] > logits[b] { s } else { b });
        b.next_superpoint[i] = if a.is_some() { near[best] } else { near[0] };
        if let Some(blend_index) = b.blend_index.as_deref_mut().filter(|_| constants.blend != 0) {
            index_words(&near).enumerate().for_each(|(plane, word)| blend_index[plane * n + i] = word);
        }
        if a.is_none() {
            status::report(b.status, status::ASSOCIATION, i as u32);
        }
        for s in 0..k {
            twin::set_f32(b.weight, s * n + i, a.as_ref().map_or(0.0, |a| a[s]));
            b.pair_key[s * n + i] = near[s];
            b.pair_value[s * n + i] = (s as u32) << PAIR_SHIFT | i as u32;
        }
        b.pair_key[k * n + i] = b.superpoint_of_gaussian[i].min(step.superpoints - 1);
        b.pair_value[k * n + i] = (k as u32) << PAIR_SHIFT | i as u32;
    }
}
