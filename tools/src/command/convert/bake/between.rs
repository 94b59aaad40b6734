//! How far a table is from the networks that it was made of, at times between those that it was made at.

use engine::error::Result;
use engine::reference::{freeze, rotation_of_quaternion};
use engine::scene::{Camera, Gaussians, MotionSource, Scene};
use engine::train::bake::Views;
use glam::DVec3;
use indicatif::ProgressBar;

use crate::command::convert::moment::Moments;

/// Times that are looked at.
const CHECKED_TIMES: usize = 16;

/// Where the networks have all Gaussians at some times between the candidates.
pub(super) struct Between {
    moments: Vec<Moment>,
}

/// All Gaussians at a time.
struct Moment {
    time: f64,
    mean: Vec<[f32; 3]>,
    rotation: Vec<[f32; 4]>,
}

impl Between {
    /// In the middle between two candidates, 16 times or as many as there are.
    pub(super) fn of(moving: &Moments<'_>, candidates: &[f32], bar: &ProgressBar) -> Result<Self> {
        let step = candidates.len().saturating_sub(1).div_ceil(CHECKED_TIMES).max(1);
        let middle = |pair: &[f32]| 0.5 * (f64::from(pair[0]) + f64::from(pair[1]));
        let at = |time: f64| {
            bar.inc(1);
            moving.at(time).map(|g| Moment { time, mean: g.mean, rotation: g.rotation })
        };
        let moments = candidates.windows(2).step_by(step).map(middle).map(at).collect::<Result<_>>()?;
        Ok(Self { moments })
    }

    /// Largest displacement in the views by the table of `scene`, pixels: of the centres, and of the points two standard
    /// deviations along the longest axes.
    pub(super) fn error_px(&self, scene: &Scene, views: &Views<Camera>) -> Result<f64> {
        let mut worst: f64 = 0.0;
        for Moment { time, mean, rotation } in &self.moments {
            let table = freeze(scene, *time, MotionSource::Auto)?;
            let of_gaussian = |i: usize| {
                let ends = points(&table, i, table.mean[i], table.rotation[i]);
                let pairs = ends.into_iter().zip(points(&table, i, mean[i], rotation[i]));
                pairs.map(|(a, b)| views.displacement(a, b)).filter(|d| d.is_finite()).fold(0.0, f64::max)
            };
            worst = (0..table.len()).map(of_gaussian).fold(worst, f64::max);
        }
        Ok(worst)
    }
}

/// The centre of Gaussian `i` and the end of its longest axis, two standard deviations away, placed so.
fn points(g: &Gaussians, i: usize, mean: [f32; 3], rotation: [f32; 4]) -> [DVec3; 2] {
    let log_scale = g.log_scale[i];
    let longest = (0..3).max_by(|&a, &b| log_scale[a].total_cmp(&log_scale[b])).unwrap_or(0);
    let axis = rotation_of_quaternion(rotation.map(f64::from)).col(longest);
    let mean = DVec3::from_array(mean.map(f64::from));
    [mean, mean + axis * (2.0 * f64::from(log_scale[longest]).exp())]
}
