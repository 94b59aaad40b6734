//! `property_residual` and `property_total`.

use super::{Properties, moved_properties, planes, update_logit};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::limits::COUNT_FAILED;
use crate::render::quaternion::dot;
use crate::render::twin;
use crate::train::association::NO_SUPERPOINT;
use crate::train::association::segment::FIRST_PAIR_VALUE;
use crate::train::step::Step;

/// Residuals and losses; in the code's form also the logits' update. Dispatch ceil(N / 256) workgroups.
pub static PROPERTY_RESIDUAL: Kernel = Kernel {
    name: "property_residual",
    doc: "property losses: residuals of each Gaussian's reconstructed properties; logits' Adam in the code's form",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "NEIGHBORS", "SLOTS", "PAPER"],
    push: &[],
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("mean", Access::Read, Element::F32),
        Binding::new("superpoint_of_gaussian", Access::Read, Element::U32),
        Binding::new("pose", Access::Read, Element::F32),
        Binding::new("superpoint_position", Access::Read, Element::F32),
        Binding::new("property_sum", Access::Read, Element::F32),
        Binding::new("neighbor", Access::Read, Element::U32),
        Binding::new("weight", Access::Read, Element::F32),
        Binding::new("logit", Access::Update, Element::F32),
        Binding::new("logit_moment_1", Access::Update, Element::F32),
        Binding::new("logit_moment_2", Access::Update, Element::F32),
        Binding::new("residual", Access::Write, Element::F32),
        Binding::new("loss_partial", Access::Write, Element::F32),
        Binding::new("status", Access::Atomic, Element::U32),
    ],
    twin: property_residual_twin,
    tolerance: Tolerance { absolute: 1e-6, relative: 1e-4, flips: 0.0 },
    bytes: |w| (12 + 4 + 36 + 8 * w.get("neighbors") + 24 * w.get("slots")) * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/property_residual.spv"),
};

/// The losses of the step. Dispatch one workgroup.
pub static PROPERTY_TOTAL: Kernel = Kernel {
    name: "property_total",
    doc: "adds up the property losses in a fixed order",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: &[],
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("loss_partial", Access::Read, Element::F32),
        Binding::new("property_loss", Access::Write, Element::F32),
    ],
    twin: property_total_twin,
    tolerance: Tolerance { absolute: 0.0, relative: 1e-5, flips: 0.0 },
    bytes: |w| w.get("gaussians") / 16,
    spirv: include_bytes!("../../../../spirv_cache/property_total.spv"),
};

/// A superpoint's mean properties from the planes of `superpoint_sum`.
pub(super) fn mean_properties(sums: &[u32], m: usize, j: usize) -> [[f32; 3]; 3] {
    let inverse = inverse_weight(sums, j);
    [0, 3, 6].map(|p| planes(sums, FIRST_PAIR_VALUE + p, m, j).map(|v| inverse * v))
}

/// 1 / Σa, 0 for a superpoint that is nobody's neighbour.
pub(super) fn inverse_weight(sums: &[u32], j: usize) -> f32 {
    let total = twin::f32_at(sums, j);
    if total > 0.0 { 1.0 / total } else { 0.0 }
}

fn property_residual_twin(call: &mut TwinCall<'_>) {
    let [k, slots, paper] = [1, 2, 3].map(|id| twin::spec(call, id) as usize);
    let [step, counters, mean, own, pose, position, sums, neighbor, weight, logit, m1, m2, residual, partial, words] =
        call.buffers
    else {
        return;
    };
    let step: Step = twin::struct_at(step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    let mut squares = vec![[0.0_f64; 3]; n.div_ceil(256)];
    for i in 0..n {
        let s = own[i].min(step.superpoints - 1) as usize;
        let Properties { value, .. } = moved_properties(pose, s, planes(mean, 0, n, i));
        let a: Vec<f32> = (0..k).map(|k| twin::f32_at(weight, k * n + i)).collect();
        let u: Vec<[[f32; 3]; 3]> = (0..k)
            .map(|k| match neighbor[i * slots + k].min(step.superpoints - 1) as usize {
                j if paper != 0 => mean_properties(sums, m, j),
                j => moved_properties(pose, j, [0, 1, 2].map(|c| twin::f32_at(position, 3 * j + c))).value,
            })
            .collect();
        let mut gradient = vec![0.0; k];
        for p in 0..3 {
            let rebuilt: [f32; 3] = std::array::from_fn(|c| (0..k).map(|k| a[k] * u[k][p][c]).sum());
            let error: [f32; 3] = std::array::from_fn(|c| value[p][c] - rebuilt[c]);
            squares[i / 256][p] += f64::from(dot(error, error));
            let scale = step.weights[1 + p] * (2.0 / (3.0 * n as f32));
            let g = error.map(|e| scale * e);
            g.iter().enumerate().for_each(|(c, v)| twin::set_f32(residual, (3 * p + c) * n + i, *v));
            for k in 0..k {
                gradient[k] -= a[k] * dot(g, std::array::from_fn(|c| u[k][p][c] - rebuilt[c]));
            }
        }
        if paper == 0 && counters[COUNT_FAILED as usize] == 0 {
            for (slot, at) in (i * slots..(i + 1) * slots).enumerate() {
                if slot < k || neighbor[at] != NO_SUPERPOINT {
                    let g = gradient.get(slot).copied().unwrap_or(0.0);
                    update_logit(&step, [&mut *logit, &mut *m1, &mut *m2], at, g, words, i);
                }
            }
        }
    }
    for (group, values) in squares.iter().enumerate() {
        values.iter().enumerate().for_each(|(c, v)| twin::set_f32(partial, 4 * group + c, *v as f32));
    }
}

fn property_total_twin(call: &mut TwinCall<'_>) {
    let [step, partial, loss] = call.buffers else { return };
    let step: Step = twin::struct_at(step, 0);
    let n = step.gaussians;
    let mut total = 0.0;
    for c in 0..3 {
        let sum: f64 = (0..n.div_ceil(256) as usize).map(|g| f64::from(twin::f32_at(partial, 4 * g + c))).sum();
        let value = sum as f32 / (3.0 * n as f32);
        total += step.weights[1 + c] * value;
        twin::set_f32(loss, c, value);
    }
    twin::set_f32(loss, 3, total);
}
