//! Superpoints as rigid bodies: where the Gaussians of each lie, how far they reach, where it stands.

use glam::{DQuat, DVec3};

use crate::edit::unwrapped;
use crate::reference::{Pose, exp_quaternion};
use crate::scene::Scene;

/// Reach of a superpoint that has no Gaussians, as a share of the scene's.
const EMPTY_REACH: f64 = 0.01;
/// Gaussians of an outline, and the least logit of their opacities.
const MOST_POINTS: usize = 2000;
const LEAST_LOGIT: f32 = -1.0;

/// The superpoints of a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bodies {
    /// `[M]` canonical centres: the mean of their Gaussians', by weight; where there are none, that of the model.
    pub center: Vec<DVec3>,
    /// `[M]` root mean square distance of what they move from the centre, world units; above 0.
    pub reach: Vec<f64>,
}

/// Where a superpoint stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stand {
    /// Turn from the canonical place; a unit quaternion.
    pub turn: DQuat,
    /// The centre, world space.
    pub place: DVec3,
}

impl Bodies {
    /// Of a scene with superpoints.
    pub fn new(scene: &Scene) -> Self {
        let Some(s) = scene.deformation.superpoint_deformation() else { return Self::default() };
        let (g, m) = (&scene.gaussians, s.superpoints.position.len());
        let mean = |i: usize| DVec3::from_array(g.mean[i].map(f64::from));
        let usable = |i: &usize| g.mean[*i].iter().chain(&g.log_scale[*i]).all(|v| v.is_finite());
        let mut sums = vec![(0.0, DVec3::ZERO); m];
        for i in (0..g.len()).filter(usable) {
            for (j, weight) in s.slots(i) {
                sums[j] = (sums[j].0 + weight, sums[j].1 + weight * mean(i));
            }
        }
        let own = s.superpoints.position.iter().map(|p| DVec3::from_array(p.map(f64::from)));
        let center: Vec<DVec3> =
            sums.iter().zip(own).map(|((w, sum), own)| if *w > 0.0 { *sum / *w } else { own }).collect();
        let mut squares = vec![0.0; m];
        for i in (0..g.len()).filter(usable) {
            let size: f64 = g.log_scale[i].iter().map(|&v| (2.0 * f64::from(v)).exp()).sum();
            for (j, weight) in s.slots(i) {
                squares[j] += weight * (mean(i).distance_squared(center[j]) + size);
            }
        }
        let all: f64 = squares.iter().sum::<f64>() / sums.iter().map(|s| s.0).sum::<f64>().max(1.0);
        let floor = (EMPTY_REACH * all.sqrt()).max(1e-9);
        let reach = squares.iter().zip(&sums).map(|(square, (w, _))| (square / w.max(1e-12)).sqrt().max(floor));
        Self { reach: reach.collect(), center }
    }

    /// Where the superpoints stand at these poses `[M]`.
    pub fn stands(&self, poses: &[Pose]) -> Vec<Stand> {
        let stand = |(center, pose): (&DVec3, &Pose)| {
            let turn = exp_quaternion(pose.rotation);
            Stand { turn, place: turn * *center + pose.translation }
        };
        self.center.iter().zip(poses).map(stand).collect()
    }

    /// The poses `[M]` of superpoints that stand so, with rotation vectors next to those of `near`.
    pub fn poses(&self, stands: &[Stand], near: &[Pose]) -> Vec<Pose> {
        stands.iter().zip(near).enumerate().map(|(j, (stand, near))| self.pose_of(j, stand, near)).collect()
    }

    /// The pose of one superpoint.
    pub(super) fn pose_of(&self, j: usize, stand: &Stand, near: &Pose) -> Pose {
        let rotation = unwrapped(stand.turn, near.rotation);
        Pose { rotation, translation: stand.place - stand.turn * self.center[j] }
    }
}

impl Stand {
    /// Turned by Exp(`turn`) about its own centre and moved by `shift`.
    #[must_use]
    pub fn moved(&self, turn: DVec3, shift: DVec3) -> Self {
        Self { turn: (exp_quaternion(turn) * self.turn).normalize(), place: self.place + shift }
    }

