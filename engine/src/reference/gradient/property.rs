//! Property reconstruction losses in f64, both forms, with their gradients.

use glam::DVec3;

use super::association::{logit_gradient, weights};
use super::motion::left_jacobian;
use crate::reference::{Pose, exp};
use crate::scene::motion::PropertyLoss;

/// Inputs of the losses.
#[derive(Debug, Clone, Copy)]
pub struct PropertyInput<'a> {
    /// `[N]` canonical means.
    pub mean: &'a [DVec3],
    /// `[N]`.
    pub of_gaussian: &'a [u32],
    /// K.
    pub neighbors: usize,
    /// `[N,K]`.
    pub neighbor: &'a [u32],
    /// `[N,K]`.
    pub logit: &'a [f64],
    /// `[M]` canonical centres p^c.
    pub position: &'a [DVec3],
    /// `[M]` poses at the time.
    pub pose: &'a [Pose],
}

/// Gradient of λ·losses.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PropertyGradient {
    /// Losses of position, rotation, translation, unweighted.
    pub loss: [f64; 3],
    /// `[N,K]`.
    pub logit: Vec<f64>,
    /// `[N]`.
    pub mean: Vec<DVec3>,
    /// `[M]` of r and τ.
    pub pose: Vec<Pose>,
}

/// Position at the time, so(3) vector, translation of a point that moves with `pose`.
fn properties(pose: &Pose, x: DVec3) -> [DVec3; 3] {
    [exp(pose.rotation) * x + pose.translation, pose.rotation, pose.translation]
}

impl PropertyInput<'_> {
    fn own(&self, i: usize) -> usize {
        self.of_gaussian[i] as usize
    }

    /// (i, k, superpoint) of every pair.
    fn pairs(&self) -> impl Iterator<Item = (usize, usize, usize)> + '_ {
        let k = self.neighbors;
        self.neighbor.iter().enumerate().map(move |(at, &j)| (at / k, at, j as usize))
    }

    /// Properties of the superpoints: their own, or means over the Gaussians.
    fn superpoint_values(&self, form: PropertyLoss, v: &[[DVec3; 3]], a: &[f64], total: &[f64]) -> Vec<[DVec3; 3]> {
        if form != PropertyLoss::Paper {
            return self.pose.iter().zip(self.position).map(|(pose, &x)| properties(pose, x)).collect();
        }
        let mut u = vec![[DVec3::ZERO; 3]; self.pose.len()];
        for (i, at, j) in self.pairs() {
            (0..3).for_each(|p| u[j][p] += v[i][p] * (a[at] / total[j]));
        }
        u
    }

    /// Losses and the gradient of Σ λ_p loss_p.
    pub fn gradient(&self, form: PropertyLoss, lambda: [f64; 3]) -> PropertyGradient {
        let (n, m) = (self.mean.len(), self.pose.len());
        let a = weights(self.logit, self.neighbors);
        let v: Vec<[DVec3; 3]> = (0..n).map(|i| properties(&self.pose[self.own(i)], self.mean[i])).collect();
        let mut total = vec![0.0; m];
        self.pairs().for_each(|(_, at, j)| total[j] += a[at]);
        let u = self.superpoint_values(form, &v, &a, &total);
        let mut residual = v.clone();
        for (i, at, j) in self.pairs() {
            (0..3).for_each(|p| residual[i][p] -= u[j][p] * a[at]);
        }
        let scale = 1.0 / (3.0 * n as f64);
        let mut out =
            PropertyGradient { pose: vec![Pose::default(); m], mean: vec![DVec3::ZERO; n], ..Default::default() };
        for r in &residual {
            (0..3).for_each(|p| out.loss[p] += scale * r[p].length_squared());
        }
        for r in &mut residual {
            (0..3).for_each(|p| r[p] *= 2.0 * scale * lambda[p]);
        }
        let mut d_u = vec![[DVec3::ZERO; 3]; m];
        let mut d_a = vec![0.0; a.len()];
        for (i, at, j) in self.pairs() {
            for p in 0..3 {
                d_u[j][p] -= residual[i][p] * a[at];
                d_a[at] -= residual[i][p].dot(u[j][p]);
            }
        }
        match form {
            PropertyLoss::Paper => {
                let mut d_v = residual;
                for (i, at, j) in self.pairs() {
                    for p in 0..3 {
                        let pull = d_u[j][p] / total[j];
                        d_a[at] += pull.dot(v[i][p] - u[j][p]);
                        d_v[i][p] += pull * a[at];
                    }
                }
                self.add_own(&d_v, &mut out);
            }
            _ => self.add_outputs(&residual, &d_u, &mut out),
        }
        out.logit = logit_gradient(&a, &d_a, self.neighbors);
        out
    }

    /// Paper: gradients of the Gaussians' properties go to their means and their superpoints' poses.
    fn add_own(&self, d_v: &[[DVec3; 3]], out: &mut PropertyGradient) {
        let mut tangent = vec![DVec3::ZERO; self.pose.len()];
        for (i, d) in d_v.iter().enumerate() {
            let j = self.own(i);
            let turn = exp(self.pose[j].rotation);
            out.mean[i] = turn.transpose() * d[0];
            tangent[j] += (turn * self.mean[i]).cross(d[0]);
            out.pose[j].rotation += d[1];
            out.pose[j].translation += d[0] + d[2];
        }
        self.add_tangents(&tangent, out);
    }

    /// Code: gradients of the superpoints' properties, and of the Gaussians' rotation and translation, go to the poses.
    fn add_outputs(&self, d_v: &[[DVec3; 3]], d_u: &[[DVec3; 3]], out: &mut PropertyGradient) {
        let mut tangent = vec![DVec3::ZERO; self.pose.len()];
        for (j, d) in d_u.iter().enumerate() {
            tangent[j] = (exp(self.pose[j].rotation) * self.position[j]).cross(d[0]);
            out.pose[j].rotation += d[1];
            out.pose[j].translation += d[0] + d[2];
        }
        for (i, d) in d_v.iter().enumerate() {
            let pose = &mut out.pose[self.own(i)];
            pose.rotation += d[1];
            pose.translation += d[2];
        }
        self.add_tangents(&tangent, out);
    }

    fn add_tangents(&self, tangent: &[DVec3], out: &mut PropertyGradient) {
        for ((pose, gradient), &omega) in self.pose.iter().zip(&mut out.pose).zip(tangent) {
            gradient.rotation += left_jacobian(pose.rotation).transpose() * omega;
        }
    }
}
