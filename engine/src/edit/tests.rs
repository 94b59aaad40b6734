//! Edits against the f64 reference and against their definitions in f64.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "tests")]

mod fuzz;
mod history;
mod motion;
mod replay;
mod selecting;
mod speed;

use glam::{DQuat, DVec3};

use super::*;
use crate::reference::{ReferenceOptions, place_scene, render};
use crate::scene::parameter::{LIFESPAN, SMOOTHING};
use crate::scene::synthetic::{moving_scene, random_blend, random_scene};
use crate::scene::{Camera, MotionSource};

/// Times at keys, between them, and outside of the table.
pub(super) const TIMES: [f64; 6] = [-0.2, 0.0, 0.13, 0.5, 0.771, 1.3];

pub(super) fn scene() -> Scene {
    moving_scene(300, 6, 7, 3, false)
}

/// The same with soft superpoints.
pub(super) fn soft_scene() -> Scene {
    let mut scene = scene();
    let blend = random_blend(300, 6, 3, 5);
    let s = scene.deformation.superpoint_deformation_mut().unwrap();
    s.superpoints.of_gaussian = blend.of_gaussian();
    s.blend = Some(blend);
    scene
}

pub(super) fn camera() -> Camera {
    Camera::look_at(DVec3::new(0.4, -0.6, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, [96, 72])
}

pub(super) fn image(scene: &Scene, camera: &Camera, time: f64, near: f64) -> Vec<f64> {
    let options = ReferenceOptions { near, background: [0.2, 0.4, 0.1], ..ReferenceOptions::default() };
    render(scene, camera, time, &options).unwrap().rgb
}

pub(super) fn psnr(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let mse = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64;
    -10.0 * mse.log10()
}

pub(super) fn run(scene: Scene, script: &str) -> Scene {
    let mut session = Session::new(scene, Vec::new(), BOUND_PX);
    for command in script::parse(script).unwrap() {
        session.apply(&command).unwrap_or_else(|e| panic!("{}: {e}", command.text));
    }
    session.scene.deformation.check(session.scene.gaussians.len()).unwrap();
    session.scene
}

pub(super) fn every_third(scene: &Scene) -> Vec<bool> {
    (0..scene.gaussians.len()).map(|i| i % 3 == 0).collect()
}

fn moved(camera: &Camera, s: &Similarity) -> Camera {
    let rotation = camera.rotation * s.matrix().transpose();
    Camera { rotation, position: s.apply(camera.position), ..camera.clone() }
}

pub(super) fn some_change(scale: f64) -> Similarity {
    let turn = Similarity::of_turn(DVec3::new(1.0, -2.0, 0.7), 1.9, DVec3::new(0.2, 0.1, -0.3));
    Similarity::of_shift(DVec3::new(1.0, -0.4, 0.3)).after(&Similarity::of_scale(scale, DVec3::ONE)).after(&turn)
}

#[test]
fn what_changes_nothing_keeps_all_bits() {
    let nothing = "select all; move 0,0,0; move 0,0,0 frame part; rotate z 0 pivot origin; scale 1 pivot origin; \
                   time shift 0; time stretch 1; recolor gain 1; move 0,0,0 during 0..1; select none; delete; rotate x 40; \
                   freeze 0.5; add superpoints 1; invert; invert; name a; select named a";
    for scene in [scene(), soft_scene()] {
        assert_eq!(run(scene.clone(), nothing), scene);
        assert_eq!(run(scene.clone(), "# nothing\n"), scene);
    }
}

/// A changed world is seen as the old one is from cameras that were changed the other way; view-dependent colour included.
#[test]
fn a_change_of_the_world_is_one_of_the_cameras() {
    let mut still = random_scene(300, 4, 3);
    for (name, scene) in [("hard", scene()), ("soft", soft_scene()), ("still", still.clone())] {
        for scale in [1.0, 1.7] {
            let (s, mut changed) = (some_change(scale), scene.clone());
            let touched = transform(&mut changed, &vec![true; 300], &s).unwrap();
            assert_eq!((touched.gaussians, touched.keys_added, touched.error_px), (300, 0, None));
            let mut worst = f64::INFINITY;
            for time in TIMES {
                let (a, b) =
                    (image(&scene, &camera(), time, 0.2), image(&changed, &moved(&camera(), &s), time, 0.2 * scale));
                worst = worst.min(psnr(&a, &b));
            }
            println!("{name}, scale {scale}: {worst:.1} dB");
            assert!(worst > 90.0, "{name}, scale {scale}: {worst} dB");
        }
    }
    // It is no wonder of a scene without view-dependent colour.
    let (before, s) = (still.clone(), some_change(1.0));
    transform(&mut still, &[true; 300], &s).unwrap();
    still.gaussians.sh = before.gaussians.sh.clone();
    let unturned = psnr(&image(&before, &camera(), 0.0, 0.2), &image(&still, &moved(&camera(), &s), 0.0, 0.2));
    assert!(unturned < 60.0, "{unturned} dB without turned colours");
}

/// Only the selection is where the change takes it, also where superpoints and soft ones are selected in part.
#[test]
fn a_part_of_a_superpoint_moves_alone() {
    for scene in [scene(), soft_scene()] {
        let (s, mask, mut changed) = (some_change(0.6), every_third(&scene), scene.clone());
        transform(&mut changed, &mask, &s).unwrap();
        changed.deformation.check(300).unwrap();
        for time in TIMES {
            let [old, new] = [&scene, &changed].map(|s| place_scene(s, time, MotionSource::Auto).unwrap());
            for i in 0..300 {
                let expected = if mask[i] { s.apply(old.mean[i]) } else { old.mean[i] };
                assert!(new.mean[i].distance(expected) < 2e-6, "{i} at {time}");
                let turned = if mask[i] { s.matrix() * old.rotation[i] } else { old.rotation[i] };
                assert!(new.rotation[i].abs_diff_eq(turned, 2e-6), "{i} at {time}");
            }
        }
    }
}

#[test]
fn deleting_is_drawing_the_others() {
    for scene in [scene(), soft_scene(), random_scene(300, 2, 2)] {
        let rest: Vec<bool> = every_third(&scene).iter().map(|m| !m).collect();
        let mut complement = scene.clone();
        complement.gaussians.retain(&rest);
        complement.deformation.retain(&rest);
        let numbers: Vec<String> = (0..300).step_by(3).map(|i| i.to_string()).collect();
        for script in [
            format!("select gaussians {}; delete", numbers.join(",")),
            format!("select gaussians {}; invert; keep", numbers.join(",")),
        ] {
            let deleted = run(scene.clone(), &script);
            assert_eq!(deleted.gaussians.len(), 200);
            for time in TIMES {
                assert!(image(&deleted, &camera(), time, 0.2) == image(&complement, &camera(), time, 0.2), "{time}");
            }
        }
    }
}

/// Scaled or stretched, a smoothed scene is what it is without a smoothing of its own; who is not selected keeps every bit.
#[test]
fn a_smoothing_is_scaled_with_its_gaussians() {
    let mut smoothed = random_scene(200, 8, 1);
    smoothed.gaussians.optional.set(SMOOTHING, (0..200).map(|i| 0.002 * (i % 9) as f32).collect());
    let mut folded = smoothed.clone();
    folded.gaussians.fold_smoothing();
    assert!(folded.gaussians.optional.is_empty() && folded.gaussians.log_scale != smoothed.gaussians.log_scale);
    for change in ["scale 1.7", "scale 1.7,0.6,1"] {
        let script = format!("select sphere 0,0,0 0.8; {change}");
        let [changed, expected] = [&smoothed, &folded].map(|scene| run(scene.clone(), &script));
        let [a, b] = [&changed, &expected].map(|scene| image(scene, &camera(), 0.0, 0.2));
        let off = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-4, "{change}: images differ by {off}");
        let g = &changed.gaussians;
        let same = |i: &usize| g.log_scale[*i] == smoothed.gaussians.log_scale[*i];
        let kept = (0..200).filter(same).filter(|i| {
            let sigma = |scene: &Scene| scene.gaussians.optional.row(SMOOTHING, *i).map(|s| s[0].to_bits());
            sigma(&changed) == sigma(&smoothed) && g.opacity_logit[*i] == smoothed.gaussians.opacity_logit[*i]
        });
        assert!((1..200).contains(&kept.count()), "{change}: some are selected, the others keep what they have");
    }
}

