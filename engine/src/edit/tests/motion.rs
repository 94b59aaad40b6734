//! Frames of parts, moments and time maps against their definitions.

use glam::DMat4;

use super::*;
use crate::reference::{exp, poses, table_poses};
use crate::scene::Motion;
use crate::scene::synthetic::Random;

fn matrix(scene: &Scene, time: f64, j: usize) -> DMat4 {
    let pose = poses(scene, time, MotionSource::Auto).unwrap().unwrap()[j];
    DMat4::from_mat3_translation(exp(pose.rotation), pose.translation)
}

fn as_matrix(s: &Similarity) -> DMat4 {
    DMat4::from_mat3_translation(s.matrix() * s.scale, s.shift)
}

/// Largest distance of centres from `expected(old centre, time, index)`.
fn off(old: &Scene, new: &Scene, times: &[f64], expected: impl Fn(DVec3, f64, usize) -> DVec3) -> f64 {
    let mut worst: f64 = 0.0;
    for &time in times {
        let [old, new] = [old, new].map(|s| place_scene(s, time, MotionSource::Auto).unwrap().mean);
        for i in 0..old.len() {
            worst = worst.max(new[i].distance(expected(old[i], time, i)));
        }
    }
    worst
}

/// T'(t) = T_p(t)·T_p(t₀)⁻¹·S·T_p(t₀)·T_p(t)⁻¹·T(t), for the part itself exactly, for others within the bound.
#[test]
fn a_change_in_a_parts_frame_goes_along_with_it() {
    let mut random = Random::new(6);
    let times: Vec<f64> = (0..40).map(|_| random.range(-0.1, 1.1)).collect();
    for scene in [scene(), soft_scene()] {
        let bound = Bound::new(&scene, &[], 0.02).unwrap();
        // Pixels per world unit at the nearest that a camera is to the scene.
        let pixel = 1.0 / 450.0;
        for (what, scale) in [("rigid", 1.0), ("scaled", 1.3)] {
            let s = Similarity { scale, ..some_change(1.0) };
            let (part, t0) = (2, 0.37);
            let mask: Vec<bool> = (0..300).map(|i| i % 2 == 0).collect();
            let mut changed = scene.clone();
            let touched = transform_in_part(&mut changed, &mask, part, &s, t0, &bound).unwrap();
            changed.deformation.check(300).unwrap();
            let change = |time: f64| {
                let (now, then) = (matrix(&scene, time, part), matrix(&scene, t0, part));
                now * then.inverse() * as_matrix(&s) * then * now.inverse()
            };
            let found =
                off(&scene, &changed, &times, |x, time, i| if mask[i] { change(time).transform_point3(x) } else { x });
            let px = touched.error_px.unwrap();
            println!(
                "{what}: {} keys more, {px:.4} px by its own measure, {:.4} px off",
                touched.keys_added,
                found / pixel
            );
            assert!(px <= 0.02 && found < 0.03 * pixel, "{what}: {found} {px}");
            assert!(touched.keys_added > 0, "a part that others do not move with");
            // The part alone needs no keys: its poses keep their bits.
            let alone: Vec<bool> =
                scene.deformation.superpoint_of_gaussian().iter().map(|&j| j == part as u32).collect();
            if scene.deformation.blend().is_none() {
                let mut changed = scene.clone();
                let touched = transform_in_part(&mut changed, &alone, part, &s, t0, &bound).unwrap();
                assert_eq!((touched.keys_added, touched.error_px), (0, None));
                assert_eq!(changed.deformation.table(), scene.deformation.table());
                let found =
                    off(&scene, &changed, &times, |x, t, i| if alone[i] { change(t).transform_point3(x) } else { x });
                assert!(found < 3e-6, "{what}: {found}");
            }
        }
    }
}

/// A part that spins twice between two keys, and another that does so with it.
#[test]
fn rotations_beyond_half_turns_are_followed() {
    let mut scene = scene();
    let spin = [[0.0; 3], [2.0, -9.0, 8.0]];
    let rows = |of: [[f32; 3]; 2]| of.iter().flat_map(|r| [*r; 6]).collect::<Vec<_>>();
    *scene.deformation.table_mut().unwrap() =
        Motion { times: vec![0.0, 1.0], rotation: rows(spin), translation: rows([[0.0; 3], [0.5, 0.0, 0.1]]) };
    scene.deformation.table_mut().unwrap().rotation[7] = [2.1, -9.0, 8.0];
    let bound = Bound::new(&scene, &[], 0.1).unwrap();
    let (s, mut changed) = (some_change(1.0), scene.clone());
    let touched = transform_in_part(&mut changed, &[true; 300], 0, &s, 0.2, &bound).unwrap();
    let times: Vec<f64> = (0..=50).map(|k| f64::from(k) / 50.0).collect();
    let found = off(&scene, &changed, &times, |x, time, _| {
        let (now, then) = (matrix(&scene, time, 0), matrix(&scene, 0.2, 0));
        (now * then.inverse() * as_matrix(&s) * then * now.inverse()).transform_point3(x)
    });
    println!("{} keys more, {:?} px", touched.keys_added, touched.error_px);
    assert!(touched.error_px.unwrap() <= 0.1 && found < 5e-4, "{found} {:?}", touched.error_px);
}

