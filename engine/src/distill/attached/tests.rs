//! A rod, in a hand or not, seen by a camera that goes around.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::sync::Arc;

use super::*;
use crate::data::pixels::Pixels;
use crate::image::Image;
use crate::scene::Camera;
use crate::train::lost::residual::Difference;

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

/// A photo that differs where these places are; without any, the model has a wall before the camera, and so has the photo.
fn difference(i: usize, places: Option<Vec<DVec3>>, width: f64) -> Difference {
    let (camera, side) = (camera(i), SIDE as usize);
    let pixel = if places.is_some() { [0.0; 4] } else { [0.0, 0.0, 0.0, 1.0] };
    let shown: Vec<_> = places.into_iter().flatten().filter_map(|p| camera.project(p)).collect();
    let is_shown = |k: usize| {
        let pixel = glam::DVec2::new((k % side) as f64 + 0.5, (k / side) as f64 + 0.5);
        shown.iter().any(|at| at.distance(pixel) <= width)
    };
    let rgba = (0..side * side).map(|k| if is_shown(k) { 0xff20_8040 } else { 0xff00_0000 }).collect();
    let photo = Arc::new(Pixels { width: SIDE, height: SIDE, rgba });
    let depth = vec![1.5 * pixel[3]; side * side];
    let rendered = Image { width: SIDE, height: SIDE, rgba: pixel.repeat(side * side), depth };
    Difference::new(camera, photo, &rendered, i, [0.0; 3])
}

/// Photos of what is at these places at each time.
fn residual(shows: impl Fn(usize) -> Vec<DVec3>, width: f64) -> Residual {
    let times = (0..TIMES).map(|i| time(i) as f32).collect();
    Residual { times, differences: (0..TIMES).map(|i| difference(i, Some(shows(i)), width)).collect() }
}

