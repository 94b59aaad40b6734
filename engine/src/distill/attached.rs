//! What is fixed to a part and was lost: a blade in a hand, the stick of a pendulum. It is thin, and fast at its far end: no disc shows
//! where it goes, and nothing of it stands long enough to be built up. But it goes with a part that the model has.
//!
//! In the frame of a part, what is fixed to it stands still: cells where most photos differ, wherever the part goes, belong to it. How a
//! small part turns is known badly, so that this holds near it only. From there the object grows cell by cell ([`Shape`]), and in turn
//! the part's poses are corrected so that its cells lie where photos differ ([`Path`]). Every fourth time is left out of all that: what
//! is found must lie where its photos differ, too.
//!
//! What goes with nothing that the model has grows in the same way: what is straight from the path of its pieces in the photos ([`rod`]), other
//! things from that of their discs ([`Residual::likely_paths`]). Of all that is found that is taken which explains most.

mod band;
mod chain;
mod look;
mod path;
mod rod;
mod segment;
mod shape;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use self::look::Look;
use self::path::Path;
use self::shape::{Cell, HAVE, Shape};
use super::rigid::Frame;
use crate::edit::unwrapped;
use crate::reference::{exp_quaternion, table_poses};
use crate::scene::{Gaussians, Motion, Scene, SuperpointDeformation, Superpoints};
use crate::train::bake::fewest_keys;
use crate::train::config::Config;
use crate::train::init::{MID_GREY, Point};
use crate::train::lost::residual::{Residual, like};
use crate::train::lost::{FEWEST, LostObject, by_chance, extent};
use crate::train::rng;

/// Fewest times that tell how something moves.
const FEWEST_TIMES: usize = 16;
/// One time of so many is left out, and judges.
const HELD: usize = 4;
/// Objects in a row that may have too few points to be one. Parts that are tried for one.
const MOST: usize = 8;
const TRIED: usize = 4;
/// A rod is looked for within so many times the radius within which so many of the Gaussians are.
const FARTHER: f64 = 1.8;
const MOST_WITHIN: f64 = 0.98;
/// Gaussians that count, and fewest of a part that does.
const VISIBLE_LOGIT: f32 = -2.2;
const FEWEST_OF_PART: usize = 5;
/// Cells around a part at which photos are looked at first: so far from its Gaussians, in steps of so many cells.
const AROUND: i32 = 4;
const STRIDE: i32 = 2;
/// Share of the photos that differ there, at least.
const FIRST_SHARE: f64 = 0.5;
/// Share of an object's cells that lie where a photo that was left out differs, on average over these; and how many times as many as
/// with the poses of another time, or it is a place where all photos differ.
const HELD_SHARE: f64 = 0.6;
const TIMES_CHANCE: f64 = 2.0;
/// What is fixed to a part is worth so many times as much: a path of its own that fits no better says less.
const FIXED: f64 = 1.25;
/// Pixels within which a cell lies where a photo differs: while the object grows, and at the end.
const GROWING: f32 = 2.0;
const GROWN: f32 = 1.0;
/// Rounds of growth; it ends where so many add nothing. Rounds at the end.
const MOST_ROUNDS: usize = 60;
const IDLE_ROUNDS: usize = 8;
const LAST_ROUNDS: usize = 6;
/// An object reaches at least this far, cells: less is an edge that is blurred.
const SHORTEST: f64 = 6.0;
/// Pixels around an object that it explains.
const EXPLAINED: f32 = 2.0;
/// Pixels by which key poses may be off the path, at the ends of the object.
const OFF_PATH: f64 = 0.25;
/// Standard deviation of its first Gaussians, cells.
const SIZE: f64 = 0.5;
/// A share of the photos' cells that lie where one differs: the photo shows the object.
const SHOWN: f64 = 0.5;
/// Stream of random numbers used here.
const STREAM: u32 = 0x4154_5443;

/// A place around which something may be.
#[derive(Debug, Clone, Copy)]
struct Pivot {
    /// What it moves with; `None`: with nothing that the model has.
    part: Option<usize>,
    /// In the part's frame.
    at: DVec3,
    /// Side of a cell, world units: a pixel.
    cell: f64,
    share: f64,
}

