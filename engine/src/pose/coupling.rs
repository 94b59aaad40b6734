//! What superpoints owe their neighbours: as rigid as possible, where training says that they are.
//!
//! For neighbours j and k with centres x and turns R, rest offset d_jk = mean_t R_jᵀ(x_k − x_j) and rest turn
//! Q_jk = mean_t R_jᵀR_k over the key times of training,
//!
//! E = Σ w_jk (‖R_j d_jk + x_j − x_k‖² + ρ_jk² ‖log(Q_jkᵀ R_jᵀ R_k)‖²) / u_j²,
//! w_jk = exp(−d²/2σ²) exp(−var_t d_jk/σ_v²) / K
//!
//! with the reach ρ of the smaller one and u world units per pixel. (Sorkine and Alexa 2007, with a rest state from the motion
//! instead of one shape, so that pairs which training has never seen apart stay together however they stand canonically.)

use glam::{DMat3, DQuat, DVec3};

use super::bodies::{Bodies, Stand};
use super::gauss_newton::{Normal, Numbers};
use super::information::Block;
use crate::edit::unwrapped;
use crate::reference::table_poses;
use crate::scene::Motion;
use crate::train::photo_loss::Twist;

/// Neighbours of each superpoint.
const NEIGHBORS: usize = 8;
/// σ_v in units of σ: parts that bend against each other a little still hold on. With 0.05 the rigid parts that training ends with
/// drifted apart.
const SLACK: f64 = 0.2;
/// Least share of a weight that variation over time leaves: what no pixel sees has something to follow.
const LEAST: f64 = 1e-3;
/// Most key times that are looked at.
const MOST_TIMES: usize = 64;

/// Two superpoints that are near each other.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pair {
    j: usize,
    k: usize,
    weight: f64,
    offset: DVec3,
    turn: DQuat,
    reach: f64,
}

/// The pairs of a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Coupling {
    pairs: Vec<Pair>,
}

impl Coupling {
    /// From the motion of training.
    pub fn new(bodies: &Bodies, motion: &Motion) -> Self {
        let count = motion.times.len().min(MOST_TIMES);
        let time = |i: usize| f64::from(motion.times[i * (motion.times.len() - 1) / (count - 1).max(1)]);
        let stands: Vec<Vec<Stand>> = (0..count).map(|i| bodies.stands(&table_poses(motion, time(i)))).collect();
        let m = bodies.center.len();
        let near: Vec<Vec<(usize, f64)>> = (0..m).map(|j| nearest(&stands, j, m)).collect();
        let mut distances: Vec<f64> = near.iter().flatten().map(|(_, d)| *d).collect();
        distances.sort_by(f64::total_cmp);
        let sigma = distances.get(distances.len() / 2).copied().unwrap_or(1.0).max(1e-9);
        let pair = |j: usize, (k, distance): (usize, f64)| {
            let (offset, turn, variance) = rest(&stands, j, k);
            let close = (-0.5 * (distance / sigma).powi(2)).exp();
            let steady = (-variance / (SLACK * sigma).powi(2)).exp().max(LEAST);
            let reach = bodies.reach[j].min(bodies.reach[k]);
            Pair { j, k, weight: close.max(LEAST) * steady / NEIGHBORS as f64, offset, turn, reach }
        };
        Self { pairs: (0..m).flat_map(|j| near[j].iter().map(move |&n| (j, n))).map(|(j, n)| pair(j, n)).collect() }
    }

    /// The energy in units of 1/`unit`² of each superpoint, and `scale` times its gradient by turns about the centres and by shifts,
    /// which is added.
    pub fn add(&self, stands: &[Stand], unit: &[f64], scale: f64, gradient: &mut [Twist]) -> f64 {
        let mut energy = 0.0;
        for p in &self.pairs {
            let (a, b) = (stands[p.j], stands[p.k]);
            let weight = p.weight / unit[p.j].powi(2);
            let arm = a.turn * p.offset;
            let gap = arm + a.place - b.place;
            let twist = unwrapped((a.turn * p.turn).conjugate() * b.turn, DVec3::ZERO);
            let stiff = weight * p.reach.powi(2);
            energy += weight * gap.length_squared() + stiff * twist.length_squared();
            let (pull, turn) = (2.0 * scale * weight * gap, 2.0 * scale * stiff * (b.turn * twist));
            gradient[p.j] = gradient[p.j] + Twist { rotation: arm.cross(pull) - turn, translation: pull };
            gradient[p.k] = gradient[p.k] + Twist { rotation: turn, translation: -pull };
        }
        energy
    }
}

