//! Backward of placing a Gaussian: quaternions, superpoint poses, so(3).

use glam::{DMat3, DQuat, DVec3};

use crate::reference::soft::{SharedTurn, WeightedPose, only, shared_turn};
use crate::reference::{Pose, exp};

/// Left Jacobian of so(3): Exp(r + δ) ≈ Exp(J_l(r)δ)Exp(r); I + (1 − cosθ)/θ²·K + (θ − sinθ)/θ³·K², θ = |r|.
///
/// With ω the gradient by a left tangent (dL = ω·δφ for Exp(δφ)Exp(r)), dL/dr = J_l(r)ᵀω.
pub fn left_jacobian(r: DVec3) -> DMat3 {
    let theta2 = r.length_squared();
    let theta = theta2.sqrt();
    let half = if theta2 > 0.0 { (0.5 * theta).sin() / (0.5 * theta) } else { 1.0 };
    // The closed form loses all digits as θ → 0; below, the first term left out is θ¹⁴/3.6e14 < 2e-19.
    let third = if theta2 < 0.25 {
        let mut term = 1.0 / 6.0;
        let mut sum = term;
        for k in [20.0, 42.0, 72.0, 110.0, 156.0, 210.0] {
            term *= -theta2 / k;
            sum += term;
        }
        sum
    } else {
        (theta - theta.sin()) / (theta2 * theta)
    };
    let k = DMat3::from_cols(DVec3::new(0.0, r.z, -r.y), DVec3::new(-r.z, 0.0, r.x), DVec3::new(r.y, -r.x, 0.0));
    DMat3::IDENTITY + k * (0.5 * half * half) + k * k * third
}

/// w,x,y,z.
fn quaternion(q: [f64; 4]) -> DQuat {
    DQuat::from_xyzw(q[1], q[2], q[3], q[0])
}

fn wxyz(q: DQuat) -> [f64; 4] {
    [q.w, q.x, q.y, q.z]
}

/// Gradient of q, of length `length`, from the gradient `local` by a right tangent of q/|q| (R ↦ R·Exp(ψ)). The tangent
/// step ψ is ½q̂∘(0, ψ), so dL/dq = 2q̂∘(0, local)/|q|, which is normal to q.
fn quaternion_gradient(unit: DQuat, length: f64, local: DVec3) -> DQuat {
    unit * DQuat::from_xyzw(local.x, local.y, local.z, 0.0) * (2.0 / length)
}

/// Gradients of the quaternions of one Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotationGradient {
    /// Of the raw parameter, w,x,y,z.
    pub raw: [f64; 4],
    /// Of the non-rigid offset dq, w,x,y,z; 0 without one.
    pub offset: [f64; 4],
    /// By a left tangent of the superpoint's rotation, in world axes.
    pub world: DVec3,
}

/// Backward of q̂ = norm(Exp(r)∘norm(`raw`) + dq) from the gradient `local` by a right tangent of q̂.
pub fn rotation_gradient(raw: [f64; 4], turn: DQuat, offset: Option<[f64; 4]>, local: DVec3) -> RotationGradient {
    let raw = quaternion(raw);
    let unit = raw * (1.0 / raw.length());
    let rigid = turn * unit;
    let mut offset_gradient = [0.0; 4];
    let mut rigid_local = local;
    if let Some(offset) = offset {
        let sum = rigid + quaternion(offset);
        let length = sum.length();
        let gradient = quaternion_gradient(sum * (1.0 / length), length, local);
        offset_gradient = wxyz(gradient);
        let back = rigid.conjugate() * gradient;
        rigid_local = 0.5 * DVec3::new(back.x, back.y, back.z);
    }
    RotationGradient {
        raw: wxyz(quaternion_gradient(unit, raw.length(), rigid_local)),
        offset: offset_gradient,
        world: DMat3::from_quat(rigid) * rigid_local,
    }
}

/// dL/d(r, τ) from the left-tangent gradient `omega` and dL/dτ.
pub fn pose_gradient(pose: &Pose, omega: DVec3, translation: DVec3) -> [DVec3; 2] {
    [left_jacobian(pose.rotation).transpose() * omega, translation]
}

/// Gradients of one pose that moves a Gaussian, and of its weight.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PoseGradient {
    /// By a left tangent of its rotation: dL = ω·δφ for Exp(δφ)Exp(r).
    pub omega: DVec3,
    /// Of its translation.
    pub translation: DVec3,
    /// Of its weight, which is free here: the weights of a Gaussian need not sum to 1. What normalises them has its own
    /// gradient, dL/dv_k = (dL/dw_k − Σ_j w_j dL/dw_j) / Σ_j v_j for w = v/Σv.
    pub weight: f64,
}

/// Backward of soft superpoints, slot by slot: from dL/dμ(t) `moved` and the gradient `world` by a left tangent of the rotation
/// that the poses share. `mean`: the canonical centre.
///
/// With p_k = Exp(r_k)μ and g = 2(0, `world`)∘unit/|b| (normal to b, as `unit` = b/|b| keeps its length):
/// ω_k = vec(½ s_k w_k g∘q̄_k) + w_k p_k × `moved`, dL/dτ_k = w_k `moved`, dL/dw_k = (p_k + τ_k)·`moved` + s_k q_k·g.
pub fn pose_gradients(poses: &[WeightedPose], mean: DVec3, moved: DVec3, world: DVec3) -> Vec<PoseGradient> {
    if poses.is_empty() {
        return Vec::new();
    }
    let SharedTurn { unit, length, aligned } = shared_turn(poses);
    let slope = DQuat::from_xyzw(world.x, world.y, world.z, 0.0) * unit * (2.0 / length);
    let alone = poses.len() == 1 && only(poses).is_some();
    let gradient = |(slot, q): (&WeightedPose, &DQuat)| {
        let (w, point) = (slot.weight, exp(slot.pose.rotation) * mean);
        let back = slope * q.conjugate() * (0.5 * w);
        // The same in exact numbers; without rounding the quaternions once more.
        let turn = if alone { world } else { DVec3::new(back.x, back.y, back.z) };
        PoseGradient {
            omega: turn + w * point.cross(moved),
            translation: w * moved,
            weight: (point + slot.pose.translation).dot(moved) + q.dot(slope),
        }
    };
    poses.iter().zip(&aligned).map(gradient).collect()
}
