//! `superpoint_gradient` and `superpoint_commit`.

use super::segment::{FIRST_OWN_VALUE, FIRST_PAIR_VALUE};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::angle::sin_cos;
use crate::render::limits::COUNT_FAILED;
use crate::render::{quaternion, twin};
use crate::train::status;
use crate::train::step::Step;

/// Group of `status` for reports about poses.
pub const POSE_GROUP: usize = 9;
/// Least sum of weights that a centre is divided by.
const LEAST_WEIGHT: f32 = 1e-5;

/// Gradient of each superpoint's pose. Dispatch ceil(M / 256) workgroups.
pub static SUPERPOINT_GRADIENT: Kernel = Kernel {
    name: "superpoint_gradient",
    doc: "gradient of each superpoint's so(3) vector and translation, from rendering and property losses",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "PROPERTIES"],
    push: &[],
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("pose", Access::Read, Element::F32),
        Binding::new("superpoint_position", Access::Read, Element::F32),
        Binding::new("property_sum", Access::Read, Element::F32),
        Binding::new("pose_sum", Access::Read, Element::F32),
        Binding::new("superpoint_gradient", Access::Write, Element::F32),
        Binding::new("status", Access::Atomic, Element::U32),
    ],
    twin: superpoint_gradient_twin,
    tolerance: Tolerance { absolute: 1e-5, relative: 1e-5, flips: 0.0 },
    bytes: |w| 4 * (8 + 3 + 15 + 6 + 6) * w.get("superpoints"),
    spirv: include_bytes!("../../../../spirv_cache/superpoint_gradient.spv"),
};

/// What the next step uses. Dispatch ceil(max(N, M) / 256) workgroups.
pub static SUPERPOINT_COMMIT: Kernel = Kernel {
    name: "superpoint_commit",
    doc: "sets the assignment and the superpoint centres of the next step",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: &[],
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("superpoint_sum", Access::Read, Element::F32),
        Binding::new("next_superpoint", Access::Read, Element::U32),
        Binding::new("superpoint_of_gaussian", Access::Update, Element::U32),
        Binding::new("superpoint_position", Access::Update, Element::F32),
        Binding::new("status", Access::Atomic, Element::U32),
    ],
    twin: superpoint_commit_twin,
    tolerance: Tolerance { absolute: 0.0, relative: 5e-7, flips: 0.0 },
    bytes: |w| 8 * w.get("gaussians"),
    spirv: include_bytes!("../../../../spirv_cache/superpoint_commit.spv"),
};

/// J_l(r)ᵀω, twin of the GLSL: ω − B·r×ω + C·r×(r×ω).
pub fn left_jacobian_transposed(r: [f32; 3], w: [f32; 3]) -> [f32; 3] {
    let angle2 = quaternion::dot(r, r);
    let angle = angle2.sqrt();
    let h = if angle2 > 1e-12 { sin_cos(0.5 * angle)[0] / angle } else { 0.5 };
    let b = 2.0 * h * h;
    let last = 1.0 / 362_880.0 - angle2 * (1.0 / 39_916_800.0);
    let series = 1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 * (1.0 / 5040.0 - angle2 * last));
    let c = if angle2 < 1.0 { series } else { (angle - sin_cos(angle)[0]) / (angle2 * angle.max(1.0)) };
    let turned = quaternion::cross(r, w);
    let twice = quaternion::cross(r, turned);
    std::array::from_fn(|i| w[i] - b * turned[i] + c * twice[i])
}

fn superpoint_gradient_twin(call: &mut TwinCall<'_>) {
    let properties = twin::spec(call, 1);
    let [step, pose, position, property_sum, pose_sum, gradient, words] = call.buffers else { return };
    let step: Step = twin::struct_at(step, 0);
    let m = step.superpoints as usize;
    for j in 0..m {
        let sums = |words: &[u32], plane: usize| [0, 1, 2].map(|c| twin::f32_at(words, (plane + c) * m + j));
        let property = |plane: usize| sums(property_sum, plane);
        let [rx, ry, rz, _] = twin::vec4_at(pose, 2 * j);
        let r = [rx, ry, rz];
        let mut tangent = sums(pose_sum, FIRST_OWN_VALUE);
        let mut vector = [0.0_f32; 3];
        let mut translation = sums(pose_sum, FIRST_OWN_VALUE + 3);
        match properties {
            1 => {
                let x = [0, 1, 2].map(|c| twin::f32_at(position, 3 * j + c));
                let pull = property(FIRST_PAIR_VALUE).map(|v| -v);
                let shift = quaternion::displacement(quaternion::exp(r), x);
                let turn = quaternion::cross([0, 1, 2].map(|c| x[c] + shift[c]), pull);
                let (own_r, own_t) = (property(FIRST_OWN_VALUE), property(FIRST_OWN_VALUE + 3));
                let (pair_r, pair_t) = (property(FIRST_PAIR_VALUE + 3), property(FIRST_PAIR_VALUE + 6));
                for c in 0..3 {
                    tangent[c] += turn[c];
                    vector[c] += own_r[c] - pair_r[c];
                    translation[c] += pull[c] + own_t[c] - pair_t[c];
                }
            }
            2 => {
                for c in 0..3 {
                    tangent[c] += property(FIRST_OWN_VALUE)[c];
                    vector[c] += property(FIRST_OWN_VALUE + 3)[c];
                    translation[c] += property(FIRST_OWN_VALUE + 6)[c];
                }
            }
            _ => {}
        }
        let turned = left_jacobian_transposed(r, tangent);
        let mut result: [f32; 6] =
            std::array::from_fn(|c| if c < 3 { vector[c] + turned[c] } else { translation[c - 3] });
        if !result.iter().map(|v| v.abs()).sum::<f32>().is_finite() {
            status::report(words, POSE_GROUP, j as u32);
            result = [0.0; 6];
        }
        result.into_iter().enumerate().for_each(|(c, v)| twin::set_f32(gradient, c * m + j, v));
    }
}

fn superpoint_commit_twin(call: &mut TwinCall<'_>) {
    let [step, counters, sums, next, own, position, words] = call.buffers else { return };
    let step: Step = twin::struct_at(step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    if counters[COUNT_FAILED as usize] != 0 {
        return;
    }
    own[..n].copy_from_slice(&next[..n]);
    for j in 0..m {
        let total = twin::f32_at(sums, j);
        let center = [1, 2, 3].map(|p| twin::f32_at(sums, p * m + j) / total.max(LEAST_WEIGHT));
        let finite = center.iter().all(|c| c.is_finite());
        if total > 0.0 && finite {
            center.into_iter().enumerate().for_each(|(c, v)| twin::set_f32(position, 3 * j + c, v));
        } else if !finite {
            status::report(words, POSE_GROUP, j as u32);
        }
    }
}