#[test]
fn a_moments_change_comes_and_goes() {
    let window = Window { from: 0.4, to: 0.6, ease: 0.15 };
    let s = Similarity { scale: 1.0, ..some_change(1.0) };
    let pivot = DVec3::new(0.1, 0.2, 0.3);
    for scene in [scene(), soft_scene(), random_scene(300, 3, 1)] {
        let bound = Bound::new(&scene, &[], 0.05).unwrap();
        let (mask, mut changed) = (every_third(&scene), scene.clone());
        let touched = transform_during(&mut changed, &mask, &s, pivot, window, &bound).unwrap();
        changed.deformation.check(300).unwrap();
        assert!(touched.error_px.unwrap() <= 0.05, "{touched:?}");
        let times = [0.0, 0.2, 0.25, 0.31, 0.4, 0.5, 0.6, 0.7, 0.75, 1.0];
        let found =
            off(
                &scene,
                &changed,
                &times,
                |x, time, i| {
                    if mask[i] { s.share(window.share(time), pivot).apply(x) } else { x }
                },
            );
        assert!(found < 2e-4, "{found}");
    }
    let outside = Window { from: 3.0, to: 4.0, ease: 0.1 };
    let bound = Bound::new(&scene(), &[], 0.05).unwrap();
    assert!(transform_during(&mut scene(), &[true; 300], &s, pivot, outside, &bound).is_err());
}

#[test]
fn time_maps_show_the_old_scene_at_the_mapped_time() {
    let maps = [
        TimeMap::Freeze(0.37),
        TimeMap::Linear { rate: 1.0, offset: -0.1 },
        TimeMap::Linear { rate: 0.5, offset: 0.0 },
        TimeMap::Linear { rate: -1.0, offset: 1.0 },
        TimeMap::Linear { rate: 3.0, offset: 0.21 },
        TimeMap::Loop { from: 0.1, to: 0.43 },
        TimeMap::Loop { from: 0.0, to: 0.5 },
    ];
    for scene in [scene(), soft_scene()] {
        for mask in [every_third(&scene), vec![true; 300]] {
            for map in maps {
                let mut changed = scene.clone();
                retime(&mut changed, &mask, map).unwrap();
                changed.deformation.check(300).unwrap();
                // Loops are within the scene's range; at a jump either side may show.
                let range = if matches!(map, TimeMap::Loop { .. }) { 0.0..1.0 } else { -0.5..2.5 };
                let (mut random, mut worst) = (Random::new(9), 0.0_f64);
                for _ in 0..60 {
                    let time = random.range(range.start, range.end);
                    let [old, then, new] = [(&scene, time), (&scene, map.at(time)), (&changed, time)]
                        .map(|(s, t)| place_scene(s, t, MotionSource::Auto).unwrap());
                    for i in 0..300 {
                        let expected = if mask[i] { then.mean[i] } else { old.mean[i] };
                        worst = worst.max(new.mean[i].distance(expected));
                    }
                }
                assert!(worst < 5e-6, "{map:?}: {worst}");
            }
        }
    }
}

#[test]
fn lifespans_follow_time() {
    let mut scene = scene();
    let lifespans: Vec<f32> = (0..300).flat_map(|i| [i as f32 / 300.0, -2.0 + i as f32 / 200.0]).collect();
    scene.gaussians.optional.set(LIFESPAN, lifespans);
    for map in [TimeMap::Freeze(0.4), TimeMap::Linear { rate: -0.5, offset: 0.8 }] {
        let (mask, mut changed) = (every_third(&scene), scene.clone());
        retime(&mut changed, &mask, map).unwrap();
        for time in [0.0, 0.3, 0.8] {
            let [old, then, new] = [(&scene, time), (&scene, map.at(time)), (&changed, time)]
                .map(|(s, t)| place_scene(s, t, MotionSource::Auto).unwrap().opacity);
            for i in 0..300 {
                let expected = if mask[i] { then[i] } else { old[i] };
                assert!((new[i] - expected).abs() < 1e-5, "{map:?}: {} {expected}", new[i]);
            }
        }
    }
    let error = retime(&mut scene, &[true; 300], TimeMap::Loop { from: 0.0, to: 0.3 }).unwrap_err();
    assert!(error.to_string().contains("lifespan"), "{error}");
}

#[test]
fn loops_jump_within_one_step_of_f32() {
    let mut changed = scene();
    retime(&mut changed, &[true; 300], TimeMap::Loop { from: 0.0, to: 0.25 }).unwrap();
    let table = changed.deformation.table().unwrap();
    let at = |t: f32| table_poses(table, f64::from(t))[0].translation;
    let old = table_poses(scene().deformation.table().unwrap(), 0.25)[0].translation;
    assert!(at(0.25_f32.next_down()).distance(old) < 1e-6 && at(0.25) == at(0.0) && at(0.0).distance(old) > 1e-3);
    let error = retime(&mut scene(), &[true; 300], TimeMap::Loop { from: 0.0, to: 1e-9 }).unwrap_err();
    assert_eq!(error.exit_code(), 4, "{error}");
}
