//! How far the student is from its teacher.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::Serialize;

use super::sample::{Order, probes};
use super::tracks::Point;
use crate::error::Result;
use crate::reference::{Placed, place_scene};
use crate::scene::{Camera, MotionSource, Scene};
use crate::train::bake::Views;

/// The largest of some numbers, and what 99.9 % of them stay below.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Spread {
    /// The largest.
    pub largest: f64,
    /// 99.9 % are below.
    pub q999: f64,
}

impl Spread {
    /// Of `values`, by nearest rank; zeros when there are none.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_unstable_by(f64::total_cmp);
        let rank = (values.len() as f64 * 0.999).ceil() as usize;
        Self {
            largest: values.last().copied().unwrap_or_default(),
            q999: values.get(rank.max(1) - 1).copied().unwrap_or_default(),
        }
    }
}

/// The worst of each Gaussian.
#[derive(Debug)]
pub(super) struct Worst {
    /// `[N]` displacement of a probe on the cameras, pixels.
    pub(super) px: Vec<f64>,
    /// `[N]` angle between rotations, degrees.
    pub(super) degrees: Vec<f64>,
}

impl Worst {
    pub(super) fn new(gaussians: usize) -> Self {
        Self { px: vec![0.0; gaussians], degrees: vec![0.0; gaussians] }
    }

    /// Looks at the student at a time at which the teacher's probes are `point`; returns the largest displacement, pixels.
    pub(super) fn add(
        &mut self,
        student: &Scene,
        time: f64,
        order: &[Order],
        point: &(dyn Fn(usize) -> Point + Sync),
        views: &Views<Camera>,
    ) -> Result<f64> {
        let Placed { mean, rotation, .. } = place_scene(student, time, MotionSource::Auto)?;
        let all = self.px.par_iter_mut().zip(&mut self.degrees).enumerate();
        let of = |(i, (px, degrees)): (usize, (&mut f64, &mut f64))| {
            let teacher = point(i);
            let own = [0, 1].map(|k| rotation[i].col(order[i][k].into()));
            let theirs = teacher.axes.map(|a| a.as_dvec3());
            let lengths = theirs.map(DVec3::length);
            let one = probes(mean[i], [own[0] * lengths[0], own[1] * lengths[1]]);
            let two = probes(teacher.center.as_dvec3(), theirs);
            let displaced = one.into_iter().zip(two).map(|(a, b)| views.displacement(a, b)).fold(0.0, f64::max);
            *px = px.max(displaced);
            *degrees = degrees.max(angle(own, theirs).to_degrees());
            displaced
        };
        Ok(all.map(of).reduce(|| 0.0, f64::max))
    }
}

/// Angle between two frames, each given by two perpendicular axes.
fn angle(a: [DVec3; 2], b: [DVec3; 2]) -> f64 {
    let frame = |[x, y]: [DVec3; 2]| {
        let x = x.normalize_or(DVec3::X);
        let y = (y - x * x.dot(y)).normalize_or(x.any_orthonormal_vector());
        DMat3::from_cols(x, y, x.cross(y))
    };
    let turn = frame(a).transpose() * frame(b);
    // By the sine where the cosine cannot tell small angles.
    let skew = DVec3::new(turn.y_axis.z - turn.z_axis.y, turn.z_axis.x - turn.x_axis.z, turn.x_axis.y - turn.y_axis.x);
    let trace = turn.x_axis.x + turn.y_axis.y + turn.z_axis.z;
    (0.5 * skew.length()).atan2(0.5 * (trace - 1.0))
}

/// Adjusted Rand index of two divisions of the same things into numbered parts (Hubert and Arabie 1985): 1 where they are the
/// same, about 0 where they have nothing in common. Things that only one of the two has are left out.
pub fn adjusted_rand(a: &[u32], b: &[u32]) -> f64 {
    let size = |v: &[u32]| 1 + v.iter().copied().max().unwrap_or(0) as usize;
    let mut table = vec![vec![0_u64; size(b)]; size(a)];
    a.iter().zip(b).for_each(|(&x, &y)| table[x as usize][y as usize] += 1);
    let pairs = |n: u64| (n * n.saturating_sub(1) / 2) as f64;
    let both: f64 = table.iter().flatten().map(|&n| pairs(n)).sum();
    let rows: f64 = table.iter().map(|row| pairs(row.iter().sum())).sum();
    let columns: f64 = (0..size(b)).map(|y| pairs(table.iter().map(|row| row[y]).sum())).sum();
    let expected = rows * columns / pairs(a.len() as u64);
    let most = 0.5 * (rows + columns) - expected;
    // One part each, or each thing its own part, in both.
    if most == 0.0 { 1.0 } else { (both - expected) / most }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::exp;

    #[test]
    fn angles_are_those_of_the_turn() {
        for angle_in in [0.0, 1e-9, 0.3, 2.0, 3.1] {
            let turn = exp(DVec3::new(2.0, -1.0, 2.0) / 3.0 * angle_in);
            let (x, y) = (DVec3::new(0.6, 0.8, 0.0), DVec3::new(-0.8, 0.6, 0.0));
            let found = angle([x, y], [turn * x, turn * y * 3.0]);
            assert!((found - angle_in).abs() < 1e-9 + 1e-7 * angle_in, "{angle_in}: {found}");
        }
    }

    #[test]
    fn divisions_are_compared() {
        assert_eq!(adjusted_rand(&[0, 0, 1, 1], &[5, 5, 2, 2]), 1.0);
        // By hand: 1 pair in both, 2 and 1 in each, of 6: (1 − 1/3) / (3/2 − 1/3).
        assert!((adjusted_rand(&[0, 0, 1, 1], &[0, 0, 1, 2]) - 4.0 / 7.0).abs() < 1e-12);
        assert!(adjusted_rand(&[0, 0, 1, 1], &[0, 1, 0, 1]) < 0.0);
        assert_eq!([adjusted_rand(&[0; 3], &[1; 3]), adjusted_rand(&[0, 1], &[1, 0])], [1.0; 2]);
    }

    #[test]
    fn spreads_are_of_nearest_ranks() {
        let spread = Spread::of((1..=2000).rev().map(f64::from).collect());
        assert_eq!(spread, Spread { largest: 2000.0, q999: 1998.0 });
        assert_eq!(Spread::of(Vec::new()), Spread::default());
    }
}
