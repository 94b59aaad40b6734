//! Baking a trained motion: the fewest key times, superpoints that never move left out.
//!
//! Input is the motion at many candidate times (network F evaluated there). The table keeps a subset of them, chosen
//! greedily: from each key the farthest next one such that linear interpolation of (r, τ) in between moves no Gaussian by
//! more than the tolerance on any camera. What is measured is the centre of each Gaussian and the point two standard
//! deviations along its longest axis, in pixels, on the cameras in whose image it falls. A point that falls in none is no
//! still point: whether it moves is measured as a camera turned to it would see it ([`Views`]).

mod distance;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::reference::{exp, rotation_of_quaternion};
use crate::scene::{Camera, Deformation, Gaussians, Motion, SuperpointDeformation, Superpoints};

pub use distance::Views;

/// How many cameras see each candidate time beside those that were taken at it.
const OTHER_CAMERAS: usize = 4;
/// Points per Gaussian: its centre, and two standard deviations along its longest axis.
const POINTS: usize = 2;

/// A baked motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Baked {
    /// The superpoints that are left, with their table; or nothing moves.
    pub deformation: Deformation,
    /// For each superpoint before, the index it has now; those that never move share one.
    pub kept: Vec<u32>,
    /// Superpoints that never move (their pose is applied to their Gaussians).
    pub still: usize,
    /// Largest error on the cameras, pixels.
    pub error_px: f64,
    /// Gaussians that no camera sees at any candidate time.
    pub unseen: usize,
}

/// A Gaussian's measured points, world space, canonical.
struct Probe {
    superpoint: usize,
    points: [DVec3; POINTS],
}

struct Baker<'a> {
    motion: &'a Motion,
    count: usize,
    probes: Vec<Probe>,
    /// Cameras to look through at each candidate time.
    views: Vec<Views<&'a Camera>>,
}

/// Bakes `motion` (given at all candidate times). With `merge_still`, Gaussians of superpoints that never move get their
/// constant pose applied and share one superpoint, or have no motion at all when nothing moves.
///
/// # Errors
/// [`Error::Usage`] when the arrays do not fit together, and without cameras.
pub fn bake(
    gaussians: &mut Gaussians,
    superpoints: &Superpoints,
    motion: &Motion,
    views: &Views<Camera>,
    tolerance_px: f64,
    merge_still: bool,
) -> Result<Baked> {
    let count = motion.superpoint_count();
    if views.cameras.is_empty() {
        return Err(Error::usage("motion to bake", "no camera", "one or more: without, nothing seems to move"));
    }
    if superpoints.of_gaussian.len() != gaussians.len()
        || superpoints.of_gaussian.iter().any(|&j| j as usize >= count)
        || superpoints.position.len() != count
    {
        let found =
            format!("{} superpoints, {} assignments", superpoints.position.len(), superpoints.of_gaussian.len());
        return Err(Error::usage(
            "motion to bake",
            found,
            format!("{count} superpoints, {} Gaussians", gaussians.len()),
        ));
    }
    let baker = Baker::new(gaussians, superpoints, motion, views);
    let moving = if merge_still { baker.moving(tolerance_px) } else { vec![true; count] };
    let still = moving.iter().filter(|m| !**m).count();
    let unseen = baker.unseen();
    apply_constant_pose(gaussians, superpoints, motion, &moving);
    let kept = new_indices(&moving);
    if still == count {
        let error_px = baker.still_error(&moving);
        return Ok(Baked { deformation: Deformation::None, kept, still, error_px, unseen });
    }
    let keys = baker.keys(&moving, tolerance_px);
    let error_px = baker.error_of(&keys, &moving).max(baker.still_error(&moving));
    let (motion, superpoints) = reduced(superpoints, motion, &keys, &moving, &kept);
    let deformation = SuperpointDeformation::of_table(superpoints, motion).into();
    Ok(Baked { deformation, kept, still, error_px, unseen })
}

