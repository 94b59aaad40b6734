//! First parts: around Gaussians that are far from each other in their paths.

use glam::Vec3;
use rayon::prelude::*;

use super::parts::{FEATURE_TIMES, feature_times};
use super::tracks::Tracks;

/// Centres of a Gaussian at some times.
type Path = [Vec3; FEATURE_TIMES];

/// The paths of some Gaussians.
pub(super) fn paths(tracks: &Tracks, members: &[usize]) -> Vec<Path> {
    let times = feature_times(tracks.times);
    members.par_iter().map(|&i| times.map(|t| tracks.of(i)[t].center)).collect()
}

pub(super) fn distance(a: &Path, b: &Path) -> f32 {
    a.iter().zip(b).map(|(p, q)| p.distance_squared(*q)).sum()
}

/// These Gaussians by the nearest of at most `count` seeds, each of which is the farthest from those before (Gonzalez 1985): paths
/// are near when the sum of the squared distances at times spread over all is small.
pub(super) fn farthest_points(tracks: &Tracks, members: &[usize], count: usize) -> Vec<Vec<usize>> {
    let paths = paths(tracks, members);
    let mut nearest = vec![(f32::INFINITY, 0); paths.len()];
    // The Gaussian nearest to the mean path comes first.
    let Some(mut seed) = middle(&paths) else { return Vec::new() };
    let mut lists = 0;
    while lists < count {
        let center = paths[seed];
        nearest.par_iter_mut().zip(&paths).for_each(|(near, path)| {
            let d = distance(path, &center);
            if d < near.0 {
                *near = (d, lists);
            }
        });
        lists += 1;
        let farther = |a: (f32, usize), b: (f32, usize)| if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a };
        let far = nearest.par_iter().enumerate().map(|(i, near)| (near.0, i)).reduce(|| (-1.0, usize::MAX), farther);
        if far.0 <= 0.0 {
            break;
        }
        seed = far.1;
    }
    let mut parts = vec![Vec::new(); lists];
    nearest.iter().zip(members).for_each(|((_, j), i)| parts[*j].push(*i));
    parts
}

fn middle(paths: &[Path]) -> Option<usize> {
    let mut mean = [Vec3::ZERO; FEATURE_TIMES];
    for path in paths {
        mean.iter_mut().zip(path).for_each(|(m, p)| *m += *p / paths.len() as f32);
    }
    (0..paths.len()).min_by(|&a, &b| distance(&paths[a], &mean).total_cmp(&distance(&paths[b], &mean)))
}