impl Coupling {
    /// Those that a superpoint is held to.
    pub(super) fn neighbours(&self, j: usize) -> impl Iterator<Item = usize> + '_ {
        self.pairs.iter().filter(move |p| p.j == j).map(|p| p.k)
    }

    /// Adds `scale` times the Hessian of the energy, as Gauss–Newton has it.
    pub(super) fn add_hessian(&self, stands: &[Stand], numbers: &Numbers, scale: f64, normal: &mut Normal) {
        for p in &self.pairs {
            let [[turn_j, shift_j], [turn_k, shift_k]] = [numbers.units[p.j], numbers.units[p.k]];
            let weight = 2.0 * scale * p.weight / shift_j.powi(2);
            let arm = numbers.axes * (stands[p.j].turn * p.offset);
            // Changes of the gap and of the twist by the numbers of j and of k.
            let cross = DMat3::from_cols(arm.cross(DVec3::X), arm.cross(DVec3::Y), arm.cross(DVec3::Z));
            let gap = [(-cross * turn_j, shift_j), (DMat3::ZERO, -shift_k)];
            let twist = [-turn_j * p.reach, turn_k * p.reach];
            for (a, j) in [p.j, p.k].into_iter().enumerate() {
                for (b, k) in [p.j, p.k].into_iter().enumerate().skip(a) {
                    let stiff = DMat3::from_diagonal(DVec3::splat(twist[a] * twist[b]));
                    let parts = [
                        [gap[a].0.transpose() * gap[b].0 + stiff, gap[a].0.transpose() * gap[b].1],
                        [gap[b].0 * gap[a].1, DMat3::from_diagonal(DVec3::splat(gap[a].1 * gap[b].1))],
                    ];
                    let value = |r: usize, c: usize| weight * parts[r / 3][c / 3].col(c % 3)[r % 3];
                    normal.add_block(j, k, &std::array::from_fn(|r| std::array::from_fn(|c| value(r, c))));
                }
            }
        }
    }

    /// Adds `scale` times the curvature of the energy to the blocks of turn and shift in units `[turn, shift]`, with the neighbours
    /// held.
    pub(super) fn add_curvature(&self, units: &[[f64; 2]], scale: f64, blocks: &mut [Block]) {
        for p in &self.pairs {
            for j in [p.j, p.k] {
                let [turn, shift] = units[j];
                let weight = 2.0 * scale * p.weight / units[p.j][1].powi(2);
                let arm = if j == p.j { p.offset.length_squared() } else { 0.0 };
                for k in 0..3 {
                    blocks[j][k][k] += weight * (p.reach.powi(2) + 2.0 / 3.0 * arm) * turn * turn;
                    blocks[j][3 + k][3 + k] += weight * shift * shift;
                }
            }
        }
    }
}

/// The nearest superpoints of `j` with their root mean square distances over time.
fn nearest(stands: &[Vec<Stand>], j: usize, m: usize) -> Vec<(usize, f64)> {
    let distance = |k: usize| {
        let sum: f64 = stands.iter().map(|s| s[j].place.distance_squared(s[k].place)).sum();
        (sum / stands.len().max(1) as f64).sqrt()
    };
    let mut all: Vec<(usize, f64)> = (0..m).filter(|&k| k != j).map(|k| (k, distance(k))).collect();
    all.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    all.truncate(NEIGHBORS);
    all
}