impl<'a> Baker<'a> {
    fn new(g: &Gaussians, superpoints: &Superpoints, motion: &'a Motion, views: &'a Views<Camera>) -> Self {
        let probe = |i: usize| {
            let mean = promote(g.mean[i]);
            let log_scale = g.log_scale[i];
            let longest = (0..3).max_by(|&a, &b| log_scale[a].total_cmp(&log_scale[b])).unwrap_or(0);
            let axis = rotation_of_quaternion(g.rotation[i].map(f64::from)).col(longest);
            let end = mean + axis * (2.0 * f64::from(log_scale[longest]).exp());
            Probe { superpoint: superpoints.of_gaussian[i] as usize, points: [mean, end] }
        };
        let probes = (0..g.len()).map(probe).filter(|p| p.points.iter().all(|x| x.is_finite())).collect();
        let at = |(k, &t): (usize, &f32)| Views {
            cameras: cameras_at(&views.cameras, &motion.times, k, f64::from(t)),
            near: views.near,
            everywhere: views.everywhere,
        };
        let views = motion.times.iter().enumerate().map(at).collect();
        Self { motion, count: motion.superpoint_count(), probes, views }
    }

    fn pose(&self, k: usize, j: usize) -> (DVec3, DVec3) {
        let at = k * self.count + j;
        (promote(self.motion.rotation[at]), promote(self.motion.translation[at]))
    }

    /// Rotation matrices and translations of all superpoints at candidate `k`.
    fn exact(&self, k: usize) -> Vec<(DMat3, DVec3)> {
        (0..self.count).map(|j| self.pose(k, j)).map(|(r, t)| (exp(r), t)).collect()
    }

    /// The same at candidate `k`, interpolated between candidates `a` and `b`, as play-back will.
    fn interpolated(&self, a: usize, b: usize, k: usize) -> Vec<(DMat3, DVec3)> {
        let time = |i: usize| f64::from(self.motion.times[i]);
        let w = if a == b { 0.0 } else { (time(k) - time(a)) / (time(b) - time(a)) };
        let between = |j: usize| {
            let ((r0, t0), (r1, t1)) = (self.pose(a, j), self.pose(b, j));
            (exp(r0 * (1.0 - w) + r1 * w), t0 * (1.0 - w) + t1 * w)
        };
        (0..self.count).map(between).collect()
    }

    /// Largest distance on the cameras of candidate `k`, pixels, of points moved by either poses; stops looking once it is
    /// above `enough`.
    fn distance(&self, k: usize, one: &[(DMat3, DVec3)], two: &[(DMat3, DVec3)], count: &[bool], enough: f64) -> f64 {
        let of_probe = |p: &Probe| {
            if !count[p.superpoint] {
                return 0.0;
            }
            let ((m1, t1), (m2, t2)) = (one[p.superpoint], two[p.superpoint]);
            let distances = p.points.iter().map(|&x| {
                let (x1, x2) = (m1 * x + t1, m2 * x + t2);
                self.views[k].displacement(x1, x2)
            });
            distances.fold(0.0, f64::max)
        };
        let chunks = self.probes.par_chunks(1024);
        let largest = chunks.map(|list| list.iter().map(of_probe).fold(0.0, f64::max));
        // A violation ends the search; otherwise the exact maximum is wanted.
        largest
            .map(|d| if d > enough { Err(d) } else { Ok(d) })
            .try_reduce(|| 0.0, |a, b| Ok(a.max(b)))
            .unwrap_or_else(|d| d)
    }

    /// Whether each superpoint ever moves from its pose at the first candidate by more than the tolerance.
    fn moving(&self, tolerance: f64) -> Vec<bool> {
        let first = self.exact(0);
        let mut moving = vec![false; self.count];
        for k in 1..self.motion.times.len() {
            let now = self.exact(k);
            let moves = |p: &&Probe| {
                let ((m1, t1), (m2, t2)) = (first[p.superpoint], now[p.superpoint]);
                p.points.iter().any(|&x| self.views[k].movement(m1 * x + t1, m2 * x + t2) > tolerance)
            };
            let resting = self.probes.par_iter().filter(|p| !moving[p.superpoint]);
            let found: Vec<usize> = resting.filter(moves).map(|p| p.superpoint).collect();
            found.into_iter().for_each(|j| moving[j] = true);
        }
        moving
    }

