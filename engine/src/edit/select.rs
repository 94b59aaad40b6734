//! Which Gaussians an edit is about: a mask `[N]`, made from what is asked for.

mod blocks;
mod flood;
mod grow;
mod pick;

use glam::DVec3;
use rayon::prelude::*;

use super::centers::{centers, centers_of};
use super::color::mean_color;
use crate::error::{Error, Result};
use crate::file::codec::sigmoid;
use crate::scene::{Camera, Scene};

pub use flood::{Likeness, similar};
pub use grow::grow;
pub use pick::{Depth, View, click, lasso, rectangle};

/// What Gaussians have in common.
#[derive(Debug, Clone, PartialEq)]
pub enum Criterion {
    /// Every one.
    All,
    /// Those that move with superpoints of these ranges, ends included; of soft ones the heaviest counts.
    Superpoints(Vec<[u64; 2]>),
    /// Those with numbers in these ranges, ends included.
    Gaussians(Vec<[u64; 2]>),
    /// Centres within a radius.
    Sphere(DVec3, f64),
    /// Centres between two corners.
    Box(DVec3, DVec3),
    /// An opacity, without lifespan, within a range.
    Opacity([f64; 2]),
    /// A largest standard deviation within a range, world units.
    Size([f64; 2]),
    /// A colour of band 0 within a distance of this one.
    Color(DVec3, f64),
    /// Centres closer to a camera than this.
    Floaters(f64),
}

/// The Gaussians that fit, `[N]`, where they are at `time`. `cameras` are those that floaters are near to.
///
/// # Errors
/// [`Error::Usage`] for numbers that are not there, for superpoints of a model without, and for floaters without cameras; those
/// of placing Gaussians.
pub fn select(scene: &Scene, criterion: &Criterion, time: f64, cameras: &[Camera]) -> Result<Vec<bool>> {
    let n = scene.gaussians.len();
    let by = |fits: &(dyn Fn(usize) -> bool + Sync)| -> Vec<bool> { (0..n).into_par_iter().map(fits).collect() };
    let placed = |fits: &(dyn Fn(DVec3) -> bool + Sync)| -> Result<Vec<bool>> {
        Ok(centers(scene, time)?.into_par_iter().map(fits).collect())
    };
    let g = &scene.gaussians;
    match criterion {
        Criterion::All => Ok(vec![true; n]),
        Criterion::Gaussians(ranges) => numbered(n, ranges, "gaussians"),
        Criterion::Superpoints(ranges) => {
            let Some(superpoints) = scene.deformation.superpoints() else {
                return Err(Error::usage("superpoints", "a model without superpoints", "one that has some"));
            };
            let chosen = numbered(superpoints.position.len(), ranges, "superpoints")?;
            Ok(by(&|i| chosen[superpoints.of_gaussian[i] as usize]))
        }
        Criterion::Sphere(center, radius) => placed(&|x| x.distance(*center) <= *radius),
        Criterion::Box(low, high) => placed(&|x| x.cmpge(*low).all() && x.cmple(*high).all()),
        Criterion::Opacity([low, high]) => Ok(by(&|i| (*low..=*high).contains(&sigmoid(g.opacity_logit[i])))),
        Criterion::Size([low, high]) => Ok(by(&|i| {
            let largest = g.log_scale[i].into_iter().fold(f32::NEG_INFINITY, f32::max);
            (*low..=*high).contains(&f64::from(largest).exp())
        })),
        Criterion::Color(color, distance) => Ok(by(&|i| mean_color(scene, i).distance(*color) <= *distance)),
        Criterion::Floaters(distance) if !cameras.is_empty() => {
            let near = |x: DVec3| cameras.iter().any(|c| c.position.distance(x) < *distance);
            placed(&near)
        }
        Criterion::Floaters(_) => Err(Error::usage("floaters", "no cameras", "the cameras of the data set (--data)")),
    }
}

/// Numbers below `count` that are in one of `ranges`.
fn numbered(count: usize, ranges: &[[u64; 2]], what: &str) -> Result<Vec<bool>> {
    let mut chosen = vec![false; count];
    for &[first, last] in ranges {
        if first > last || last >= count as u64 {
            return Err(Error::usage(
                what,
                format!("{first}-{last}"),
                format!("numbers below {count}, the lower first"),
            ));
        }
        chosen[first as usize..=last as usize].fill(true);
    }
    Ok(chosen)
}

/// Centre of the Gaussians of `mask` at `time`, world units; `None` of nothing.
///
/// # Errors
/// Those of placing Gaussians.
pub fn center(scene: &Scene, mask: &[bool], time: f64) -> Result<Option<DVec3>> {
    let selected: Vec<usize> = (0..mask.len()).filter(|&i| mask[i]).collect();
    let placed = centers_of(scene, selected, time)?;
    Ok((!placed.is_empty()).then(|| placed.iter().sum::<DVec3>() / placed.len() as f64))
}

/// The superpoint with which most Gaussians of `mask` move, the first of equals; `None` without superpoints.
pub fn main_superpoint(scene: &Scene, mask: &[bool]) -> Option<usize> {
    let mut counts = vec![0_usize; scene.deformation.superpoint_count()];
    let of = scene.deformation.superpoint_of_gaussian();
    of.iter().zip(mask).filter(|(_, m)| **m).for_each(|(&j, _)| counts[j as usize] += 1);
    let most = counts.iter().copied().max().filter(|most| *most > 0)?;
    counts.iter().position(|count| *count == most)
}

/// All Gaussians of the superpoints that those of `mask` move with; those of `mask` themselves without superpoints.
pub fn whole_superpoints(scene: &Scene, mask: &[bool]) -> Vec<bool> {
    let of = scene.deformation.superpoint_of_gaussian();
    if of.is_empty() {
        return mask.to_vec();
    }
    let mut chosen = vec![false; scene.deformation.superpoint_count()];
    of.iter().zip(mask).filter(|(_, m)| **m).for_each(|(&j, _)| chosen[j as usize] = true);
    of.iter().map(|&j| chosen[j as usize]).collect()
}
