//! Where and when a scene is, for a host that places a camera or a time line.

use glam::{DQuat, DVec3};

use super::super::scene_buffers::SceneBuffers;
use crate::scene::{Gaussians, Motion, Rejected, Scene};

/// Most Gaussians that are looked at.
const MOST_LOOKED_AT: usize = 1 << 16;
/// Share of the centres that the ball holds.
const HELD: f64 = 0.9;

/// Where and when a scene is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// First and last time of its motion: of the key-time table that moves it; 0 and 1 where a network or a deformation field
    /// does, which are trained on that; both 0 when it stands still.
    pub times: [f64; 2],
    /// Centre of a ball that holds most of the scene: on each axis the median of the Gaussians' centres, world units. Of a scene
    /// that a table moves the centres at its first, middle and last key count; of others, those at rest.
    pub center: DVec3,
    /// Radius within which 90 % of those centres lie, world units; 0 without Gaussians. Of a large scene, 65,536 Gaussians at
    /// even steps of their index stand for all.
    pub radius: f64,
}

impl Extent {
    pub(super) fn of(scene: &Scene, buffers: &SceneBuffers) -> Self {
        let table = buffers.deformation.table();
        let (center, radius) = ball(centres(scene, table));
        Self { times: times(buffers, table), center, radius }
    }
}

fn times(buffers: &SceneBuffers, table: Option<&Motion>) -> [f64; 2] {
    match table.map(|t| (t.times.first(), t.times.last())) {
        Some((Some(first), Some(last))) => [f64::from(*first), f64::from(*last)],
        _ if buffers.deformation.source().is_some() => [0.0, 1.0],
        _ => [0.0, 0.0],
    }
}

/// Centres of valid Gaussians: at rest, or at three keys of a table.
fn centres(scene: &Scene, table: Option<&Motion>) -> Vec<DVec3> {
    let gaussians = &scene.gaussians;
    let rest: Vec<(usize, DVec3)> =
        looked_at(gaussians).map(|i| (i, DVec3::from(gaussians.mean[i].map(f64::from)))).collect();
    let (Some(motion), Some(superpoints)) = (table, scene.deformation.superpoint_deformation()) else {
        return rest.into_iter().map(|(_, p)| p).collect();
    };
    let m = motion.superpoint_count();
    let last = motion.times.len().saturating_sub(1);
    let moved = |key: usize| {
        rest.iter().filter_map(move |(i, p)| {
            let of = |list: &[[f32; 3]], j: usize| Some(DVec3::from(list.get(key * m + j)?.map(f64::from)));
            let by =
                |j: usize| Some(DQuat::from_scaled_axis(of(&motion.rotation, j)?) * *p + of(&motion.translation, j)?);
            superpoints.slots(*i).map(|(j, weight)| by(j).map(|p| weight * p)).sum::<Option<DVec3>>()
        })
    };
    [0, last / 2, last].into_iter().flat_map(moved).filter(|p| p.is_finite()).collect()
}

/// Valid Gaussians at even steps.
fn looked_at(gaussians: &Gaussians) -> impl Iterator<Item = usize> {
    let step = gaussians.len().div_ceil(MOST_LOOKED_AT).max(1);
    (0..gaussians.len()).step_by(step).filter(|i| gaussians.is_valid(*i, &mut Rejected::default()))
}

fn ball(centres: Vec<DVec3>) -> (DVec3, f64) {
    if centres.is_empty() {
        return (DVec3::ZERO, 0.0);
    }
    let quantile = |mut values: Vec<f64>, q: f64| {
        let rank = ((values.len() - 1) as f64 * q) as usize;
        *values.select_nth_unstable_by(rank, f64::total_cmp).1
    };
    let center =
        DVec3::from(std::array::from_fn::<f64, 3, _>(|a| quantile(centres.iter().map(|p| p[a]).collect(), 0.5)));
    (center, quantile(centres.iter().map(|p| p.distance(center)).collect(), HELD))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::scene::Blend;
    use crate::scene::synthetic::{moving_scene, random_scene};

    #[test]
    fn the_ball_holds_nine_tenths_of_the_centres() {
        let mut scene = random_scene(1000, 3, 0);
        scene.gaussians.mean[7] = [f32::NAN; 3];
        scene.gaussians.mean[8] = [1.0e6, 0.0, 0.0];
        let points = centres(&scene, None);
        assert_eq!(points.len(), 999);
        let (center, radius) = ball(points.clone());
        let inside = points.iter().filter(|p| p.distance(center) <= radius).count();
        assert!((899..=901).contains(&inside), "{inside}");
        assert!(radius < 1.0e3, "a stray Gaussian changes nothing: {radius}");
        assert_eq!(ball(Vec::new()), (DVec3::ZERO, 0.0));
    }

    #[test]
    fn a_table_moves_the_ball() {
        let scene = moving_scene(300, 4, 5, 3, false);
        let shift = 100.0;
        let mut motion = scene.deformation.table().unwrap().clone();
        motion.translation.iter_mut().for_each(|t| t[0] += shift);
        let (rest, _) = ball(centres(&scene, None));
        let (moved, radius) = ball(centres(&scene, Some(&motion)));
        assert!((moved.x - rest.x - f64::from(shift)).abs() < 5.0, "{rest} {moved}");
        assert!(radius > 0.0 && radius < 20.0, "{radius}");
    }

    #[test]
    fn soft_superpoints_move_the_ball_by_their_weights() {
        let mut scene = moving_scene(300, 4, 5, 3, false);
        let s = scene.deformation.superpoint_deformation_mut().unwrap();
        let blend = Blend { neighbors: 2, index: [0, 1].repeat(300), weight: [3.0, 1.0].repeat(300) };
        (s.superpoints.of_gaussian, s.blend) = (blend.of_gaussian(), Some(blend));
        let mut motion = s.table.clone().unwrap();
        motion.rotation.fill([0.0; 3]);
        motion.translation.fill([0.0; 3]);
        motion.translation.iter_mut().step_by(4).for_each(|t| t[0] = 100.0);
        let (rest, moved) = (centres(&scene, None), centres(&scene, Some(&motion)));
        let off = rest.iter().zip(&moved).map(|(a, b)| (*a + DVec3::X * 75.0 - *b).length()).fold(0.0, f64::max);
        assert!(off < 1e-9 && moved.len() == 3 * rest.len(), "{off}");
    }

    #[test]
    fn a_large_scene_is_looked_at_in_steps() {
        let scene = random_scene(3 * MOST_LOOKED_AT + 5, 3, 0);
        let looked_at = looked_at(&scene.gaussians).count();
        assert!(looked_at <= MOST_LOOKED_AT && looked_at > MOST_LOOKED_AT / 2, "{looked_at}");
    }
}
