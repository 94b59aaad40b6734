//! The path of a rod that nothing holds: what is straight, thin, and always of one length, wherever it goes and turns.
//!
//! A straight piece of a photo ([`Segment`]) is the rod at some depth, and with the rod's length that depth says how it slants, but for one
//! sign. Of all poses of all photos those are chosen that one smooth motion has ([`smoothest`]), past photos that show something else.

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::band::Band;
use super::chain::{Chosen, Pose, depths, smoothest};
use super::look::Look;
use super::segment::{Segment, segments};
use crate::distill::rigid::Frame;
use crate::edit::outer;
use crate::scene::Camera;

/// Lengths that are tried, times that of the photos' longer pieces.
const LENGTHS: [f64; 4] = [0.7, 0.85, 1.0, 1.2];
const LONGER: f64 = 0.9;
/// Slants that are tried of a piece that is cut off.
const SLANTS: usize = 12;
/// A piece may be longer than the rod at its depth by this share of the length, at a cost.
const LONGER_BY: f64 = 0.06;
const TOO_LONG: f64 = 0.5;
/// Share of the photos that must show it.
const SEEN: f64 = 0.4;
/// What is known of its ends: across the line of sight, px; along it and beyond a cut, lengths. By how much speeds change, lengths.
const ACROSS: f64 = 1.5;
const ALONG: f64 = 0.15;
const SMOOTH: f64 = 0.04;
/// Rounds of weighing ends anew.
const ROUNDS: usize = 5;

/// Motions of the likeliest rods at each of these times, the best first: the middle, and turns of its way. `extent`: the middle and radius of
/// the scene.
pub(super) fn rods(looks: &[&Look], times: &[f32], extent: (DVec3, f64)) -> Vec<Vec<Frame>> {
    let mut in_order: Vec<&Look> = looks.to_vec();
    in_order.sort_by_key(|look| look.time);
    in_order.dedup_by_key(|look| look.time);
    let pieces: Vec<Vec<Segment>> = in_order.par_iter().map(|look| segments(&look.differs(), look.size())).collect();
    let Some(length) = usual_length(&in_order, &pieces, extent.0) else { return Vec::new() };
    let motion = |share: &f64| {
        let length = share * length;
        let poses: Vec<Vec<Pose>> =
            in_order.iter().zip(&pieces).map(|(look, pieces)| poses(&look.camera, pieces, length, extent)).collect();
        let at: Vec<f64> = in_order.iter().map(|look| look.time as f64).collect();
        let Chosen { cost, poses: chosen } = smoothest(&poses, &at, length)?;
        let enough = chosen.len() as f64 >= SEEN * in_order.len() as f64;
        let seen: Vec<(&Look, Pose)> = chosen.into_iter().map(|(i, pose)| (in_order[i], poses[i][pose])).collect();
        enough.then(|| Some((cost, frames(&seen, times.len(), length)?)))?
    };
    let mut found: Vec<(f64, Vec<Frame>)> = LENGTHS.par_iter().filter_map(motion).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, frames)| frames).collect()
}

/// World units of the longer pieces, as far off as the middle of the scene.
fn usual_length(looks: &[&Look], pieces: &[Vec<Segment>], middle: DVec3) -> Option<f64> {
    let longest = |(look, pieces): (&&Look, &Vec<Segment>)| {
        let px = pieces.iter().map(Segment::length).reduce(f64::max)?;
        Some(px * look.camera.position.distance(middle) / look.camera.fx)
    };
    let mut lengths: Vec<f64> = looks.iter().zip(pieces).filter_map(longest).collect();
    lengths.sort_by(f64::total_cmp);
    lengths.get((LONGER * lengths.len() as f64) as usize).copied()
}

/// Direction of the line of sight through a place of the image, of length 1.
fn ray(camera: &Camera, at: glam::DVec2) -> DVec3 {
    let ahead = DVec3::new((at.x - camera.cx) / camera.fx, (at.y - camera.cy) / camera.fy, 1.0);
    (camera.rotation.transpose() * ahead).normalize()
}

/// All poses of a rod of this length that look like one of these pieces, either way round.
fn poses(camera: &Camera, pieces: &[Segment], length: f64, extent: (DVec3, f64)) -> Vec<Pose> {
    let depths = depths(camera.position, extent, length);
    let mut found = Vec::new();
    for piece in pieces.iter().filter(|p| p.cut != [true; 2]) {
        let rays = piece.ends.map(|end| ray(camera, end));
        for first in [0, 1] {
            let [a, b] = [first, 1 - first].map(|k| rays[k]);
            let shown = [first, 1 - first].map(|k| !piece.cut[k]);
            match shown {
                [true, true] => {
                    depths.clone().for_each(|depth| found.extend(slants(camera.position, [a, b], depth, length)))
                }
                [true, false] => {
                    found.extend(depths.clone().step_by(2).flat_map(|z| beyond(camera.position, [a, b], z, length)))
                }
                // The other way round.
                _ => found.extend(depths.clone().step_by(2).flat_map(|z| {
                    let turned = beyond(camera.position, [b, a], z, length);
                    turned.map(|p| Pose { ends: [p.ends[1], p.ends[0]], shown: [false, true], ..p })
                })),
            }
        }
    }
    found
}