/// Where an object may be.
struct Guess {
    pivot: Pivot,
    path: Path,
}

struct Found {
    pivot: Pivot,
    shape: Shape,
    path: Path,
    /// Cells that lie where photos that were left out differ, beyond those that do so by chance.
    worth: f64,
}

/// The object that explains most of what is left, fixed to a part of a scene or on a path of its own, as a scene of one more part; it
/// is taken out of what is left. What is fixed to it is found once the scene has it.
pub(super) fn take_attached(residual: &mut Residual, scene: &Scene, config: &Config) -> Option<(LostObject, Scene)> {
    let table = scene.deformation.table().filter(|_| residual.times.len() >= FEWEST_TIMES)?;
    let frames = frames(table, &residual.times);
    let room = config.budget.max_gaussians.saturating_sub(scene.gaussians.len() as u32) as usize;
    for _ in 0..MOST {
        let looks: Vec<Look> = residual.differences.iter().map(Look::new).collect();
        let mut guesses = attached(scene, &frames, &looks);
        guesses.extend(free(residual, &looks, middle_and_radius(&scene.gaussians)));
        let found = best(guesses, &looks, &residual.times)?;
        for (difference, look) in residual.differences.iter_mut().zip(&looks) {
            let cells = found.cells(look.time);
            look.near(&cells, EXPLAINED).into_iter().for_each(|i| difference.left[i] = false);
        }
        let part = found.part(&looks, &residual.times, scene, room, config.seed);
        if part.is_some() {
            return part;
        }
    }
    None
}

/// Of what grows where something may be, what explains most.
fn best(guesses: Vec<Guess>, looks: &[Look], times: &[f32]) -> Option<Found> {
    let found: Vec<Found> = guesses.into_par_iter().filter_map(|guess| grown(guess, looks, times)).collect();
    let worth = |found: &Found| found.worth * if found.pivot.part.is_some() { FIXED } else { 1.0 };
    found.into_iter().max_by(|a, b| worth(a).total_cmp(&worth(b)))
}

/// With the likeliest parts.
fn attached(scene: &Scene, frames: &[Vec<Frame>], looks: &[Look]) -> Vec<Guess> {
    let of_pivot = |pivot: Pivot| Some(Guess { path: Path::of_part(frames, pivot.part?, pivot.at), pivot });
    pivots(scene, frames, looks).into_iter().take(TRIED).filter_map(of_pivot).collect()
}

/// By itself: rods, and what discs show.
fn free(residual: &Residual, looks: &[Look], extent: (DVec3, f64)) -> Vec<Guess> {
    let used: Vec<&Look> = looks.iter().filter(|look| !is_held(look.time)).collect();
    let unturned = |place: DVec3| Frame { turn: DMat3::IDENTITY, shift: place };
    let discs = residual.likely_paths(|time| !is_held(time));
    let discs = discs.into_iter().map(|places| places.into_iter().map(unturned).collect());
    let of_frames = |frames: Vec<Frame>| {
        let at = frames[0].shift;
        let path = Path::alone(frames);
        Some(Guess { pivot: Pivot { part: None, at, cell: path.pixel(looks)?, share: 0.0 }, path })
    };
    rod::rods(&used, &residual.times, extent).into_iter().chain(discs).filter_map(of_frames).collect()
}

/// `[times][M]` how the parts stand.
fn frames(table: &Motion, times: &[f32]) -> Vec<Vec<Frame>> {
    let of_time = |time: &f32| {
        let poses = table_poses(table, f64::from(*time));
        poses
            .iter()
            .map(|p| Frame { turn: DMat3::from_quat(exp_quaternion(p.rotation)), shift: p.translation })
            .collect()
    };
    times.iter().map(of_time).collect()
}