/// A photo's rod is that of another time.
fn find(shows: impl Fn(usize) -> usize) -> (Vec<Look>, Option<Found>) {
    let frames: Vec<Vec<Frame>> = (0..TIMES).map(|i| vec![hand(i, 0.7)]).collect();
    let residual = residual(|i| rod(shows(i)).collect(), 1.2);
    let looks: Vec<Look> = residual.differences.iter().map(Look::new).collect();
    let path = Path::of_part(&frames, 0, DVec3::ZERO);
    let pivot = Pivot { part: Some(0), at: DVec3::ZERO, cell: path.pixel(&looks).unwrap(), share: 1.0 };
    let found = grown(Guess { pivot, path }, &looks, &residual.times);
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

/// In half of the photos a wall is before the rod.
#[test]
fn photos_have_no_vote_on_what_is_hidden() {
    let rod_of = |i: usize| (i / 4).is_multiple_of(2).then(|| rod(i).collect());
    let looks: Vec<Look> = (0..TIMES).map(|i| Look::new(&difference(i, rod_of(i), 1.2))).collect();
    let times: Vec<f32> = (0..TIMES).map(|i| time(i) as f32).collect();
    let frames: Vec<Frame> = (0..TIMES).map(|i| hand(i, 0.9)).collect();
    let grown = |path: Path, part: Option<usize>| {
        let pivot = Pivot { part, at: DVec3::ZERO, cell: path.pixel(&looks).unwrap(), share: 1.0 };
        grown(Guess { pivot, path }, &looks, &times)
    };
    let found = grown(Path::alone(frames.clone()), None).unwrap();
    let reach = found.shape.reach() * found.pivot.cell;
    assert!((0.9 * LENGTH..1.1 * LENGTH).contains(&reach), "{reach}");
    let of_part: Vec<Vec<Frame>> = frames.iter().map(|f| vec![*f]).collect();
    assert!(grown(Path::of_part(&of_part, 0, DVec3::ZERO), Some(0)).is_none());
    let ahead = |i: usize, far: f64| {
        let c = &looks[i].camera;
        looks[i].is_hidden(c.position + c.rotation.transpose() * DVec3::new(0.0, 0.0, far))
    };
    assert!(!ahead(4, 1.0) && ahead(4, 2.0) && !ahead(0, 2.0));
}

/// What goes on a path of its own.
fn find_free(shows: impl Fn(usize) -> Vec<DVec3>, width: f64) -> Option<Found> {
    let residual = residual(shows, width);
    let looks: Vec<Look> = residual.differences.iter().map(Look::new).collect();
    best(free(&residual, &looks, (DVec3::ZERO, 1.0)), &looks, &residual.times)
}

/// Pixels by which the middle of what was found is off at nine of ten times, at most.
fn farthest(found: &Found, middle: impl Fn(usize) -> DVec3) -> f64 {
    let off = |i: usize| {
        let cells = found.cells(i);
        let own = cells.iter().sum::<DVec3>() / cells.len() as f64;
        own.distance(middle(i)) / found.pivot.cell
    };
    let mut off: Vec<f64> = (0..TIMES).map(off).collect();
    off.sort_by(f64::total_cmp);
    off[TIMES * 9 / 10]
}

fn ball(i: usize) -> DVec3 {
    let angle = std::f64::consts::TAU * time(i);
    DVec3::new(0.7 * angle.sin(), -0.3, 0.3 * (2.0 * angle).cos())
}

#[test]
fn what_is_no_rod_is_followed_too() {
    let found = find_free(|i| vec![ball(i)], 6.0).unwrap();
    assert!(found.pivot.part.is_none() && found.shape.reach() > SHORTEST, "{}", found.shape.reach());
    let off = farthest(&found, ball);
    assert!(off < 2.0, "{off}");
    assert!(find_free(|i| vec![ball((i * 37 + 11) % TIMES)], 6.0).is_none());
}

/// Of a ball that has a third of the colours of what is behind it.
#[test]
fn discs_with_gaps_are_followed() {
    let step = |k: i32| 0.03 * f64::from(k);
    let rows = (-6..=6).filter(|y| y % 3 != 0).flat_map(|y| (-6..=6).map(move |x| DVec3::new(step(x), step(y), 0.0)));
    let striped: Vec<DVec3> = rows.filter(|o| o.length() < 0.19).collect();
    let residual = residual(|i| striped.iter().map(|o| ball(i) + *o).collect(), 0.7);
    let paths = residual.likely_paths(|time| !is_held(time));
    let path = &paths[0];
    let mut off: Vec<f64> = (0..TIMES).map(|i| path[i].distance(ball(i)) / 0.04).collect();
    off.sort_by(f64::total_cmp);
    assert!(off[TIMES / 2] < 1.0 && off[TIMES * 9 / 10] < 2.5, "{off:?}");
    assert!(residual.likely_paths(|_| false).is_empty());
}

#[test]
fn what_explains_most_is_taken() {
    let step = |k: i32| 0.03 * f64::from(k);
    let offsets = (-6..=6).flat_map(|x| (-6..=6).map(move |y| DVec3::new(step(x), step(y), 0.0)));
    let disc: Vec<DVec3> = offsets.filter(|o| o.length() < 0.19).collect();
    let residual = residual(|i| rod(i).chain(disc.iter().map(|o| ball(i) + *o)).collect(), 1.2);
    let looks: Vec<Look> = residual.differences.iter().map(Look::new).collect();
    let guess = |is_rod: bool| {
        let unturned = |i: usize| Frame { turn: DMat3::IDENTITY, shift: ball(i) };
        let path = Path::alone((0..TIMES).map(|i| if is_rod { hand(i, 1.0) } else { unturned(i) }).collect());
        let pivot = Pivot { part: is_rod.then_some(0), at: DVec3::ZERO, cell: path.pixel(&looks).unwrap(), share: 1.0 };
        Guess { pivot, path }
    };
    let worth = [false, true].map(|is_rod| grown(guess(is_rod), &looks, &residual.times).unwrap().worth);
    assert!(worth[0] > 1.1 * FIXED * worth[1] && worth[1] > 0.0, "{worth:?}");
    for first in [false, true] {
        let guesses = vec![guess(first), guess(!first)];
        assert_eq!(best(guesses, &looks, &residual.times).unwrap().pivot.part, None);
    }
    // Of two that are alike, that which is fixed to a part.
    for first in [Some(0), None] {
        let with = |part: Option<usize>| Guess { pivot: Pivot { part, ..guess(true).pivot }, ..guess(true) };
        let guesses = vec![with(first), with(if first.is_some() { None } else { Some(0) })];
        assert_eq!(best(guesses, &looks, &residual.times).unwrap().pivot.part, Some(0));
    }
    assert!(best(Vec::new(), &looks, &residual.times).is_none());
}

#[test]
fn a_rod_that_nothing_holds_is_followed() {
    let found = find_free(|i| rod(i).collect(), 1.2).unwrap();
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
    assert!(find_free(|i| rod((i * 37 + 11) % TIMES).collect(), 1.2).is_none());
}
