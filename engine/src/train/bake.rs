//! Baking a trained motion: the fewest key times, superpoints that never move left out.
//!
//! Input is the motion at many candidate times (network F evaluated there). The table keeps a subset of them, chosen
//! greedily: from each key the farthest next one such that linear interpolation of (r, τ) in between moves no Gaussian by
//! more than the tolerance on any camera. What is measured is the centre of each Gaussian and the point two standard
//! deviations along its longest axis, in pixels, on the cameras in whose image it falls. A point that falls in none is no
//! still point: whether it moves is measured as a camera turned to it would see it ([`Views`]).
//!
//! With soft superpoints the points are where the poses of all slots take them. A Gaussian rests when no superpoint that it
//! moves with ever moves one of its own; a superpoint stays when a Gaussian that does not rest moves with it. The weights
//! are rounded to bytes first, where that alone moves nothing by more than [`ROUNDING_SHARE`] of the tolerance; the table
//! gets the rest of it.

mod distance;
mod probe;
mod reduce;

use glam::DVec3;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::scene::{Blend, Camera, Deformation, Gaussians, Motion, Superpoints};
use probe::{Placing, Probe};
use reduce::Left;

pub use distance::Views;

/// How many cameras see each candidate time beside those that were taken at it.
const OTHER_CAMERAS: usize = 4;
/// Share of the tolerance that rounding the weights of soft superpoints to bytes may take.
pub const ROUNDING_SHARE: f64 = 0.25;

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
    /// Of soft superpoints whose weights were rounded to bytes: what that alone moves at most, pixels; part of `error_px`.
    pub rounding_px: Option<f64>,
    /// Gaussians that no camera sees at any candidate time.
    pub unseen: usize,
}

struct Baker<'a> {
    motion: &'a Motion,
    count: usize,
    probes: Vec<Probe>,
    /// Cameras to look through at each candidate time.
    views: Vec<Views<&'a Camera>>,
}

/// Bakes `motion` (given at all candidate times) of `superpoints`, soft ones with `blend`. With `merge_still`, Gaussians of
/// superpoints that never move get their constant pose applied and share one superpoint, or have no motion at all when
/// nothing moves.
///
/// # Errors
/// [`Error::Usage`] when the arrays do not fit together, and without cameras.
pub fn bake(
    gaussians: &mut Gaussians,
    superpoints: &Superpoints,
    blend: Option<&Blend>,
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
    blend.map_or(Ok(()), |blend| blend.check_shapes(gaussians.len(), count))?;
    let mut baker = Baker::new(gaussians, superpoints, blend, motion, views);
    let rounded = blend.map(Blend::quantized);
    let rounding_px = rounded.as_ref().and_then(|rounded| baker.round(superpoints, rounded, tolerance_px));
    let blend = if rounding_px.is_some() { rounded.as_ref() } else { blend };
    let tolerance = tolerance_px - rounding_px.unwrap_or(0.0);
    let moving = if merge_still { baker.moving(tolerance) } else { vec![true; count] };
    baker.probes.iter_mut().for_each(|p| p.rest(&moving));
    let unseen = baker.unseen();
    let left = Left::new(superpoints, blend, &moving, gaussians.len());
    left.apply_constant_pose(gaussians, superpoints, blend, motion);
    let still = left.stays.iter().filter(|stays| !**stays).count();
    let still_error = baker.still_error();
    let baked = |deformation, error_px: f64| {
        let error_px = error_px + rounding_px.unwrap_or(0.0);
        Baked { deformation, kept: left.index.clone(), still, error_px, rounding_px, unseen }
    };
    if still == count {
        return Ok(baked(Deformation::None, still_error));
    }
    let keys = baker.keys(tolerance);
    let error_px = baker.error_of(&keys).max(still_error);
    let deformation = left.deformation(superpoints, blend, motion, &keys);
    Ok(baked(deformation.into(), error_px))
}

