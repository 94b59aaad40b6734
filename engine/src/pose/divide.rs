//! More superpoints, so that what was rigid in training can bend.

use glam::{DMat3, DVec3};

use crate::edit::{copy_superpoints, movable};
use crate::error::{Error, Result};
use crate::file::codec::sigmoid;
use crate::scene::{Gaussians, Scene};

/// Steps of the power iteration that finds a longest axis.
const STEPS: usize = 30;

/// Divides superpoints in two until there are `count`, each time the one whose surface is spread most: its area times the mean
/// squared distance from its centre (what k-means makes small, by bisection). A cut goes through the centre, across the longest
/// axis. Both halves move as the whole did, so images stay as they are. A scene that has as many already stays as it is.
///
/// # Errors
/// [`Error::Usage`] for soft superpoints, and for motion without a key-time table.
pub fn divide(scene: &mut Scene, count: usize) -> Result<()> {
    if scene.deformation.superpoint_count() >= count {
        return Ok(());
    }
    movable(scene, "a division of superpoints")?;
    let areas: Vec<f64> = (0..scene.gaussians.len()).map(|i| area(&scene.gaussians, i)).collect();
    let (g, Some(s)) = (&scene.gaussians, scene.deformation.superpoint_deformation_mut()) else {
        return Err(Error::usage("model", "one that stands still", "superpoints with a key-time table"));
    };
    if s.blend.is_some() {
        return Err(Error::usage(
            "division of superpoints",
            "soft superpoints, which bend",
            "one superpoint per Gaussian",
        ));
    }
    let m = s.superpoints.position.len();
    let mut pieces: Vec<Piece> = (0..m).map(Piece::of).collect();
    for (i, &j) in s.superpoints.of_gaussian.iter().enumerate().filter(|(i, _)| areas[*i] > 0.0) {
        pieces[j as usize].gaussians.push(i);
    }
    pieces.iter_mut().for_each(|p| p.measure(g, &areas));
    while pieces.len() < count {
        let widest = pieces.iter_mut().max_by(|a, b| a.spread.total_cmp(&b.spread));
        let Some(half) = widest.and_then(|p| p.cut(g, &areas)) else { break };
        pieces.push(half);
    }
    let copied: Vec<usize> = pieces[m..].iter().map(|p| p.origin).collect();
    copy_superpoints(s, &copied);
    for (j, piece) in pieces.iter().enumerate().skip(m) {
        s.superpoints.position[j] = piece.center.as_vec3().to_array();
        piece.gaussians.iter().for_each(|&i| s.superpoints.of_gaussian[i] = j as u32);
    }
    Ok(())
}

/// Part of a superpoint.
#[derive(Debug, Clone, Default)]
struct Piece {
    /// Whose pose it has.
    origin: usize,
    /// Those that can be seen.
    gaussians: Vec<usize>,
    center: DVec3,
    /// Area times mean squared distance from the centre.
    spread: f64,
    covariance: DMat3,
}

impl Piece {
    fn of(origin: usize) -> Self {
        Self { origin, ..Self::default() }
    }

    fn measure(&mut self, g: &Gaussians, areas: &[f64]) {
        let all = || self.gaussians.iter().map(|&i| (areas[i], mean(g, i)));
        let whole: f64 = all().map(|(area, _)| area).sum();
        if whole == 0.0 {
            return;
        }
        self.center = all().map(|(area, x)| area * x).sum::<DVec3>() / whole;
        self.covariance = all().fold(DMat3::ZERO, |sum, (area, x)| {
            let from = x - self.center;
            sum + area * DMat3::from_cols(from * from.x, from * from.y, from * from.z)
        });
        self.spread = (0..3).map(|k| self.covariance.col(k)[k]).sum();
    }