/// Mean offset and turn of `k` in the frame of `j`, and the variance of the offset.
fn rest(stands: &[Vec<Stand>], j: usize, k: usize) -> (DVec3, DQuat, f64) {
    let n = stands.len().max(1) as f64;
    let offset = |s: &Vec<Stand>| s[j].turn.conjugate() * (s[k].place - s[j].place);
    let turn = |s: &Vec<Stand>| s[j].turn.conjugate() * s[k].turn;
    let mean: DVec3 = stands.iter().map(offset).sum::<DVec3>() / n;
    let variance = stands.iter().map(|s| offset(s).distance_squared(mean)).sum::<f64>() / n;
    let first = stands.first().map_or(DQuat::IDENTITY, turn);
    let sum = stands
        .iter()
        .map(turn)
        .fold(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), |sum, q| if q.dot(first) < 0.0 { sum - q } else { sum + q });
    (mean, if sum.length() > 1e-9 { sum.normalize() } else { first }, variance)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::pose::information::scaled;
    use crate::scene::synthetic::{Random, moving_scene};

    fn energy(coupling: &Coupling, stands: &[Stand], unit: &[f64]) -> f64 {
        coupling.add(stands, unit, 1.0, &mut vec![Twist::default(); stands.len()])
    }

    #[test]
    fn gradients_are_those_of_central_differences() {
        let scene = moving_scene(400, 9, 6, 5, false);
        let (bodies, motion) = (Bodies::new(&scene), scene.deformation.table().unwrap());
        let coupling = Coupling::new(&bodies, motion);
        let mut random = Random::new(2);
        let stands: Vec<Stand> = bodies
            .stands(&table_poses(motion, 0.4))
            .iter()
            .map(|s| s.moved(0.3 * random.normal3(), 0.1 * random.normal3()))
            .collect();
        let unit: Vec<f64> = (0..9).map(|j| 0.01 + 0.002 * f64::from(j)).collect();
        let mut gradient = vec![Twist::default(); 9];
        coupling.add(&stands, &unit, 1.0, &mut gradient);
        for j in 0..9 {
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let h = 1e-6;
                let at = |turn: DVec3, shift: DVec3| {
                    let mut moved = stands.clone();
                    moved[j] = moved[j].moved(turn, shift);
                    energy(&coupling, &moved, &unit)
                };
                let by_turn = (at(h * axis, DVec3::ZERO) - at(-h * axis, DVec3::ZERO)) / (2.0 * h);
                let by_shift = (at(DVec3::ZERO, h * axis) - at(DVec3::ZERO, -h * axis)) / (2.0 * h);
                let close = |a: f64, b: f64| assert!((a - b).abs() <= 1e-6 * (1.0 + a.abs()), "{j} {axis}: {a} {b}");
                close(by_turn, gradient[j].rotation.dot(axis));
                close(by_shift, gradient[j].translation.dot(axis));
            }
        }
    }

    /// Where nothing pulls, the gradient is H times a small change.
    #[test]
    fn the_hessian_is_that_of_differences_of_the_gradient() {
        let scene = moving_scene(400, 9, 6, 5, false);
        let (bodies, motion) = (Bodies::new(&scene), scene.deformation.table().unwrap());
        let mut coupling = Coupling::new(&bodies, motion);
        let stands = bodies.stands(&table_poses(motion, 0.4));
        // At rest: offsets and turns are those of this moment.
        for p in &mut coupling.pairs {
            let (a, b) = (stands[p.j], stands[p.k]);
            (p.offset, p.turn) = (a.turn.conjugate() * (b.place - a.place), a.turn.conjugate() * b.turn);
        }
        let mut random = Random::new(8);
        let axes = DMat3::from_quat(random.rotation());
        let units: Vec<[f64; 2]> = (0..9).map(|j| [0.03 + 0.001 * f64::from(j), 0.01 + 0.002 * f64::from(j)]).collect();
        let numbers = Numbers { axes, units };
        let mut normal = Normal::new(9);
        coupling.add_hessian(&stands, &numbers, 0.7, &mut normal);
        let change: Vec<[f64; 6]> = (0..9).map(|_| std::array::from_fn(|_| 1e-4 * random.normal())).collect();
        let moved: Vec<Stand> = stands.iter().enumerate().map(|(j, s)| numbers.moved(j, s, change[j])).collect();
        let unit: Vec<f64> = numbers.units.iter().map(|u| u[1]).collect();
        let mut gradient = vec![Twist::default(); 9];
        coupling.add(&moved, &unit, 0.7, &mut gradient);
        let expected = normal.times(&change);
        for (j, expected) in expected.iter().enumerate() {
            let found = scaled(gradient[j], axes, &numbers.units[j]);
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() <= 3e-4 * (1e-4 + expected.abs()), "{j}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn what_bends_a_little_holds_on_and_what_goes_its_own_way_does_not() {
        let bodies = Bodies { center: vec![DVec3::ZERO, DVec3::X], reach: vec![0.3; 2] };
        let weight = |way: f32| {
            let translation = vec![[0.0; 3], [-way, 0.0, 0.0], [0.0; 3], [way, 0.0, 0.0]];
            let motion = Motion { times: vec![0.0, 1.0], rotation: vec![[0.0; 3]; 4], translation };
            Coupling::new(&bodies, &motion).pairs[0].weight
        };
        let whole = weight(0.0);
        assert!(weight(0.1) > 0.5 * whole && weight(0.6) < 0.01 * whole, "{} {} {whole}", weight(0.1), weight(0.6));
    }

    #[test]
    fn what_moved_as_one_has_no_energy_however_it_stands() {
        let mut scene = moving_scene(400, 9, 6, 5, false);
        let motion = scene.deformation.table_mut().unwrap();
        // Every superpoint has the first one's pose: one rigid body.
        for k in 0..6 {
            for j in 1..9 {
                motion.rotation[9 * k + j] = motion.rotation[9 * k];
                motion.translation[9 * k + j] = motion.translation[9 * k];
            }
        }
        let (bodies, motion) = (Bodies::new(&scene), scene.deformation.table().unwrap());
        let coupling = Coupling::new(&bodies, motion);
        let mut stands = bodies.stands(&table_poses(motion, 0.7));
        assert!(energy(&coupling, &stands, &[0.01; 9]) < 1e-6);
        let turn = exp_quaternion(DVec3::new(0.5, -1.0, 0.3));
        stands.iter_mut().for_each(|s| *s = Stand { turn: turn * s.turn, place: turn * s.place + DVec3::ONE });
        assert!(energy(&coupling, &stands, &[0.01; 9]) < 1e-6, "turned as one");
        stands[4].place += DVec3::X * 0.1;
        assert!(energy(&coupling, &stands, &[0.01; 9]) > 1.0);
    }

    use crate::reference::exp_quaternion;
}