#[test]
fn an_antialiased_scene_and_another_are_not_merged() {
    let (mut scene, mut other) = (random_scene(20, 8, 1), random_scene(20, 9, 1));
    other.gaussians.antialiased = true;
    let placement =
        Placement { place: Similarity { scale: 1.0, turn: DQuat::IDENTITY, shift: DVec3::ZERO }, time: [1.0, 0.0] };
    let before = scene.clone();
    let error = merge(&mut scene, other, &placement).unwrap_err().to_string();
    assert!(error.contains("antialiased") && scene == before, "{error}");
}

/// Where they do not overlap, two scenes in one image are the sum of their images.
#[test]
fn merging_is_compositing() {
    let still = random_scene(200, 8, 1);
    let mut with_lifespans = moving_scene(200, 3, 4, 12, false);
    with_lifespans.gaussians.optional.set(LIFESPAN, [0.4, -1.0].repeat(200));
    for (name, one, two) in [
        ("hard + soft", scene(), soft_scene()),
        ("soft + hard", soft_scene(), scene()),
        ("still + hard", still.clone(), scene()),
        ("soft + still", soft_scene(), still.clone()),
        ("still + still", still, random_scene(200, 9, 3)),
        ("lifespans", with_lifespans, scene()),
    ] {
        let place = Similarity { scale: 0.9, turn: DQuat::from_rotation_y(0.7), shift: DVec3::new(4.5, 0.0, 0.0) };
        let mut merged = one.clone();
        merge(&mut merged, two.clone(), &Placement { place, time: [0.5, 0.25] }).unwrap();
        merged.deformation.check(merged.gaussians.len()).unwrap();
        let mut placed = two.clone();
        transform(&mut placed, &vec![true; two.gaussians.len()], &place).unwrap();
        let camera =
            Camera::look_at(DVec3::new(2.2, -0.5, -9.0), DVec3::new(2.2, 0.0, 0.0), DVec3::NEG_Y, 0.9, [160, 72]);
        let black = |scene: &Scene, time| render(scene, &camera, time, &ReferenceOptions::default()).unwrap().rgb;
        let mut worst = f64::INFINITY;
        for time in TIMES {
            let (a, b) = (black(&one, time), black(&placed, (time - 0.25) / 0.5));
            assert!(a.iter().zip(&b).all(|(a, b)| *a == 0.0 || *b == 0.0), "{name}: they overlap");
            assert!(a.iter().sum::<f64>() > 10.0 && b.iter().sum::<f64>() > 10.0, "{name}: nothing is seen at {time}");
            let sum: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a + b).collect();
            worst = worst.min(psnr(&sum, &black(&merged, time)));
        }
        println!("{name}: {worst:.1} dB");
        assert!(worst > 80.0, "{name}: {worst} dB");
    }
}

