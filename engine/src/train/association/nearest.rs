//! `nearest_superpoints` and `association_init`.

use super::{MAX_NEIGHBORS, NEW_LOGIT, NO_SUPERPOINT, PAIR_SHIFT};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::limits::COUNT_FAILED;
use crate::render::twin;
use crate::train::status;
use crate::train::step::Step;

/// The K nearest superpoints of each Gaussian, the row update, the softmax and the pairs for the sort. Dispatch
/// ceil(gaussians / 256) workgroups; at least one superpoint and one Gaussian, NEIGHBORS ≤ superpoints.
pub static NEAREST_SUPERPOINTS: Kernel = Kernel {
    name: "nearest_superpoints",
    doc: "K nearest superpoints of each Gaussian (brute force, exact), rows of the association, softmax, sort pairs",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "NEIGHBORS", "SLOTS"],
    push: &[],
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("mean", Access::Read, Element::F32),
        Binding::new("superpoint_position", Access::Read, Element::F32),
        Binding::new("superpoint_of_gaussian", Access::Read, Element::U32),
        Binding::new("neighbor", Access::Update, Element::U32),
        Binding::new("logit", Access::Update, Element::F32),
        Binding::new("logit_moment_1", Access::Update, Element::F32),
        Binding::new("logit_moment_2", Access::Update, Element::F32),
        Binding::new("weight", Access::Write, Element::F32),
        Binding::new("next_superpoint", Access::Write, Element::U32),
        Binding::new("pair_key", Access::Write, Element::U32),
        Binding::new("pair_value", Access::Write, Element::U32),
        Binding::new("status", Access::Atomic, Element::U32),
    ],
    twin: nearest_superpoints_twin,
    tolerance: Tolerance { absolute: 1e-7, relative: 2e-6, flips: 0.0 },
    bytes: |w| (12 + 8 * w.get("slots") + 20 * w.get("neighbors")) * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/nearest_superpoints.spv"),
};

crate::gpu_struct! {
    /// Push constants of `association_init`.
    pub struct AssociationInitPush {
        /// Logit of the chosen entries.
        pub logit: f32,
        /// 0: the nearest superpoint of every Gaussian; 1: the superpoint that the Gaussian seeded.
        pub paper: u32,
    }
}

/// First assignment and logits. Dispatch ceil(gaussians / 256) workgroups after `nearest_superpoints`.
pub static ASSOCIATION_INIT: Kernel = Kernel {
    name: "association_init",
    doc: "assigns every Gaussian to its nearest superpoint and sets the first logits",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "NEIGHBORS", "SLOTS"],
    push: AssociationInitPush::FIELDS,
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("neighbor", Access::Read, Element::U32),
        Binding::new("chosen", Access::Read, Element::U32),
        Binding::new("logit", Access::Update, Element::F32),
        Binding::new("superpoint_of_gaussian", Access::Write, Element::U32),
    ],
    twin: association_init_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| (4 + 4 * w.get("neighbors")) * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/association_init.spv"),
};

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

/// Softmax of the logits; zeros when one is not finite.
fn softmax(logits: &[f32]) -> Option<Vec<f32>> {
    if !logits.iter().all(|l| l.is_finite()) {
        return None;
    }
    let top = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let value: Vec<f32> = logits.iter().map(|l| (l - top).exp()).collect();
    let sum: f32 = value.iter().sum();
    Some(value.into_iter().map(|v| v / sum).collect())
}

fn nearest_superpoints_twin(call: &mut TwinCall<'_>) {
    let (k, slots) = (twin::spec(call, 1) as usize, twin::spec(call, 2) as usize);
    debug_assert!(k <= MAX_NEIGHBORS as usize, "at most {MAX_NEIGHBORS} neighbours");
    let [step, counters, mean, position, own, neighbor, logit, m1, m2, weight, next, key, value, words] = call.buffers
    else {
        return;
    };
    let step: Step = twin::struct_at(step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    for i in 0..n {
        let x = [0, 1, 2].map(|c| twin::f32_at(mean, c * n + i));
        let near = nearest(x, position, m, k);
        let row = i * slots..(i + 1) * slots;
        if neighbor[row.start..row.start + k] != near[..] && counters[COUNT_FAILED as usize] == 0 {
            let entry = |at: usize| Entry {
                superpoint: neighbor[at],
                value: [&*logit, &*m1, &*m2].map(|v| twin::f32_at(v, at)),
            };
            let old: Vec<Entry> = row.clone().map(entry).collect();
            for (at, e) in row.clone().zip(rearranged(&old, &near)) {
                neighbor[at] = e.superpoint;
                for (v, x) in [&mut *logit, &mut *m1, &mut *m2].into_iter().zip(e.value) {
                    twin::set_f32(v, at, x);
                }
            }
        }
        let logits: Vec<f32> = row.take(k).map(|at| twin::f32_at(logit, at)).collect();
        let a = softmax(&logits);
        let best = (1..k).fold(0, |b, s| if logits[s] > logits[b] { s } else { b });
        next[i] = if a.is_some() { near[best] } else { near[0] };
        if a.is_none() {
            status::report(words, ASSOCIATION_GROUP, i as u32);
        }
        for s in 0..k {
            twin::set_f32(weight, s * n + i, a.as_ref().map_or(0.0, |a| a[s]));
            key[s * n + i] = near[s];
            value[s * n + i] = (s as u32) << PAIR_SHIFT | i as u32;
        }
        key[k * n + i] = own[i].min(step.superpoints - 1);
        value[k * n + i] = (k as u32) << PAIR_SHIFT | i as u32;
    }
}

/// Group of `status` for reports about the association.
pub const ASSOCIATION_GROUP: usize = 6;

fn association_init_twin(call: &mut TwinCall<'_>) {
    let (k, slots) = (twin::spec(call, 1) as usize, twin::spec(call, 2) as usize);
    let push: AssociationInitPush = twin::push(call);
    let [step, neighbor, chosen, logit, own] = call.buffers else { return };
    let step: Step = twin::struct_at(step, 0);
    for i in 0..step.gaussians as usize {
        own[i] = neighbor[i * slots];
        for s in 0..k {
            let at = i * slots + s;
            let pick = if push.paper == 0 { s == 0 } else { chosen[neighbor[at] as usize] == i as u32 };
            if pick {
                twin::set_f32(logit, at, push.logit);
            }
        }
    }
}
