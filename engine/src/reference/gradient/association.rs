//! The association matrix in f64: nearest superpoints, softmax over them, its backward; and how Gaussians placed by
//! superpoints pass gradients on.

use glam::{DMat3, DQuat, DVec3};

use super::motion::{left_jacobian, rotation_gradient};
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
            let turn_quaternion = DQuat::from_scaled_axis(self.pose[j].rotation);
            let local = rotation_t.transpose() * turning;
            out.rotation.push(rotation_gradient(self.rotation[i], turn_quaternion, None, local).raw);
            out.tangent.push([omega, d_mean[i]]);
            tangent[j] += omega;
            out.pose[j].translation += d_mean[i];
        }
        for (j, omega) in tangent.into_iter().enumerate() {
            out.pose[j].rotation = left_jacobian(self.pose[j].rotation).transpose() * omega;
        }
        out
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::reference::gradient::property::PropertyInput;
    use crate::reference::gradient::test_numbers::{Numbers, check, quaternion};
    use crate::scene::motion::PropertyLoss;

    /// Gaussians, superpoints and upstream gradients at random; every parameter is in one flat list.
    struct Random {
        n: usize,
        m: usize,
        k: usize,
        mean: Vec<DVec3>,
        rotation: Vec<[f64; 4]>,
        of_gaussian: Vec<u32>,
        pose: Vec<Pose>,
        position: Vec<DVec3>,
        neighbor: Vec<u32>,
        logit: Vec<f64>,
        d_mean: Vec<DVec3>,
        d_rotation: Vec<DMat3>,
    }

    impl Random {
        fn new(seed: u64) -> Self {
            let (n, m, k) = (60, 11, 5);
            let mut rng = Numbers(seed);
            let mean: Vec<DVec3> = (0..n).map(|_| rng.vector()).collect();
            let position: Vec<DVec3> = (0..m).map(|_| rng.vector()).collect();
            let size = |j: usize| [0.0, 1e-5, 0.4, 1.5, 5.0][j % 5];
            Self {
                rotation: (0..n).map(|_| quaternion(&mut rng)).collect(),
                of_gaussian: (0..n).map(|i| (i * 7 % m) as u32).collect(),
                pose: (0..m).map(|j| Pose { rotation: rng.vector() * size(j), translation: rng.vector() }).collect(),
                neighbor: nearest(&mean, &position, k),
                logit: (0..n * k).map(|_| rng.signed()).collect(),
                d_mean: (0..n).map(|_| rng.vector()).collect(),
                d_rotation: (0..n).map(|_| DMat3::from_cols(rng.vector(), rng.vector(), rng.vector())).collect(),
                n,
                m,
                k,
                mean,
                position,
            }
        }

        fn loss_of_motion(&self) -> f64 {
            let placed = self.placement().place();
            let parts = placed.iter().zip(self.d_mean.iter().zip(&self.d_rotation));
            parts
                .map(|((mean, r), (d_mean, d_r))| {
                    let columns = [(r.x_axis, d_r.x_axis), (r.y_axis, d_r.y_axis), (r.z_axis, d_r.z_axis)];
                    mean.dot(*d_mean) + columns.iter().map(|(a, b)| a.dot(*b)).sum::<f64>()
                })
                .sum()
        }

        fn placement(&self) -> Placement<'_> {
            let Self { mean, rotation, of_gaussian, pose, .. } = self;
            Placement { mean, rotation, of_gaussian, pose }
        }

        fn input(&self) -> PropertyInput<'_> {
            PropertyInput {
                mean: &self.mean,
                of_gaussian: &self.of_gaussian,
                neighbors: self.k,
                neighbor: &self.neighbor,
                logit: &self.logit,
                position: &self.position,
                pose: &self.pose,
            }
        }

        /// Σ λ·loss; in the code's form with the moved means held at `target`.
        fn property_loss(&self, form: PropertyLoss, lambda: [f64; 3]) -> f64 {
            let loss = self.input().gradient(form, lambda).loss;
            (0..3).map(|p| lambda[p] * loss[p]).sum()
        }
    }

    /// Bumps component `c` of parameter `i` of one kind.
    fn bump(case: &mut Random, kind: &str, i: usize, c: usize, by: f64) {
        match kind {
            "mean" => case.mean[i % case.n][c % 3] += by,
            "rotation" => case.rotation[i % case.n][c % 4] += by,
            "pose rotation" => case.pose[i % case.m].rotation[c % 3] += by,
            "pose translation" => case.pose[i % case.m].translation[c % 3] += by,
            _ => case.logit[(i * 4 + c) % (case.n * case.k)] += by,
        }
    }

    #[test]
    fn motion_gradients_are_central_differences() {
        for kind in ["mean", "rotation", "pose rotation", "pose translation"] {
            check(kind, 520, |at| {
                let mut case = Random::new((at / 40) as u64);
                let (i, c) = (at * 5 + at / 40, at % 12);
                let g = case.placement().gradient(&case.d_mean, &case.d_rotation);
                let analytic = match kind {
                    "mean" => g.mean[i % case.n][c % 3],
                    "rotation" => g.rotation[i % case.n][c % 4],
                    "pose rotation" => g.pose[i % case.m].rotation[c % 3],
                    _ => g.pose[i % case.m].translation[c % 3],
                };
                let difference = |h: f64| {
                    let mut side = |by: f64| {
                        bump(&mut case, kind, i, c, by);
                        let loss = case.loss_of_motion();
                        bump(&mut case, kind, i, c, -by);
                        loss
                    };
                    (side(h) - side(-h)) / (2.0 * h)
                };
                (analytic, Numbers::richardson(difference))
            });
        }
    }

    #[test]
    fn property_gradients_are_central_differences() {
        let lambda = [0.7, 1.3, 2.0];
        for form in [PropertyLoss::Paper, PropertyLoss::Code] {
            for kind in ["logit", "pose rotation", "pose translation", "mean"] {
                if form == PropertyLoss::Code && kind == "mean" {
                    continue;
                }
                check(kind, 520, |at| {
                    let mut case = Random::new((at / 40) as u64);
                    let (i, c) = (at * 5 + at / 40, at % 12);
                    let g = case.input().gradient(form, lambda);
                    let analytic = match kind {
                        "mean" => g.mean[i % case.n][c % 3],
                        "pose rotation" => g.pose[i % case.m].rotation[c % 3],
                        "pose translation" => g.pose[i % case.m].translation[c % 3],
                        _ => g.logit[(i * 4 + c) % (case.n * case.k)],
                    };
                    // The code's form holds the moved means: a mean moves against its bumped pose to stay where it is.
                    let original: Vec<DVec3> = case.placement().place().into_iter().map(|(x, _)| x).collect();
                    let difference = |h: f64| {
                        let mut side = |by: f64| {
                            let kept = case.mean.clone();
                            bump(&mut case, kind, i, c, by);
                            if form == PropertyLoss::Code {
                                for (g, x) in original.iter().enumerate() {
                                    let pose = case.pose[case.of_gaussian[g] as usize];
                                    case.mean[g] = exp(pose.rotation).transpose() * (*x - pose.translation);
                                }
                            }
                            let loss = case.property_loss(form, lambda);
                            bump(&mut case, kind, i, c, -by);
                            case.mean = kept;
                            loss
                        };
                        (side(h) - side(-h)) / (2.0 * h)
                    };
                    (analytic, Numbers::richardson(difference))
                });
            }
        }
    }

    #[test]
    fn the_code_form_holds_the_means() {
        let case = Random::new(1);
        let g = case.input().gradient(PropertyLoss::Code, [1.0; 3]);
        assert!(g.mean.iter().all(|m| *m == DVec3::ZERO));
    }
}