#[test]
fn superpoints_that_lose_all_gaussians_go() {
    for scene in [scene(), soft_scene()] {
        let mut session = Session::new(scene, Vec::new(), BOUND_PX);
        for command in script::parse("select superpoints 1,4; rotate x 20; select superpoints 0-2; delete").unwrap() {
            session.apply(&command).unwrap();
        }
        let before = session.scene.clone();
        let gone = session.finish();
        session.scene.deformation.check(session.scene.gaussians.len()).unwrap();
        assert_eq!(session.scene.deformation.superpoint_count() + gone, before.deformation.superpoint_count());
        assert!(before.deformation.blend().is_some() || gone == 3, "{gone}");
        for time in TIMES {
            let [a, b] = [&before, &session.scene].map(|s| place_scene(s, time, MotionSource::Auto).unwrap());
            assert!(a == b, "{time}");
        }
        assert_eq!(session.finish(), 0);
    }
    let mut unused = scene();
    unused.deformation.superpoints_mut().unwrap().of_gaussian.iter_mut().for_each(|j| *j = (*j).min(4));
    let mut session = Session::new(unused.clone(), Vec::new(), BOUND_PX);
    assert!(session.finish() == 0 && session.scene == unused, "what was there stays");
}

#[test]
fn copies_move_alone() {
    let once = scene();
    let twice = run(once.clone(), "select superpoints 2; duplicate; move 5,0,0");
    let count = once.deformation.superpoint_of_gaussian().iter().filter(|j| **j == 2).count();
    assert_eq!((twice.gaussians.len(), twice.deformation.superpoint_count()), (300 + count, 7));
    let [old, new] = [&once, &twice].map(|s| place_scene(s, 0.4, MotionSource::Auto).unwrap());
    assert_eq!(old.mean[..], new.mean[..300]);
    let moved = old.mean.iter().zip(once.deformation.superpoint_of_gaussian()).filter(|(_, j)| **j == 2);
    for ((old, _), new) in moved.zip(&new.mean[300..]) {
        assert!((*old + DVec3::X * 5.0).distance(*new) < 1e-6);
    }
}