/// Of each part the place around it where most photos differ, the best first.
fn pivots(scene: &Scene, frames: &[Vec<Frame>], looks: &[Look]) -> Vec<Pivot> {
    let Some(moved) = scene.deformation.superpoint_deformation() else { return Vec::new() };
    let g = &scene.gaussians;
    let mut of_part: Vec<Vec<DVec3>> = vec![Vec::new(); moved.superpoints.position.len()];
    for (i, &part) in moved.superpoints.of_gaussian.iter().enumerate() {
        let mean = DVec3::from_array(g.mean[i].map(f64::from));
        if g.opacity_logit[i] > VISIBLE_LOGIT && mean.is_finite() {
            of_part[part as usize].push(mean);
        }
    }
    let pivot = |(part, points): (usize, &Vec<DVec3>)| {
        if points.len() < FEWEST_OF_PART {
            return None;
        }
        let path = Path::of_part(frames, part, points[0]);
        let cell = path.pixel(looks)?;
        let step = f64::from(STRIDE) * cell;
        let own: BTreeSet<Cell> = points.iter().map(|p| Cell::of((*p - points[0]) / step)).collect();
        let cells: BTreeSet<Cell> = own.into_iter().flat_map(|c| c.within(AROUND / STRIDE)).collect();
        let shares = cells.iter().map(|c| (path.share(c.middle() * step, looks, GROWING, HAVE), c));
        let (share, best) = shares.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (share >= FIRST_SHARE).then(|| Pivot { part: Some(part), at: points[0] + best.middle() * step, cell, share })
    };
    let mut found: Vec<Pivot> = of_part.par_iter().enumerate().filter_map(pivot).collect();
    found.sort_by(|a, b| b.share.total_cmp(&a.share).then(a.part.cmp(&b.part)));
    found
}

/// Whether photos of a time take no part in a search, and judge.
fn is_held(time: usize) -> bool {
    time % HELD == 1
}

/// What there is around a pivot that moves along a path; `None` where photos that were left out do not show it.
fn grown(Guess { pivot, mut path }: Guess, looks: &[Look], times: &[f32]) -> Option<Found> {
    let (held, used): (Vec<&Look>, Vec<&Look>) = looks.iter().partition(|look| is_held(look.time));
    let mut shape = Shape::at(pivot.cell);
    let (mut reach, mut idle) = (0.0, 0);
    for _ in 0..MOST_ROUNDS {
        shape.grow(&path, &used, GROWING)?;
        path.correct(&shape, &used, times);
        idle = if shape.reach() > reach + 0.5 { 0 } else { idle + 1 };
        reach = shape.reach().max(reach);
        if idle == IDLE_ROUNDS {
            break;
        }
    }
    for _ in 0..LAST_ROUNDS {
        shape.grow(&path, &used, GROWN)?;
        path.correct(&shape, &used, times);
    }
    let points = shape.points();
    let held_share = path.mean_share(&points, &held, GROWN, 0);
    let chance = by_chance(times.len(), |later| path.mean_share(&points, &held, GROWN, later));
    if held_share < HELD_SHARE.max(TIMES_CHANCE * chance) || shape.reach() < SHORTEST {
        return None;
    }
    let worth = (held_share - chance) * points.len() as f64;
    let all: Vec<&Look> = looks.iter().collect();
    for _ in 0..LAST_ROUNDS {
        shape.grow(&path, &all, GROWN)?;
        path.correct(&shape, &all, times);
    }
    shape.thin(&path, &all);
    Some(Found { pivot, shape, path, worth })
}

/// Where most of the Gaussians are.
fn middle_and_radius(g: &Gaussians) -> (DVec3, f64) {
    let seen = (0..g.len()).filter(|&i| g.opacity_logit[i] > VISIBLE_LOGIT);
    let means: Vec<DVec3> =
        seen.map(|i| DVec3::from_array(g.mean[i].map(f64::from))).filter(|m| m.is_finite()).collect();
    let quantile = |of: &dyn Fn(&DVec3) -> f64, share: f64| {
        let mut values: Vec<f64> = means.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values.get((share * values.len() as f64) as usize).copied().unwrap_or(0.0)
    };
    let middle = DVec3::new(quantile(&|m| m.x, 0.5), quantile(&|m| m.y, 0.5), quantile(&|m| m.z, 0.5));
    (middle, FARTHER * quantile(&|m| m.distance(middle), MOST_WITHIN))
}