impl<'a> Baker<'a> {
    fn new(
        g: &Gaussians,
        superpoints: &Superpoints,
        blend: Option<&Blend>,
        motion: &'a Motion,
        views: &'a Views<Camera>,
    ) -> Self {
        let probe = |i: usize| Probe::new(g, i, superpoints.slots(blend, i));
        let probes = (0..g.len()).map(probe).filter(Probe::is_finite).collect();
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

    /// Poses of all superpoints at candidate `k`.
    fn exact(&self, k: usize) -> Vec<Placing> {
        (0..self.count).map(|j| self.pose(k, j)).map(|(r, t)| Placing::new(r, t)).collect()
    }

    /// The same at candidate `k`, interpolated between candidates `a` and `b`, as play-back will.
    fn interpolated(&self, a: usize, b: usize, k: usize) -> Vec<Placing> {
        let time = |i: usize| f64::from(self.motion.times[i]);
        let w = if a == b { 0.0 } else { (time(k) - time(a)) / (time(b) - time(a)) };
        let between = |j: usize| {
            let ((r0, t0), (r1, t1)) = (self.pose(a, j), self.pose(b, j));
            Placing::new(r0 * (1.0 - w) + r1 * w, t0 * (1.0 - w) + t1 * w)
        };
        (0..self.count).map(between).collect()
    }

    /// Takes the weights of `rounded`, if they move nothing by more than their share of the tolerance; then how much.
    fn round(&mut self, superpoints: &Superpoints, rounded: &Blend, tolerance: f64) -> Option<f64> {
        let most = ROUNDING_SHARE * tolerance;
        let again: Vec<Probe> =
            self.probes.iter().map(|p| p.with(superpoints.slots(Some(rounded), p.gaussian))).collect();
        let mut worst: f64 = 0.0;
        for k in 0..self.motion.times.len() {
            let now = self.exact(k);
            let apart = |(p, q): (&Probe, &Probe)| self.apart(k, p.placed(&now), q.placed(&now));
            worst = worst.max(self.probes.par_iter().zip(&again).map(apart).reduce(|| 0.0, f64::max));
            if worst > most {
                return None;
            }
        }
        self.probes = again;
        Some(worst)
    }

    /// Largest distance on the cameras of candidate `k` between points, pixels.
    fn apart(&self, k: usize, one: [DVec3; 2], two: [DVec3; 2]) -> f64 {
        one.into_iter().zip(two).map(|(a, b)| self.views[k].displacement(a, b)).fold(0.0, f64::max)
    }

    /// Largest distance on the cameras of candidate `k`, pixels, of points moved by either poses: of the Gaussians that rest, or
    /// of the others. Stops looking once it is above `enough`.
    fn distance(&self, k: usize, one: &[Placing], two: &[Placing], rest: bool, enough: f64) -> f64 {
        let of_probe = |p: &Probe| if p.rests == rest { self.apart(k, p.placed(one), p.placed(two)) } else { 0.0 };
        let chunks = self.probes.par_chunks(1024);
        let largest = chunks.map(|list| list.iter().map(of_probe).fold(0.0, f64::max));
        // A violation ends the search; otherwise the exact maximum is wanted.
        largest
            .map(|d| if d > enough { Err(d) } else { Ok(d) })
            .try_reduce(|| 0.0, |a, b| Ok(a.max(b)))
            .unwrap_or_else(|d| d)
    }

    /// Whether each superpoint by itself ever moves one of its Gaussians, from where it is at the first candidate, by more than
    /// the tolerance; or several together do.
    fn moving(&self, tolerance: f64) -> Vec<bool> {
        let first = self.exact(0);
        let mut moving = vec![false; self.count];
        let moves = |k: usize, one: [DVec3; 2], two: [DVec3; 2]| {
            one.into_iter().zip(two).any(|(a, b)| self.views[k].movement(a, b) > tolerance)
        };
        for k in 1..self.motion.times.len() {
            let now = self.exact(k);
            let found = |p: &Probe| -> Vec<usize> {
                let resting = p.slots().map(|(j, _)| j).filter(|&j| !moving[j]);
                resting.filter(|&j| moves(k, p.placed_by(&first[j]), p.placed_by(&now[j]))).collect()
            };
            let found: Vec<usize> = self.probes.par_iter().flat_map_iter(found).collect();
            found.into_iter().for_each(|j| moving[j] = true);
        }
        for k in (1..self.motion.times.len()).filter(|_| self.probes.iter().any(Probe::is_soft)) {
            let now = self.exact(k);
            let resting = self.probes.par_iter().filter(|p| p.is_soft() && p.slots().all(|(j, _)| !moving[j]));
            let found: Vec<&Probe> = resting.filter(|p| moves(k, p.placed(&first), p.placed(&now))).collect();
            found.into_iter().flat_map(Probe::slots).for_each(|(j, _)| moving[j] = true);
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
            let is_unseen = |p: &&Probe| !p.placed(&now).into_iter().any(|x| views.see(x));
            unseen = unseen.into_par_iter().filter(is_unseen).collect();
        }
        unseen.len()
    }

    /// Error of holding the Gaussians that rest at their first place.
    fn still_error(&self) -> f64 {
        let first = self.exact(0);
        (1..self.motion.times.len())
            .map(|k| self.distance(k, &first, &self.exact(k), true, f64::INFINITY))
            .fold(0.0, f64::max)
    }

    fn interval_error(&self, a: usize, b: usize, enough: f64) -> f64 {
        let mut worst: f64 = 0.0;
        for k in a + 1..b {
            worst = worst.max(self.distance(k, &self.interpolated(a, b, k), &self.exact(k), false, enough));
            if worst > enough {
                break;
            }
        }
        worst
    }

    /// Greedy choice of keys among the candidates.
    fn keys(&self, tolerance: f64) -> Vec<usize> {
        let last = self.motion.times.len() - 1;
        fewest_keys(last, |a, b| self.interval_error(a, b, tolerance) <= tolerance)
    }

    fn error_of(&self, keys: &[usize]) -> f64 {
        keys.windows(2).map(|w| self.interval_error(w[0], w[1], f64::INFINITY)).fold(0.0, f64::max)
    }
}

/// Greedy choice of keys among candidates 0 to `last`: from each the farthest next one for which `fits` says that nothing in
/// between is off by too much. Neighbours always fit.
pub(crate) fn fewest_keys(last: usize, fits: impl Fn(usize, usize) -> bool) -> Vec<usize> {
    let mut keys = vec![0];
    let mut a = 0;
    while a < last {
        // Gallop while it fits, then bisect between the last that fits and the first that does not.
        let (mut good, mut step) = (a + 1, 1);
        let mut bad = last + 1;
        while good < last {
            let next = (good + step).min(last);
            if fits(a, next) {
                good = next;
                step *= 2;
            } else {
                bad = next;
                break;
            }
        }
        while bad <= last && bad - good > 1 {
            let middle = good.midpoint(bad);
            if fits(a, middle) { good = middle } else { bad = middle }
        }
        keys.push(good);
        a = good;
    }
    keys
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

fn promote(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;
    use crate::reference::{exp, place_scene};
    use crate::scene::synthetic::random_scene;
    use crate::scene::{MotionSource, Scene, SuperpointDeformation};

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
        let baked = bake(&mut g, &s, None, &m, &views(), 0.1, true).unwrap();
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
            let baked = bake(&mut g.clone(), &s, None, &m, &views(), tolerance, true).unwrap();
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
        let baked = bake(&mut g, &s, None, &m, &views(), 0.1, true).unwrap();
        assert_eq!((baked.deformation, baked.still), (Deformation::None, 3));
    }

    #[test]
    fn what_no_view_sees_keeps_its_motion() {
        let (g, s, m) = scene();
        // All cameras behind the near plane, or turned away.
        let turned = |c: Camera| Camera::look_at(c.position, 2.0 * c.position, DVec3::Y, 0.9, [400, 300]);
        let away: Vec<Camera> = cameras().into_iter().map(|c| Camera { time: c.time, ..turned(c) }).collect();
        for (cameras, near) in [(cameras(), 100.0), (away, 0.2)] {
            let seen = bake(&mut g.clone(), &s, None, &m, &views(), 0.1, true).unwrap();
            assert_eq!(seen.unseen, 0);
            let only = Views { cameras: cameras.clone(), near, everywhere: false };
            let baked = bake(&mut g.clone(), &s, None, &m, &only, 0.1, true).unwrap();
            assert_eq!((baked.unseen, baked.still, &baked.kept), (60, 1, &seen.kept));
            // The bend counts where everything does.
            let all = Views { everywhere: true, ..only };
            let baked = bake(&mut g.clone(), &s, None, &m, &all, 0.1, true).unwrap();
            assert_eq!(baked.deformation.key_times(), [0.0, 0.5, 1.0]);
        }
        let none = Views { cameras: Vec::new(), near: 0.2, everywhere: true };
        assert!(bake(&mut g.clone(), &s, None, &m, &none, 0.1, true).unwrap_err().to_string().contains("no camera"));
    }

    #[test]
    fn what_comes_from_behind_the_camera_moves() {
        let (mut g, mut s, mut m) = scene();
        (s.of_gaussian, m.rotation) = (vec![0; 60], vec![[0.0; 3]; m.rotation.len()]);
        let one = Camera::look_at(DVec3::new(0.0, 0.0, 9.0), DVec3::ZERO, DVec3::Y, 0.9, [400, 300]);
        let z = |k: usize| if k == 0 { 20.0 } else { 0.0 };
        m.translation = (0..m.times.len()).flat_map(|k| [[0.0, 0.0, z(k)]; 3]).collect();
        let views = Views { cameras: vec![one], near: 0.2, everywhere: false };
        let baked = bake(&mut g, &s, None, &m, &views, 0.1, true).unwrap();
        assert_eq!((baked.still, baked.kept[0], baked.unseen), (2, 0, 0));
    }

    /// Gaussians 0, 3, … between superpoints 0, which rests, and 1; 1, 4, … with 0 alone; 2, 5, … between 1 and 2.
    fn blend() -> Blend {
        let index = (0..60).flat_map(|i| [[0, 1], [0, 2], [1, 2]][i % 3]).collect();
        let weight = (0..60).flat_map(|i| [[0.21, 0.29], [1.0, 0.0], [0.613, 0.387]][i % 3]).collect();
        Blend { neighbors: 2, index, weight }
    }

    /// Largest distance in the views between all Gaussians as trained and as baked, at the candidates, pixels.
    fn apart(before: &Scene, after: &Scene, views: &Views<Camera>) -> f64 {
        let times = before.deformation.key_times().to_vec();
        let of_time = |&t: &f32| {
            let [a, b] = [before, after].map(|s| place_scene(s, f64::from(t), MotionSource::Auto).unwrap().mean);
            a.into_iter().zip(b).map(|(a, b)| views.displacement(a, b)).fold(0.0, f64::max)
        };
        times.iter().map(of_time).fold(0.0, f64::max)
    }

    #[test]
    fn the_bound_holds_where_soft_superpoints_take_gaussians() {
        let (gaussians, mut s, m) = scene();
        s.of_gaussian = blend().of_gaussian();
        let trained =
            SuperpointDeformation { blend: Some(blend()), ..SuperpointDeformation::of_table(s.clone(), m.clone()) };
        let before = Scene { gaussians: gaussians.clone(), deformation: trained.into(), ..Scene::default() };
        for (tolerance, bytes) in [(0.01, false), (2.0, true)] {
            let mut g = gaussians.clone();
            let baked = bake(&mut g, &s, Some(&blend()), &m, &views(), tolerance, true).unwrap();
            assert_eq!(baked.rounding_px.is_some(), bytes, "{:?}", baked.rounding_px);
            let after = Scene { gaussians: g, deformation: baked.deformation, ..Scene::default() };
            after.deformation.check(60).unwrap();
            let left = after.deformation.blend().unwrap();
            assert_eq!(left.levels().is_some(), bytes);
            // Superpoint 0 rests, but takes part in what moves; Gaussians that move with it alone rest by themselves.
            assert_eq!((baked.still, baked.kept, after.deformation.superpoint_count()), (0, vec![0, 1, 2], 4));
            assert_eq!((left.row(1).1, left.heaviest(1), left.heaviest(0)), (&[1.0, 0.0][..], Some(3), Some(1)));
            let found = apart(&before, &after, &views());
            assert!(found <= baked.error_px + 1e-3 && baked.error_px <= tolerance, "{found} {}", baked.error_px);
        }
    }

    #[test]
    fn superpoints_without_a_weight_go_and_with_them_the_blend() {
        let (mut g, s, m) = scene();
        let blend = Blend { neighbors: 2, index: [2, 1].repeat(60), weight: [0.0, 0.5].repeat(60) };
        let baked = bake(&mut g, &s, Some(&blend), &m, &views(), 0.1, true).unwrap();
        assert_eq!((baked.still, baked.kept), (2, vec![1, 0, 1]));
        let left = baked.deformation.superpoint_deformation().unwrap();
        assert_eq!((&left.blend, &left.superpoints.of_gaussian), (&None, &vec![0; 60]));
        let short = Blend { neighbors: 2, ..Blend::of_one(&[0; 60]) };
        let message = bake(&mut g, &s, Some(&short), &m, &views(), 0.1, true).unwrap_err().to_string();
        assert!(message.contains("superpoints.blend_index"), "{message}");
    }
}