    /// How many Gaussians no camera sees at any candidate.
    fn unseen(&self) -> usize {
        let mut unseen: Vec<&Probe> = self.probes.iter().collect();
        for (k, views) in self.views.iter().enumerate() {
            if unseen.is_empty() {
                break;
            }
            let now = self.exact(k);
            let is_unseen = |p: &&Probe| {
                let (turn, shift) = now[p.superpoint];
                !p.points.iter().any(|&x| views.see(turn * x + shift))
            };
            unseen = unseen.into_par_iter().filter(is_unseen).collect();
        }
        unseen.len()
    }

    /// Error of holding the superpoints that are not moving at their first pose.
    fn still_error(&self, moving: &[bool]) -> f64 {
        let still: Vec<bool> = moving.iter().map(|m| !m).collect();
        let first = self.exact(0);
        (1..self.motion.times.len())
            .map(|k| self.distance(k, &first, &self.exact(k), &still, f64::INFINITY))
            .fold(0.0, f64::max)
    }

    fn interval_error(&self, a: usize, b: usize, moving: &[bool], enough: f64) -> f64 {
        let mut worst: f64 = 0.0;
        for k in a + 1..b {
            worst = worst.max(self.distance(k, &self.interpolated(a, b, k), &self.exact(k), moving, enough));
            if worst > enough {
                break;
            }
        }
        worst
    }

    /// Greedy choice of keys among the candidates.
    fn keys(&self, moving: &[bool], tolerance: f64) -> Vec<usize> {
        let last = self.motion.times.len() - 1;
        let mut keys = vec![0];
        let mut a = 0;
        while a < last {
            // Gallop while it fits, then bisect between the last that fits and the first that does not.
            let fits = |b: usize| self.interval_error(a, b, moving, tolerance) <= tolerance;
            let (mut good, mut step) = (a + 1, 1);
            let mut bad = last + 1;
            while good < last {
                let next = (good + step).min(last);
                if fits(next) {
                    good = next;
                    step *= 2;
                } else {
                    bad = next;
                    break;
                }
            }
            while bad <= last && bad - good > 1 {
                let middle = good.midpoint(bad);
                if fits(middle) { good = middle } else { bad = middle }
            }
            keys.push(good);
            a = good;
        }
        keys
    }

    fn error_of(&self, keys: &[usize], moving: &[bool]) -> f64 {
        keys.windows(2).map(|w| self.interval_error(w[0], w[1], moving, f64::INFINITY)).fold(0.0, f64::max)
    }
}

/// The cameras whose time is nearest to candidate `k`, and a few others spread over the set.
fn cameras_at<'a>(cameras: &'a [Camera], times: &[f32], k: usize, time: f64) -> Vec<&'a Camera> {
    let nearest = |t: f64| {
        let distance = |i: &usize| (f64::from(times[*i]) - t).abs();
        (0..times.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))
    };
    let mut chosen: Vec<&Camera> = cameras.iter().filter(|c| nearest(c.time) == Some(k)).collect();
    let n = cameras.len();
    let step = (n / OTHER_CAMERAS).max(1);
    // Which others differs from time to time, so that together they cover the set.
    let offset = ((time.abs() * 7919.0) as usize).wrapping_add(k) % step;
    chosen.extend(cameras.iter().skip(offset).step_by(step));
    chosen
}

/// Applies the first candidate's pose to the Gaussians of superpoints that never move.
fn apply_constant_pose(g: &mut Gaussians, superpoints: &Superpoints, motion: &Motion, moving: &[bool]) {
    for (i, &j) in superpoints.of_gaussian.iter().enumerate() {
        let j = j as usize;
        let (r, t) = (promote(motion.rotation[j]), promote(motion.translation[j]));
        if moving[j] || (r == DVec3::ZERO && t == DVec3::ZERO) {
            continue;
        }
        let turn = exp(r);
        g.mean[i] = (turn * promote(g.mean[i]) + t).as_vec3().to_array();
        let [w, x, y, z] = g.rotation[i].map(f64::from);
        let q = glam::DQuat::from_mat3(&turn) * glam::DQuat::from_xyzw(x, y, z, w);
        g.rotation[i] = [q.w as f32, q.x as f32, q.y as f32, q.z as f32];
    }
}

