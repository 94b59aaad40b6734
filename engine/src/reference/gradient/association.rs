//! The association matrix in f64: nearest superpoints, softmax over them, its backward; and how Gaussians placed by
//! superpoints pass gradients on.

use glam::{DMat3, DQuat, DVec3};

use crate::reference::{Pose, exp, rotation_of_quaternion};

/// `[N,K]` indices of the K positions nearest to each point, nearest first, ties by lowest index.
pub fn nearest(points: &[DVec3], positions: &[DVec3], k: usize) -> Vec<u32> {
    let mut neighbor = Vec::with_capacity(points.len() * k);
    for &x in points {
        let mut order: Vec<u32> = (0..positions.len() as u32).collect();
        let distance = |j: u32| (positions[j as usize] - x).length_squared();
        order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
        neighbor.extend_from_slice(&order[..k]);
    }
    neighbor
}

/// Softmax of each row of K logits: the association a_ik.
pub fn weights(logit: &[f64], k: usize) -> Vec<f64> {
    let rows = logit.chunks_exact(k).flat_map(|row| {
        let top = row.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = row.iter().map(|l| (l - top).exp()).sum();
        row.iter().map(move |l| (l - top).exp() / sum)
    });
    rows.collect()
}

/// dL/d logit from dL/da: a_k (dL/da_k − Σ a dL/da).
pub fn logit_gradient(weight: &[f64], d_weight: &[f64], k: usize) -> Vec<f64> {
    let rows = weight.chunks_exact(k).zip(d_weight.chunks_exact(k));
    let gradient = rows.flat_map(|(a, d)| {
        let mean: f64 = a.iter().zip(d).map(|(a, d)| a * d).sum();
        a.iter().zip(d).map(move |(a, d)| a * (d - mean))
    });
    gradient.collect()
}

/// dL/dr from the left-tangent gradient ω (dL = ω·δφ for Exp(δφ)Exp(r)): J_l(r)ᵀω with J_l = I + (1−cosθ)/θ²·K +
/// (θ−sinθ)/θ³·K².
pub fn rotation_vector_gradient(r: DVec3, omega: DVec3) -> DVec3 {
    let theta2 = r.length_squared();
    let theta = theta2.sqrt();
    let half = if theta > 1e-8 { (0.5 * theta).sin() / theta } else { 0.5 };
    // The closed form loses all digits as θ → 0.
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
    let turned = r.cross(omega);
    omega - 2.0 * half * half * turned + third * r.cross(turned)
}

/// Gaussians moved by superpoints, in f64.
#[derive(Debug, Clone, Copy)]
pub struct Placement<'a> {
    /// `[N]` canonical means.
    pub mean: &'a [DVec3],
    /// `[N]` quaternions w,x,y,z of any length > 0.
    pub rotation: &'a [[f64; 4]],
    /// `[N]` the superpoint each moves with.
    pub of_gaussian: &'a [u32],
    /// `[M]`.
    pub pose: &'a [Pose],
}

/// What [`Placement::gradient`] gives.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlacementGradient {
    /// `[N]` of the canonical means.
    pub mean: Vec<DVec3>,
    /// `[N]` of the quaternions w,x,y,z as stored.
    pub rotation: Vec<[f64; 4]>,
    /// `[N]` of each Gaussian's pose: left tangent ω and dL/dτ.
    pub tangent: Vec<[DVec3; 2]>,
    /// `[M]` of the poses.
    pub pose: Vec<Pose>,
}

impl Placement<'_> {
    /// `[N]` mean(t) and R(t).
    pub fn place(&self) -> Vec<(DVec3, DMat3)> {
        let place = |i: usize| {
            let pose = &self.pose[self.of_gaussian[i] as usize];
            let turn = exp(pose.rotation);
            (turn * self.mean[i] + pose.translation, turn * rotation_of_quaternion(self.rotation[i]))
        };
        (0..self.mean.len()).map(place).collect()
    }

    /// Backward of [`Placement::place`].
    pub fn gradient(&self, d_mean: &[DVec3], d_rotation: &[DMat3]) -> PlacementGradient {
        let mut out = PlacementGradient { pose: vec![Pose::default(); self.pose.len()], ..Default::default() };
        let mut tangent = vec![DVec3::ZERO; self.pose.len()];
        for (i, (_, rotation_t)) in self.place().into_iter().enumerate() {
            let j = self.of_gaussian[i] as usize;
            let turn = exp(self.pose[j].rotation);
            let columns = |m: &DMat3| [m.x_axis, m.y_axis, m.z_axis];
            let pairs = columns(&rotation_t).into_iter().zip(columns(&d_rotation[i]));
            let turning: DVec3 = pairs.map(|(r, d)| r.cross(d)).sum();
            let omega = turning + (turn * self.mean[i]).cross(d_mean[i]);
            out.mean.push(turn.transpose() * d_mean[i]);
            out.rotation.push(quaternion_gradient(self.rotation[i], rotation_t.transpose() * turning));
            out.tangent.push([omega, d_mean[i]]);
            tangent[j] += omega;
            out.pose[j].translation += d_mean[i];
        }
        for (j, omega) in tangent.into_iter().enumerate() {
            out.pose[j].rotation = rotation_vector_gradient(self.pose[j].rotation, omega);
        }
        out
    }
}

/// dL/dq from the gradient `local` by a right tangent of q/|q|: 2q̂∘(0, local)/|q|.
fn quaternion_gradient(q: [f64; 4], local: DVec3) -> [f64; 4] {
    let raw = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    let length = raw.length();
    let g = raw * (1.0 / length) * DQuat::from_xyzw(local.x, local.y, local.z, 0.0) * (2.0 / length);
    [g.w, g.x, g.y, g.z]
}