impl Found {
    /// Where its cells are at a time.
    fn cells(&self, time: usize) -> Vec<DVec3> {
        self.shape.points().iter().map(|p| self.path.place(time, *p)).collect()
    }

    /// A scene of it alone.
    fn part(
        &self,
        looks: &[Look],
        times: &[f32],
        beside: &Scene,
        room: usize,
        seed: u64,
    ) -> Option<(LostObject, Scene)> {
        let cells = self.shape.points();
        let each = FEWEST.div_ceil(cells.len());
        let jitter = |i: usize, axis: usize| rng::uniform(seed, STREAM, (3 * i + axis) as u64) - 0.5;
        let beside_cell = |i: usize| self.pivot.cell * DVec3::new(jitter(i, 0), jitter(i, 1), jitter(i, 2));
        let place = |i: usize| cells[i / each] + if each > 1 { beside_cell(i) } else { DVec3::ZERO };
        let points: Vec<DVec3> = (0..cells.len() * each).map(place).take(room).collect();
        if points.len() < FEWEST {
            return None;
        }
        let point = |p: &DVec3| {
            let position = (self.pivot.at + *p).as_vec3().to_array();
            Point { position, color: self.path.colour(*p, looks).unwrap_or(MID_GREY) }
        };
        let colored: Vec<Point> = points.par_iter().map(point).collect();
        let superpoints =
            Superpoints { position: vec![self.pivot.at.as_vec3().to_array()], of_gaussian: vec![0; points.len()] };
        let deformation = SuperpointDeformation::of_table(superpoints, self.table(times)).into();
        let seen = looks.iter().filter_map(|look| self.path.share_of(&cells, look, GROWN, 0)).filter(|s| *s >= SHOWN);
        let middle = cells.iter().sum::<DVec3>() / cells.len() as f64;
        let places: Vec<DVec3> = (0..times.len()).map(|time| self.path.place(time, middle)).collect();
        let object = LostObject {
            seen: seen.count(),
            photos: looks.len(),
            radius: 0.5 * extent(&cells),
            path: extent(&places),
            gaussians: points.len(),
            attached_to: self.pivot.part,
        };
        let mut gaussians = like(&colored, &beside.gaussians);
        gaussians.log_scale.fill([(SIZE * self.pivot.cell).ln() as f32; 3]);
        Some((object, Scene { gaussians, deformation, ..Scene::default() }))
    }

    /// The fewest key poses between which it stays within [`OFF_PATH`] of its path.
    fn table(&self, times: &[f32]) -> Motion {
        let mut before = DVec3::ZERO;
        let pose = |time: usize| {
            let turn = self.path.turn(time);
            before = unwrapped(turn, before);
            (before, self.path.place(time, DVec3::ZERO) - turn * self.pivot.at)
        };
        let poses: Vec<(DVec3, DVec3)> = (0..times.len()).map(pose).collect();
        let farthest = self.shape.farthest();
        let moved = |(r, shift): (DVec3, DVec3), p: DVec3| exp_quaternion(r) * (self.pivot.at + p) + shift;
        let distance = |a: usize, b: usize, i: usize| {
            let share = f64::from(times[i] - times[a]) / f64::from(times[b] - times[a]);
            let between = (poses[a].0.lerp(poses[b].0, share), poses[a].1.lerp(poses[b].1, share));
            farthest.iter().map(|p| moved(between, *p).distance(moved(poses[i], *p))).fold(0.0, f64::max)
        };
        let off = OFF_PATH * self.pivot.cell;
        let keys = fewest_keys(times.len() - 1, |a, b| (a + 1..b).all(|i| distance(a, b, i) <= off));
        Motion {
            times: keys.iter().map(|&k| times[k]).collect(),
            rotation: keys.iter().map(|&k| poses[k].0.as_vec3().to_array()).collect(),
            translation: keys.iter().map(|&k| poses[k].1.as_vec3().to_array()).collect(),
        }
    }
}