    /// Takes a half of it away; `None` where all lies at one point.
    fn cut(&mut self, g: &Gaussians, areas: &[f64]) -> Option<Self> {
        let axis = longest_axis(&self.covariance)?;
        let is_beyond = |&i: &usize| (mean(g, i) - self.center).dot(axis) > 0.0;
        let (beyond, rest): (Vec<usize>, Vec<usize>) = self.gaussians.iter().partition(|i| is_beyond(i));
        if beyond.is_empty() || rest.is_empty() {
            return None;
        }
        let [mut half, mut rest] = [beyond, rest].map(|gaussians| Self { gaussians, ..Self::of(self.origin) });
        [&mut half, &mut rest].into_iter().for_each(|p| p.measure(g, areas));
        *self = rest;
        Some(half)
    }
}

/// The direction in which a covariance is largest; `None` of nothing.
fn longest_axis(covariance: &DMat3) -> Option<DVec3> {
    let widest = (0..3).map(|k| covariance.col(k)).max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))?;
    let mut axis = widest.try_normalize()?;
    for _ in 0..STEPS {
        axis = (*covariance * axis).try_normalize()?;
    }
    Some(axis)
}

/// What a Gaussian covers, seen from the side where it is largest; 0 for one that is not finite.
fn area(g: &Gaussians, i: usize) -> f64 {
    let [a, b, c] = g.log_scale[i].map(f64::from);
    let covered = (a + b + c - a.min(b).min(c)).exp() * sigmoid(g.opacity_logit[i]);
    if covered.is_finite() && mean(g, i).is_finite() { covered } else { 0.0 }
}

fn mean(g: &Gaussians, i: usize) -> DVec3 {
    DVec3::from_array(g.mean[i].map(f64::from))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::reference::{ReferenceOptions, render};
    use crate::scene::Camera;
    use crate::scene::synthetic::{moving_scene, random_blend, random_scene};

    #[test]
    fn halves_move_as_the_whole_did() {
        let scene = moving_scene(400, 5, 6, 3, false);
        let mut divided = scene.clone();
        divide(&mut divided, 40).unwrap();
        assert_eq!(divided.deformation.superpoint_count(), 40);
        divided.deformation.check(400).unwrap();
        let (before, after) = (scene.deformation.superpoints().unwrap(), divided.deformation.superpoints().unwrap());
        let mut members = vec![0; 40];
        for (i, &j) in after.of_gaussian.iter().enumerate() {
            members[j as usize] += 1;
            assert!(j >= 5 || before.of_gaussian[i] == j);
        }
        assert!(members.iter().all(|&n| n > 0), "{members:?}");
        let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, [40, 30]);
        for time in [0.0, 0.37, 1.0] {
            let [a, b] = [&scene, &divided].map(|s| render(s, &camera, time, &ReferenceOptions::default()).unwrap());
            assert_eq!(a, b);
        }
        let again = divided.clone();
        divide(&mut divided, 40).unwrap();
        assert_eq!(divided, again);
    }

    #[test]
    fn a_rod_is_cut_across_and_a_point_is_not() {
        let mut scene = moving_scene(400, 1, 6, 0, false);
        let g = &mut scene.gaussians;
        g.log_scale.fill([-4.0; 3]);
        g.opacity_logit.fill(2.0);
        (0..400).for_each(|i| g.mean[i] = [0.0, 0.01 * (i % 7) as f32, 0.02 * i as f32]);
        let mut rod = scene.clone();
        divide(&mut rod, 8).unwrap();
        let of = &rod.deformation.superpoints().unwrap().of_gaussian;
        let mut seen = vec![0; 8];
        of.iter().for_each(|&j| seen[j as usize] += 1);
        assert!(seen.iter().all(|n| (49..=51).contains(n)), "{seen:?}");
        // One after the other along the rod.
        assert_eq!(of.windows(2).filter(|w| w[0] != w[1]).count(), 7);
        scene.gaussians.mean.fill([1.0; 3]);
        divide(&mut scene, 8).unwrap();
        assert_eq!(scene.deformation.superpoint_count(), 1);
        assert!(divide(&mut random_scene(20, 1, 0), 8).is_err());
        let mut soft = moving_scene(40, 4, 5, 0, false);
        soft.deformation.superpoint_deformation_mut().unwrap().blend = Some(random_blend(40, 4, 3, 5));
        assert!(divide(&mut soft, 8).is_err());
    }
}