    /// Where this goes with another stand that has become `now`, as one rigid body.
    pub(super) fn carried(&self, other: &Self, now: &Self) -> Self {
        let turn = now.turn * other.turn.conjugate();
        Self { turn: (turn * self.turn).normalize(), place: now.place + turn * (self.place - other.place) }
    }

    /// The vector of the turn that leads to this stand from `other`, in the world.
    pub fn turn_from(&self, other: &Self) -> DVec3 {
        unwrapped(self.turn * other.turn.conjugate(), DVec3::ZERO)
    }
}

/// Centres of some Gaussians that can be seen, evenly spread over the list, with what moves them.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Outline {
    points: Vec<(DVec3, Vec<(usize, f64)>)>,
}

impl Outline {
    /// Of a scene with superpoints.
    pub(super) fn new(scene: &Scene) -> Self {
        let (g, Some(s)) = (&scene.gaussians, scene.deformation.superpoint_deformation()) else {
            return Self::default();
        };
        let finite = |i: &usize| g.mean[*i].iter().all(|v| v.is_finite());
        let mut all: Vec<usize> = (0..g.len()).filter(|&i| finite(&i) && g.opacity_logit[i] > LEAST_LOGIT).collect();
        if all.is_empty() {
            all = (0..g.len()).filter(finite).collect();
        }
        let count = all.len().min(MOST_POINTS);
        let point = |k: usize| {
            let i = all[k * all.len() / count];
            (DVec3::from_array(g.mean[i].map(f64::from)), s.slots(i).collect())
        };
        Self { points: (0..count).map(point).collect() }
    }

    /// Where they are at these poses `[M]`.
    pub(super) fn at(&self, poses: &[Pose]) -> Vec<DVec3> {
        let placed: Vec<_> = poses.iter().map(|p| (exp_quaternion(p.rotation), p.translation)).collect();
        let moved = |x: DVec3, j: usize| placed.get(j).map_or(x, |(turn, shift)| *turn * x + *shift);
        self.points.iter().map(|(x, slots)| slots.iter().map(|&(j, w)| w * moved(*x, j)).sum()).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::reference::table_poses;
    use crate::scene::synthetic::moving_scene;

    #[test]
    fn poses_and_stands_are_the_same_thing() {
        let scene = moving_scene(300, 7, 5, 3, false);
        let bodies = Bodies::new(&scene);
        let poses = table_poses(scene.deformation.table().unwrap(), 0.3);
        let again = bodies.poses(&bodies.stands(&poses), &poses);
        for (a, b) in poses.iter().zip(&again) {
            assert!(a.rotation.distance(b.rotation) < 1e-12 && a.translation.distance(b.translation) < 1e-12);
        }
        assert!(bodies.reach.iter().all(|r| *r > 0.0 && r.is_finite()));
        let stand = bodies.stands(&poses)[0];
        let turned = stand.moved(DVec3::new(0.1, 0.0, -0.2), DVec3::X);
        assert!(turned.turn_from(&stand).distance(DVec3::new(0.1, 0.0, -0.2)) < 1e-12);
        assert_eq!(turned.place, stand.place + DVec3::X);
    }

    #[test]
    fn what_is_carried_keeps_its_place_beside_what_carries_it() {
        let mut random = crate::scene::synthetic::Random::new(3);
        let mut any = || Stand { turn: random.rotation(), place: random.normal3() };
        let (stand, other, now) = (any(), any(), any());
        let carried = stand.carried(&other, &now);
        let beside = |a: &Stand, b: &Stand| (b.turn.conjugate() * (a.place - b.place), b.turn.conjugate() * a.turn);
        let ((way, turn), (way_now, turn_now)) = (beside(&stand, &other), beside(&carried, &now));
        assert!(way.distance(way_now) < 1e-12 && turn.dot(turn_now).abs() > 1.0 - 1e-12);
        assert!(stand.carried(&other, &other).place.distance(stand.place) < 1e-12);
    }
}