/// Moving superpoints keep their order; all others become the one after them.
fn new_indices(moving: &[bool]) -> Vec<u32> {
    let rest = moving.iter().filter(|m| **m).count() as u32;
    let mut next = 0;
    let index = |m: &bool| {
        if *m {
            next += 1;
            next - 1
        } else {
            rest
        }
    };
    moving.iter().map(index).collect()
}

fn reduced(
    superpoints: &Superpoints,
    motion: &Motion,
    keys: &[usize],
    moving: &[bool],
    kept: &[u32],
) -> (Motion, Superpoints) {
    let count = moving.len();
    let any_still = moving.iter().any(|m| !m);
    let pick = |table: &[[f32; 3]]| -> Vec<[f32; 3]> {
        let row = |k: &usize| {
            let values = moving.iter().enumerate().filter(|(_, m)| **m).map(|(j, _)| table[*k * count + j]);
            let mut row: Vec<[f32; 3]> = values.collect();
            row.extend(any_still.then_some([0.0; 3]));
            row
        };
        keys.iter().flat_map(row).collect()
    };
    let times = keys.iter().map(|&k| motion.times[k]).collect();
    let mut position: Vec<[f32; 3]> =
        superpoints.position.iter().zip(moving).filter(|(_, m)| **m).map(|(p, _)| *p).collect();
    let still = superpoints.position.iter().zip(moving).filter(|(_, m)| !**m).map(|(p, _)| promote(*p));
    if any_still {
        let centre = still.sum::<DVec3>() / moving.iter().filter(|m| !**m).count() as f64;
        position.push(centre.as_vec3().to_array());
    }
    let of_gaussian = superpoints.of_gaussian.iter().map(|&j| kept[j as usize]).collect();
    let motion = Motion { times, rotation: pick(&motion.rotation), translation: pick(&motion.translation) };
    (motion, Superpoints { of_gaussian, position })
}

