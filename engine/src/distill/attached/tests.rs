//! A rod, in a hand or not, seen by a camera that goes around.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::sync::Arc;

use super::*;
use crate::data::pixels::Pixels;
use crate::scene::Camera;

const TIMES: usize = 60;
const SIDE: u32 = 100;
/// World units.
const LENGTH: f64 = 0.7;

fn time(i: usize) -> f64 {
    i as f64 / TIMES as f64
}

/// How the hand stands, with so much of its turn.
fn hand(i: usize, share: f64) -> Frame {
    let angle = std::f64::consts::TAU * time(i);
    let turn = DMat3::from_rotation_z(share * 1.1 * (2.0 * angle).sin());
    Frame { turn, shift: DVec3::new(0.4 + 0.1 * angle.sin(), 0.2 * angle.cos(), 0.1) }
}

fn rod(i: usize) -> impl Iterator<Item = DVec3> {
    (0..=40).map(move |k| hand(i, 1.0).apply(DVec3::X * (LENGTH * f64::from(k) / 40.0)))
}

fn camera(i: usize) -> Camera {
    let angle = 2.3 * i as f64;
    let eye = DVec3::new(4.0 * angle.cos(), 1.2, 4.0 * angle.sin());
    Camera::look_at(eye, DVec3::ZERO, DVec3::Y, 0.8, [SIDE, SIDE])
}

/// A photo that differs where the rod of a time is.
fn look(i: usize, shows: usize) -> Look {
    let (camera, side) = (camera(i), SIDE as usize);
    let rod: Vec<_> = rod(shows).filter_map(|p| camera.project(p)).collect();
    let is_rod = |k: usize| {
        let pixel = glam::DVec2::new((k % side) as f64 + 0.5, (k / side) as f64 + 0.5);
        rod.iter().any(|at| at.distance(pixel) <= 1.2)
    };
    let differs: Vec<bool> = (0..side * side).map(is_rod).collect();
    let rgba = differs.iter().map(|d| if *d { 0xff20_8040 } else { 0xff00_0000 }).collect();
    let photo = Arc::new(Pixels { width: SIDE, height: SIDE, rgba });
    let amount = differs.iter().map(|d| f32::from(u8::from(*d))).collect();
    Look::of(camera, photo, amount, i, &differs)
}

fn find(shows: impl Fn(usize) -> usize) -> (Vec<Look>, Option<Found>) {
    let frames: Vec<Vec<Frame>> = (0..TIMES).map(|i| vec![hand(i, 0.7)]).collect();
    let looks: Vec<Look> = (0..TIMES).map(|i| look(i, shows(i))).collect();
    let times: Vec<f32> = (0..TIMES).map(|i| time(i) as f32).collect();
    let path = Path::of_part(&frames, 0, DVec3::ZERO);
    let pivot = Pivot { part: Some(0), at: DVec3::ZERO, cell: path.pixel(&looks).unwrap(), share: 1.0 };
    let found = grown(pivot, path, &looks, &times);
    (looks, found)
}

#[test]
fn a_rod_grows_from_a_hand_and_its_turns_are_found() {
    let (looks, found) = find(|i| i);
    let found = found.unwrap();
    let (cell, reach) = (found.pivot.cell, found.shape.reach() * found.pivot.cell);
    assert!((0.9 * LENGTH..1.1 * LENGTH).contains(&reach), "{reach}");
    let distance = |p: &DVec3, i: usize| rod(i).map(|r| r.distance(*p)).fold(f64::INFINITY, f64::min) / cell;
    let farthest = |i: usize| found.cells(i).iter().map(|p| distance(p, i)).fold(0.0, f64::max);
    let mut off: Vec<f64> = (0..TIMES).map(farthest).collect();
    off.sort_by(f64::total_cmp);
    assert!(off[TIMES / 2] < 2.5 && off[TIMES * 9 / 10] < 5.0, "{off:?}");
    assert_eq!(found.path.colour(DVec3::X * 0.3, &looks), Some([0x40, 0x80, 0x20]));
    // Key poses are as near to the path as they are to be.
    let times: Vec<f32> = (0..TIMES).map(|i| time(i) as f32).collect();
    let table = found.table(&times);
    assert!(table.times.len() < TIMES && table.times[0] == times[0], "{} keys", table.times.len());
    for (i, &t) in times.iter().enumerate().take(TIMES - 1) {
        let pose = table_poses(&table, f64::from(t))[0];
        let end = found.shape.farthest()[0];
        let placed = exp_quaternion(pose.rotation) * (found.pivot.at + end) + pose.translation;
        assert!(placed.distance(found.path.place(i, end)) <= 1.01 * OFF_PATH * cell, "{i}");
    }
}

/// What photos show is at the right places, at the wrong times.
#[test]
fn what_does_not_go_with_the_part_is_not_fixed_to_it() {
    assert!(find(|i| (i * 37 + 11) % TIMES).1.is_none());
}

/// The same rod, beside a part that says nothing of it.
fn find_free(shows: impl Fn(usize) -> usize) -> Option<Found> {
    let looks: Vec<Look> = (0..TIMES).map(|i| look(i, shows(i))).collect();
    let times: Vec<f32> = (0..TIMES).map(|i| time(i) as f32).collect();
    free(&looks, &times, (DVec3::ZERO, 1.0))
}

#[test]
fn a_rod_that_nothing_holds_is_followed() {
    let found = find_free(|i| i).unwrap();
    assert_eq!(found.pivot.part, None);
    let cell = found.pivot.cell;
    let ends = found.shape.farthest();
    let long = ends.iter().flat_map(|a| ends.iter().map(|b| a.distance(*b))).fold(0.0, f64::max);
    assert!((0.9 * LENGTH..1.2 * LENGTH).contains(&long), "{long}");
    let distance = |p: &DVec3, i: usize| rod(i).map(|r| r.distance(*p)).fold(f64::INFINITY, f64::min) / cell;
    let farthest = |i: usize| found.cells(i).iter().map(|p| distance(p, i)).fold(0.0, f64::max);
    let mut off: Vec<f64> = (0..TIMES).map(farthest).collect();
    off.sort_by(f64::total_cmp);
    assert!(off[TIMES / 2] < 3.0 && off[TIMES * 9 / 10] < 6.0, "{off:?}");
}

/// Each photo shows a rod, but no motion has them all.
#[test]
fn rods_of_no_one_motion_are_none() {
    assert!(find_free(|i| (i * 37 + 11) % TIMES).is_none());
}