/// Colours of images: the map of the image, as no colour is clamped and the background is mapped too.
#[test]
fn colors_follow_the_map() {
    let mut scene = scene();
    scene.gaussians.sh.iter_mut().for_each(|v| *v *= 0.2);
    let change = Recolor {
        matrix: glam::DMat3::from_cols_array(&[0.5, 0.1, 0.2, 0.0, 0.7, 0.1, 0.2, 0.0, 0.4]),
        offset: DVec3::new(0.1, 0.05, 0.2),
    };
    let mut changed = scene.clone();
    assert_eq!(recolor(&mut changed, &[true; 300], &change).gaussians, 300);
    let map = |c: &[f64]| (change.matrix * DVec3::new(c[0], c[1], c[2]) + change.offset).to_array();
    let background = map(&[0.2, 0.4, 0.1]);
    let options = ReferenceOptions { background, ..ReferenceOptions::default() };
    let found = render(&changed, &camera(), 0.3, &options).unwrap().rgb;
    let expected: Vec<f64> = image(&scene, &camera(), 0.3, 0.2).chunks_exact(3).flat_map(map).collect();
    assert!(psnr(&found, &expected) > 100.0, "{}", psnr(&found, &expected));
    let tinted = Recolor::tint(DVec3::new(1.0, 0.5, 0.0)).matrix * DVec3::splat(0.3);
    assert!(tinted.distance(DVec3::new(0.3, 0.15, 0.0)) < 1e-12);
}

/// Different factors are exact where nothing turns, and rejected where something does.
#[test]
fn stretching_along_axes_needs_what_does_not_turn() {
    let factors = DVec3::new(2.0, 0.5, 1.0);
    let error = stretch(&mut scene(), &[true; 300], factors, DVec3::ZERO).unwrap_err();
    assert!(error.to_string().contains("shears") && error.exit_code() == 2, "{error}");
    let mut drifting = scene();
    drifting.deformation.table_mut().unwrap().rotation.fill([0.0; 3]);
    for scene in [drifting, random_scene(300, 4, 3)] {
        let mut changed = scene.clone();
        stretch(&mut changed, &[true; 300], factors, DVec3::ONE).unwrap();
        let [old, new] = [&scene, &changed].map(|s| place_scene(s, 0.3, MotionSource::Auto).unwrap());
        let diagonal = glam::DMat3::from_diagonal(factors);
        for i in 0..300 {
            assert!(new.mean[i].distance((old.mean[i] - 1.0) * factors + 1.0) < 1e-6);
            let covariance = |p: &crate::reference::Placed| {
                let axes = p.rotation[i] * glam::DMat3::from_diagonal(DVec3::from_array(p.scale[i]));
                axes * axes.transpose()
            };
            let (a, b) = (diagonal * covariance(&old) * diagonal, covariance(&new));
            assert!(
                a.abs_diff_eq(b, 1e-5 * a.x_axis.length().max(a.y_axis.length()).max(a.z_axis.length())),
                "{a} {b}"
            );
        }
    }
}

/// What cannot follow a change says so, and what needs no change of places works.
#[test]
fn networks_are_rejected_where_they_cannot_follow() {
    let mut only_network = moving_scene(50, 3, 4, 1, true);
    only_network.deformation.superpoint_deformation_mut().unwrap().table = None;
    let error = transform(&mut only_network.clone(), &[true; 50], &some_change(1.0)).unwrap_err();
    assert!(error.to_string().contains("--bake"), "{error}");
    let mut recolored = run(only_network.clone(), "select superpoints 1; recolor gain 0.5; delete");
    assert!(recolored.deformation.network().is_some());
    let mask = vec![true; recolored.gaussians.len()];
    assert!(retime(&mut recolored, &mask, TimeMap::Freeze(0.5)).is_err());
    let both = moving_scene(50, 3, 4, 1, true);
    assert!(run(both, "select all; move 1,0,0").deformation.network().is_none());
    let error = retime(&mut random_scene(9, 1, 0), &[true; 9], TimeMap::Freeze(0.5)).unwrap_err();
    assert!(error.to_string().contains("nothing moves"), "{error}");
}