fn promote(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;
    use crate::scene::synthetic::random_scene;

    fn cameras() -> Vec<Camera> {
        let at = |i: usize| {
            let a = i as f64;
            let eye = DVec3::new(4.0 * a.cos(), 1.0, 4.0 * a.sin());
            Camera { time: a / 10.0, ..Camera::look_at(eye, DVec3::ZERO, DVec3::Y, 0.9, [400, 300]) }
        };
        (0..11).map(at).collect()
    }

    fn views() -> Views<Camera> {
        Views { cameras: cameras(), near: 0.2, everywhere: false }
    }

    /// Superpoint 0 never moves (but has a pose), 1 moves linearly, 2 bends at t = 0.5.
    fn scene() -> (Gaussians, Superpoints, Motion) {
        let g = random_scene(60, 5, 0).gaussians;
        let of_gaussian = (0..60).map(|i| i % 3).collect();
        let superpoints = Superpoints { of_gaussian, position: vec![[0.0; 3], [1.0; 3], [2.0; 3]] };
        let times: Vec<f32> = (0..=20).map(|k| k as f32 / 20.0).collect();
        let rotation = times.iter().flat_map(|&t| [[0.0, 0.3, 0.0], [0.0; 3], [0.0, 0.0, (t - 0.5).abs()]]).collect();
        let translation = times.iter().flat_map(|&t| [[0.1, 0.0, 0.0], [t, 0.0, 0.0], [0.0; 3]]).collect();
        (g, superpoints, Motion { times, rotation, translation })
    }

    #[test]
    fn a_bend_needs_one_more_key_and_a_still_superpoint_none() {
        let (mut g, s, m) = scene();
        let before = g.clone();
        let baked = bake(&mut g, &s, &m, &views(), 0.1, true).unwrap();
        let motion = baked.deformation.table().unwrap();
        assert_eq!(motion.times, [0.0, 0.5, 1.0]);
        assert_eq!((baked.still, baked.kept), (1, vec![2, 0, 1]));
        assert_eq!(motion.rotation[2], [0.0; 3], "the still superpoint's Gaussians carry its pose");
        assert!(baked.error_px < 1e-3, "{}", baked.error_px);
        let expected = exp(DVec3::new(0.0, 0.3, 0.0)) * promote(before.mean[0]) + DVec3::new(0.1, 0.0, 0.0);
        assert!((promote(g.mean[0]) - expected).length() < 1e-6);
        assert_eq!(g.mean[1], before.mean[1]);
    }

    #[test]
    fn a_looser_tolerance_needs_fewer_keys_and_is_kept() {
        let (g, s, mut m) = scene();
        for (k, t) in m.times.iter().enumerate() {
            m.translation[3 * k + 1] = [(6.0 * t).sin() * 0.2, 0.0, 0.0];
        }
        let mut last = usize::MAX;
        for tolerance in [0.01, 0.3, 3.0] {
            let baked = bake(&mut g.clone(), &s, &m, &views(), tolerance, true).unwrap();
            let keys = baked.deformation.key_times().len();
            assert!(baked.error_px <= tolerance, "{} > {tolerance}", baked.error_px);
            assert!(keys <= last && keys >= 3, "{keys} keys at {tolerance} px");
            last = keys;
        }
        assert!(last < 10);
    }

    #[test]
    fn what_never_moves_has_no_motion() {
        let (mut g, s, mut m) = scene();
        m.rotation.iter_mut().for_each(|r| *r = [0.2, 0.0, 0.0]);
        m.translation.iter_mut().for_each(|t| *t = [0.0; 3]);
        let baked = bake(&mut g, &s, &m, &views(), 0.1, true).unwrap();
        assert_eq!((baked.deformation, baked.still), (Deformation::None, 3));
    }

    #[test]
    fn what_no_view_sees_keeps_its_motion() {
        let (g, s, m) = scene();
        // All cameras behind the near plane, or turned away.
        let turned = |c: Camera| Camera::look_at(c.position, 2.0 * c.position, DVec3::Y, 0.9, [400, 300]);
        let away: Vec<Camera> = cameras().into_iter().map(|c| Camera { time: c.time, ..turned(c) }).collect();
        for (cameras, near) in [(cameras(), 100.0), (away, 0.2)] {
            let seen = bake(&mut g.clone(), &s, &m, &views(), 0.1, true).unwrap();
            assert_eq!(seen.unseen, 0);
            let only = Views { cameras: cameras.clone(), near, everywhere: false };
            let baked = bake(&mut g.clone(), &s, &m, &only, 0.1, true).unwrap();
            assert_eq!((baked.unseen, baked.still, &baked.kept), (60, 1, &seen.kept));
            // The bend counts where everything does.
            let all = Views { everywhere: true, ..only };
            let baked = bake(&mut g.clone(), &s, &m, &all, 0.1, true).unwrap();
            assert_eq!(baked.deformation.key_times(), [0.0, 0.5, 1.0]);
        }
        let none = Views { cameras: Vec::new(), near: 0.2, everywhere: true };
        assert!(bake(&mut g.clone(), &s, &m, &none, 0.1, true).unwrap_err().to_string().contains("no camera"));
    }

    #[test]
    fn what_comes_from_behind_the_camera_moves() {
        let (mut g, mut s, mut m) = scene();
        (s.of_gaussian, m.rotation) = (vec![0; 60], vec![[0.0; 3]; m.rotation.len()]);
        let one = Camera::look_at(DVec3::new(0.0, 0.0, 9.0), DVec3::ZERO, DVec3::Y, 0.9, [400, 300]);
        let z = |k: usize| if k == 0 { 20.0 } else { 0.0 };
        m.translation = (0..m.times.len()).flat_map(|k| [[0.0, 0.0, z(k)]; 3]).collect();
        let views = Views { cameras: vec![one], near: 0.2, everywhere: false };
        let baked = bake(&mut g, &s, &m, &views, 0.1, true).unwrap();
        assert_eq!((baked.still, baked.kept[0], baked.unseen), (2, 0, 0));
    }
}