/// With its first end at a depth: the second one lies on the other line of sight, nearer or farther; a little beside it where that passes too
/// far off.
fn slants(eye: DVec3, [a, b]: [DVec3; 2], depth: f64, length: f64) -> impl Iterator<Item = Pose> {
    let first = eye + depth * a;
    let along = (first - eye).dot(b);
    let foot = eye + along * b;
    let aside = foot.distance(first);
    let reach = (length * length - aside * aside).max(0.0).sqrt();
    let pose = |second: DVec3, cost: f64| Pose { ends: [first, second], shown: [true; 2], cost };
    let both = if aside <= length {
        [along - reach, along + reach].map(|depth| (depth > 0.0).then(|| pose(eye + depth * b, 0.0)))
    } else if aside <= (1.0 + LONGER_BY) * length {
        [Some(pose(first + (foot - first) * (length / aside), TOO_LONG)), None]
    } else {
        [None, None]
    };
    both.into_iter().flatten()
}

/// With its first end at a depth, and the second one anywhere beyond the image's edge.
fn beyond(eye: DVec3, [a, b]: [DVec3; 2], depth: f64, length: f64) -> impl Iterator<Item = Pose> {
    let first = eye + depth * a;
    let across = (b - b.dot(a) * a).normalize_or_zero();
    (0..SLANTS).map(move |k| {
        let angle = std::f64::consts::PI * (k as f64 + 0.5) / SLANTS as f64;
        Pose {
            ends: [first, first + length * (angle.cos() * a + angle.sin() * across)],
            shown: [true, false],
            cost: 0.0,
        }
    })
}

/// The motion through these poses: ends that go on evenly, as near to the lines of sight as photos tell. The turn is about the rod's
/// middle, least from time to time: nothing shows how it spins.
fn frames(seen: &[(&Look, Pose)], times: usize, length: f64) -> Option<Vec<Frame>> {
    let [a, b] = [end(seen, 0, times, length)?, end(seen, 1, times, length)?];
    let way = |time: usize| (b[time] - a[time]).normalize_or(DVec3::X);
    let mut turn = DQuat::IDENTITY;
    let frame = |time: usize| {
        turn = (DQuat::from_rotation_arc(way(time.saturating_sub(1)), way(time)) * turn).normalize();
        Frame { turn: DMat3::from_quat(turn), shift: 0.5 * (a[time] + b[time]) }
    };
    Some((0..times).map(frame).collect())
}

/// Where an end is at each time.
fn end(seen: &[(&Look, Pose)], which: usize, times: usize, length: f64) -> Option<Vec<DVec3>> {
    let mut weights = vec![1.0; seen.len()];
    let mut places = Vec::new();
    for _ in 0..ROUNDS {
        places = even(seen, &weights, which, times, length)?;
        for (weight, (look, pose)) in weights.iter_mut().zip(seen) {
            let (across, _) = known(look, pose, which, length);
            let off = across * (places[look.time] - pose.ends[which]);
            *weight = 1.0 / (1.0 + off.length_squared() / 4.0);
        }
    }
    Some(places)
}

/// Two square roots of what a photo knows of an end's place: across its line of sight (of one that it does not show, across the plane of the
/// rod), and all ways.
fn known(look: &Look, pose: &Pose, which: usize, length: f64) -> (DMat3, f64) {
    let eye = look.camera.position;
    let sight = (pose.ends[which] - eye).normalize_or_zero();
    let pixel = look.pixel(pose.ends[which]).unwrap_or(length);
    let across = if pose.shown[which] {
        DMat3::IDENTITY - outer(sight, sight)
    } else {
        let normal = sight.cross(pose.ends[1 - which] - eye).normalize_or_zero();
        outer(normal, normal)
    };
    (across * (1.0 / (ACROSS * pixel)), 1.0 / (ALONG * length))
}

/// Least squares of an end's places and of changes of its speed.
fn even(seen: &[(&Look, Pose)], weights: &[f64], which: usize, times: usize, length: f64) -> Option<Vec<DVec3>> {
    let mut a = Band::new(3 * times, 8);
    let mut b = vec![0.0; 3 * times];
    for ((look, pose), weight) in seen.iter().zip(weights) {
        let (across, all) = known(look, pose, which, length);
        let square = across * across * *weight + DMat3::IDENTITY * (all * all);
        let right = square * pose.ends[which];
        for i in 0..3 {
            b[3 * look.time + i] += right[i];
            (0..3).for_each(|j| a.add(3 * look.time + i, 3 * look.time + j, square.col(j)[i]));
        }
    }
    let bend = 1.0 / (SMOOTH * length).powi(2);
    for time in 1..times.saturating_sub(1) {
        for (i, x) in [1.0, -2.0, 1.0].into_iter().enumerate() {
            for (j, y) in [1.0, -2.0, 1.0].into_iter().enumerate() {
                (0..3).for_each(|k| a.add(3 * (time - 1 + i) + k, 3 * (time - 1 + j) + k, bend * x * y));
            }
        }
    }
    a.damp(0.0, 1e-6 / (length * length));
    Some(a.solve(b)?.as_chunks::<3>().0.iter().map(|v| DVec3::from_array(*v)).collect())
}
