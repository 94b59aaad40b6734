//! `property_values` and `property_backward`: the paper's form.

use super::residual::{inverse_weight, mean_properties};
use super::{Properties, moved_properties, planes, update_logit};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::limits::COUNT_FAILED;
use crate::render::quaternion::{cross, displacement, dot, exp};
use crate::render::twin;
use crate::train::association::NO_SUPERPOINT;
use crate::train::association::segment::FIRST_PAIR_VALUE;
use crate::train::step::Step;

/// Properties of each Gaussian as planes. Dispatch ceil(N / 256) workgroups.
pub static PROPERTY_VALUES: Kernel = Kernel {
    name: "property_values",
    doc: "each Gaussian's position at the step's time, so(3) vector and translation (paper's property losses)",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: &[],
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("mean", Access::Read, Element::F32),
        Binding::new("superpoint_of_gaussian", Access::Read, Element::U32),
        Binding::new("pose", Access::Read, Element::F32),
        Binding::new("property_value", Access::Write, Element::F32),
    ],
    twin: property_values_twin,
    tolerance: Tolerance { absolute: 1e-6, relative: 1e-6, flips: 0.0 },
    bytes: |w| 52 * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/property_values.spv"),
};

/// Backward through both reconstructions. Dispatch ceil(N / 256) workgroups.
pub static PROPERTY_BACKWARD: Kernel = Kernel {
    name: "property_backward",
    doc: "backward of the paper's property losses: logits with Adam, own poses, means",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "NEIGHBORS", "SLOTS"],
    push: &[],
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("mean", Access::Read, Element::F32),
        Binding::new("superpoint_of_gaussian", Access::Read, Element::U32),
        Binding::new("pose", Access::Read, Element::F32),
        Binding::new("property_sum", Access::Read, Element::F32),
        Binding::new("residual_sum", Access::Read, Element::F32),
        Binding::new("neighbor", Access::Read, Element::U32),
        Binding::new("weight", Access::Read, Element::F32),
        Binding::new("logit", Access::Update, Element::F32),
        Binding::new("logit_moment_1", Access::Update, Element::F32),
        Binding::new("logit_moment_2", Access::Update, Element::F32),
        Binding::new("residual", Access::Read, Element::F32),
        Binding::new("own_gradient", Access::Write, Element::F32),
        Binding::new("property_mean_gradient", Access::Write, Element::F32),
        Binding::new("status", Access::Atomic, Element::U32),
    ],
    twin: property_backward_twin,
    tolerance: Tolerance { absolute: 1e-6, relative: 1e-4, flips: 0.0 },
    bytes: |w| (12 + 4 + 72 + 12 + 8 * w.get("neighbors") + 24 * w.get("slots")) * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/property_backward.spv"),
};

fn property_values_twin(call: &mut TwinCall<'_>) {
    let [step, mean, own, pose, value] = call.buffers else { return };
    let step: Step = twin::struct_at(step, 0);
    let n = step.gaussians as usize;
    for i in 0..n {
        let s = own[i].min(step.superpoints - 1) as usize;
        let v = moved_properties(pose, s, planes(mean, 0, n, i)).value;
        v.as_flattened().iter().enumerate().for_each(|(c, x)| twin::set_f32(value, c * n + i, *x));
    }
}

fn property_backward_twin(call: &mut TwinCall<'_>) {
    let [k, slots] = [1, 2].map(|id| twin::spec(call, id) as usize);
    let [
        step,
        counters,
        mean,
        own,
        pose,
        sums,
        pulls,
        neighbor,
        weight,
        logit,
        m1,
        m2,
        residual,
        own_gradient,
        d_mean,
        words,
    ] = call.buffers
    else {
        return;
    };
    let step: Step = twin::struct_at(step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    for i in 0..n {
        let s = own[i].min(step.superpoints - 1) as usize;
        let Properties { turned, value } = moved_properties(pose, s, planes(mean, 0, n, i));
        let g = [0, 3, 6].map(|p| planes(residual, p, n, i));
        let mut d = g;
        let (mut d_a, mut d_total) = (vec![0.0_f32; k], 0.0);
        let a: Vec<f32> = (0..k).map(|k| twin::f32_at(weight, k * n + i)).collect();
        for k in 0..k {
            let j = neighbor[i * slots + k].min(step.superpoints - 1) as usize;
            let u = mean_properties(sums, m, j);
            let inverse = inverse_weight(sums, j);
            for p in 0..3 {
                let pull = planes(pulls, FIRST_PAIR_VALUE + 3 * p, m, j).map(|v| -inverse * v);
                let both: [f32; 3] = std::array::from_fn(|c| g[p][c] + pull[c]);
                d_a[k] += dot(both, std::array::from_fn(|c| value[p][c] - u[p][c]));
                (0..3).for_each(|c| d[p][c] += a[k] * pull[c]);
            }
            d_total += a[k] * d_a[k];
        }
        let pose_gradient = [cross(turned, d[0]), d[1], std::array::from_fn(|c| d[0][c] + d[2][c])];
        pose_gradient.as_flattened().iter().enumerate().for_each(|(c, x)| twin::set_f32(own_gradient, c * n + i, *x));
        let back = displacement(exp(value[1].map(|r| -r)), d[0]);
        (0..3).for_each(|c| twin::set_f32(d_mean, c * n + i, d[0][c] + back[c]));
        if counters[COUNT_FAILED as usize] == 0 {
            for (slot, at) in (i * slots..(i + 1) * slots).enumerate() {
                if slot < k || neighbor[at] != NO_SUPERPOINT {
                    let g = if slot < k { a[slot] * (d_a[slot] - d_total) } else { 0.0 };
                    update_logit(&step, [&mut *logit, &mut *m1, &mut *m2], at, g, words, i);
                }
            }
        }
    }
}
