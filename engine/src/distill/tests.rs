#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
use glam::{DQuat, DVec3};

use super::measure::adjusted_rand;
use super::*;
use crate::reference::{freeze, place_scene};
use crate::scene::synthetic::{Random, moving_scene, random_blend};
use crate::scene::{Motion, MotionSource, NonrigidNetwork, SuperpointDeformation, Superpoints};

/// Twelve cameras around the origin, 800x800 pixels.
fn views() -> Views<Camera> {
    let at = |i: usize| {
        let a = std::f64::consts::TAU * i as f64 / 12.0;
        let up = if i.is_multiple_of(2) { 1.5 } else { -1.5 };
        let eye = DVec3::new(6.0 * a.cos(), up, 6.0 * a.sin());
        Camera::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, 0.8, [800, 800])
    };
    Views { cameras: (0..12).map(at).collect(), near: 0.2, everywhere: true }
}

fn distilled(teacher: &Scene, error_px: f64, max_superpoints: usize) -> Distilled {
    let mut place = |t: f64| freeze(teacher, t, MotionSource::Auto);
    let options = Options { error_px, max_superpoints };
    let found = distill(teacher, &mut place, &views(), &options, &mut |_, _, _| {}).unwrap();
    found.scene.deformation.check(found.scene.gaussians.len()).unwrap();
    found
}

/// Gaussians at these places, each with a superpoint of its own that moves as `pose` (of its index and the time) says.
fn one_pose_each(means: &[DVec3], scale: f32, keys: usize, pose: impl Fn(usize, f64) -> Frame) -> Scene {
    let mut random = Random::new(9);
    let n = means.len();
    let mut scene = crate::scene::synthetic::random_scene(n, 1, 0);
    let g = &mut scene.gaussians;
    g.opacity_logit.fill(1.0);
    let mut motion = Motion { times: (0..keys).map(|k| k as f32 / (keys - 1) as f32).collect(), ..Motion::default() };
    for (i, mean) in means.iter().enumerate() {
        g.mean[i] = mean.as_vec3().to_array();
        g.log_scale[i] = [1.0, 0.6, 0.3].map(|s: f32| (s * scale * random.range(0.5, 1.0) as f32).ln());
    }
    let mut last = vec![DVec3::ZERO; n];
    for &t in &motion.times {
        for (i, last) in last.iter_mut().enumerate() {
            let frame = pose(i, t.into());
            *last = crate::edit::unwrapped(DQuat::from_mat3(&frame.turn), *last);
            motion.rotation.push(last.as_vec3().to_array());
            motion.translation.push(frame.shift.as_vec3().to_array());
        }
    }
    let position = g.mean.clone();
    let superpoints = Superpoints { of_gaussian: (0..n as u32).collect(), position };
    scene.deformation = SuperpointDeformation::of_table(superpoints, motion).into();
    scene
}

/// A turn of `r` about a point that moves by `shift`.
fn about(center: DVec3, r: DVec3, shift: DVec3) -> Frame {
    let turn = crate::reference::exp(r);
    Frame { turn, shift: center + shift - turn * center }
}

/// B bodies of different sizes that overlap, each with its own motion; which is whose.
fn bodies(b: usize, n: usize, seed: u64) -> (Scene, Vec<u32>) {
    let mut random = Random::new(seed);
    let centers: Vec<DVec3> = (0..b).map(|_| 0.9 * random.direction()).collect();
    let turns: Vec<DVec3> = (0..b).map(|_| random.range(0.8, 4.0) * random.direction()).collect();
    let drifts: Vec<DVec3> = (0..b).map(|_| 0.4 * random.direction()).collect();
    let group: Vec<u32> = (0..n).map(|i| if i < 4 * b { (i % b) as u32 } else { random.below(b) as u32 }).collect();
    let means: Vec<DVec3> = group.iter().map(|&j| centers[j as usize] + 0.35 * random.normal3()).collect();
    let pose = |i: usize, t: f64| {
        let j = group[i] as usize;
        about(centers[j], turns[j] * t, drifts[j] * (3.0 * t).sin())
    };
    (one_pose_each(&means, 0.02, 33, pose), group)
}

#[test]
fn rigid_bodies_are_found_again() {
    for (b, n, seed) in [(2, 300, 1), (5, 1000, 2), (12, 3000, 3)] {
        let (teacher, group) = bodies(b, n, seed);
        let Distilled { scene, report, .. } = distilled(&teacher, 0.25, 2048);
        assert_eq!(scene.deformation.superpoint_count(), b, "{report:?}");
        let index = adjusted_rand(&group, scene.deformation.superpoint_of_gaussian());
        assert!(index == 1.0, "{b} bodies: adjusted Rand index {index}");
        assert!(report.at_keys_px < 1e-3, "{b} bodies: {report:?}");
        assert!(report.is_within() && !report.capped && report.above == 0, "{report:?}");
    }
}

/// A bar along x from −1 to 1 that bends into an arc, so thick.
fn beam(n: usize, thick: f64) -> Scene {
    let mut random = Random::new(5);
    let along = |i: usize| 2.0 * (i as f64 + 0.5) / n as f64 - 1.0;
    let means: Vec<DVec3> = (0..n)
        .map(|i| DVec3::new(along(i), thick * random.range(-1.0, 1.0), thick * random.range(-1.0, 1.0)))
        .collect();
    let pose = |i: usize, t: f64| {
        let bend = 1.2 * t + 1e-9;
        let s = along(i);
        let to = DVec3::new((bend * s).sin() / bend, (1.0 - (bend * s).cos()) / bend, 0.0);
        let at = DVec3::X * s;
        about(at, DVec3::Z * (bend * s), to - at)
    };
    one_pose_each(&means, 0.1 * thick as f32, 9, pose)
}

#[test]
fn the_residual_of_a_bending_beam_falls_with_the_square_of_its_parts() {
    // Of a thick one the strain falls with their number.
    let teacher = beam(1200, 1e-4);
    let errors: Vec<f64> = [4, 8, 16, 32]
        .map(|m| {
            let Distilled { scene, report, .. } = distilled(&teacher, 1e-3, m);
            assert!(scene.deformation.superpoint_count() <= m && report.capped && report.above > 0, "{report:?}");
            assert!(report.error_px.largest <= 1.5 * report.error_px.q999.max(report.at_keys_px), "{report:?}");
            report.error_px.largest
        })
        .to_vec();
    for (k, pair) in errors.windows(2).enumerate() {
        let ratio = pair[0] / pair[1];
        assert!((2.8..5.5).contains(&ratio), "{} to {} parts: {errors:?}", 4 << k, 8 << k);
    }
    let all = errors[0] / errors[3];
    assert!((40.0..100.0).contains(&all), "8 times as many parts: {errors:?}");
}

#[test]
fn the_measured_error_stays_within_any_bound() {
    let network = {
        let mut scene = moving_scene(100, 6, 7, 3, true);
        // Network F plays.
        scene.deformation.superpoint_deformation_mut().unwrap().table = None;
        scene.deformation.network_mut().unwrap().translation.weight.iter_mut().for_each(|w| *w *= 6.0);
        scene
    };
    let soft = {
        let mut scene = moving_scene(150, 5, 7, 4, false);
        let blend = random_blend(150, 5, 3, 11);
        let s = scene.deformation.superpoint_deformation_mut().unwrap();
        (s.superpoints.of_gaussian, s.blend) = (blend.of_gaussian(), Some(blend));
        scene
    };
    let nonrigid = {
        let mut scene = moving_scene(80, 4, 7, 6, false);
        let mut g = NonrigidNetwork::init(4);
        let mut random = Random::new(2);
        g.translation.weight.iter_mut().for_each(|w| *w = 2e-5 * random.normal() as f32);
        g.scaling.weight.iter_mut().for_each(|w| *w = 2e-5 * random.normal() as f32);
        scene.deformation = std::mem::take(&mut scene.deformation).with_nonrigid(g).unwrap();
        scene
    };
    for (name, teacher) in [("beam", beam(200, 0.03)), ("F", network), ("soft", soft), ("G", nonrigid)] {
        let mut before = usize::MAX;
        for error_px in [0.05, 0.25, 1.0, 4.0, 60.0] {
            let Distilled { scene, report, .. } = distilled(&teacher, error_px, 100_000);
            assert!(report.is_within() && !report.capped && report.above == 0, "{name} within {error_px}: {report:?}");
            let again = look(&teacher, &scene);
            assert!(again <= 1.02 * error_px, "{name} within {error_px}: {again} px between all times");
            let count = scene.deformation.superpoint_count();
            assert!(
                count as f64 <= 1.1 * before as f64 + 2.0,
                "{name}: {count} superpoints within {error_px}, {before} before"
            );
            before = count;
            assert_eq!(report.size_change.is_some(), name == "G");
        }
        let Distilled { scene, report, .. } = distilled(&teacher, 0.01, 3);
        assert!(
            scene.deformation.superpoint_count() <= 3 && report.capped && !report.is_within(),
            "{name}: {report:?}"
        );
        assert!(look(&teacher, &scene) <= 1.1 * report.error_px.largest, "{name}: {report:?}");
        assert_eq!(report.soft > 0, scene.deformation.blend().is_some());
    }
}

/// Largest displacement of centres at other times than those that were looked at, pixels.
fn look(teacher: &Scene, student: &Scene) -> f64 {
    let views = views();
    let at = |k: usize| {
        let time = (k as f64 + 0.31) / 57.0;
        let [a, b] = [teacher, student].map(|s| place_scene(s, time, MotionSource::Auto).unwrap().mean);
        // The student lacks what is not drawn.
        let kept = visible(&teacher.gaussians);
        kept.iter().zip(&b).map(|(&i, b)| views.displacement(a[i], *b)).fold(0.0, f64::max)
    };
    (0..57).map(at).fold(0.0, f64::max)
}

#[test]
fn blends_follow_what_few_rigid_parts_do_not() {
    // The number of parts is given; then the bend between their motions is blended.
    let teacher = beam(600, 0.01);
    let Distilled { scene, report, .. } = distilled(&teacher, 0.02, 12);
    let blend = scene.deformation.blend().unwrap();
    assert!(report.capped && report.soft > 300 && blend.soft_count() == report.soft, "{report:?}");
    assert!(blend.levels().is_some(), "weights as bytes");
    // The same parts without a blend.
    let mut hard = scene.clone();
    hard.deformation.superpoint_deformation_mut().unwrap().blend = None;
    let [with, without] = [&scene, &hard].map(|s| mean_look(&teacher, s));
    assert!(with < 0.7 * without, "{with} px on average with a blend, {without} without");
}

/// Mean displacement of centres at some times, pixels.
fn mean_look(teacher: &Scene, student: &Scene) -> f64 {
    let views = views();
    let at = |k: usize| {
        let time = (k as f64 + 0.31) / 9.0;
        let [a, b] = [teacher, student].map(|s| place_scene(s, time, MotionSource::Auto).unwrap().mean);
        a.iter().zip(&b).map(|(a, b)| views.displacement(*a, *b)).sum::<f64>() / a.len() as f64
    };
    (0..9).map(at).sum::<f64>() / 9.0
}

#[test]
fn spins_beyond_whole_turns_stay_spins() {
    let mut random = Random::new(8);
    let means: Vec<DVec3> = (0..200).map(|i| DVec3::X * (0.3 * f64::from(i % 2)) + 0.2 * random.normal3()).collect();
    let axis = [DVec3::new(0.2, 1.0, 0.1).normalize(), DVec3::new(1.0, -1.0, 0.4).normalize()];
    let pose = |i: usize, t: f64| {
        let center = DVec3::X * (0.3 * (i % 2) as f64);
        about(center, axis[i % 2] * ([1.5, -2.2][i % 2] * std::f64::consts::TAU * t), DVec3::ZERO)
    };
    let teacher = one_pose_each(&means, 0.02, 129, pose);
    let Distilled { scene, report, .. } = distilled(&teacher, 0.25, 64);
    assert_eq!(scene.deformation.superpoint_count(), 2, "{report:?}");
    assert!(report.is_within(), "{report:?}");
    let table = scene.deformation.table().unwrap();
    let last = table.rotation[table.rotation.len() - 2..].iter().map(|r| DVec3::from_array(r.map(f64::from)).length());
    let turned = last.fold(0.0, f64::max);
    assert!(turned > 2.0 * std::f64::consts::PI, "{turned} rad from the middle to the end");
    assert!(look(&teacher, &scene) < 0.5, "{}", look(&teacher, &scene));
}

#[test]
fn flat_thin_and_tiny_sets_are_bodies_too() {
    let mut random = Random::new(12);
    // On a plane, on a line, all in one place, and one Gaussian alone; of tiny Gaussians.
    let shape = [DVec3::new(0.4, 0.0, 0.4), DVec3::X * 0.5, DVec3::splat(1e-7), DVec3::ZERO];
    let centers = [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::ONE];
    let group: Vec<u32> = (0..400).map(|i| if i == 0 { 3 } else { i % 3 }).collect();
    let means: Vec<DVec3> = group.iter().map(|&j| centers[j as usize] + shape[j as usize] * random.normal3()).collect();
    let turns = [DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::Z, DVec3::Y];
    let pose = |i: usize, t: f64| {
        let j = group[i] as usize;
        about(centers[j], 2.0 * t * turns[j], 0.3 * t * turns[(j + 1) % 4])
    };
    for scale in [0.01, 1e-5] {
        let teacher = one_pose_each(&means, scale, 17, pose);
        let Distilled { scene, report, .. } = distilled(&teacher, 0.25, 64);
        assert_eq!(scene.deformation.superpoint_count(), 4, "{report:?}");
        let index = adjusted_rand(&group, scene.deformation.superpoint_of_gaussian());
        assert!(index == 1.0 && report.at_keys_px < 2e-3 && report.is_within(), "{index} {report:?}");
        assert_eq!(report.singletons, 1);
        // Also the turn around a line, which only its Gaussians show.
        assert!(report.rotation_degrees.largest < 1.0, "{report:?}");
    }
}

#[test]
fn what_rests_stays_and_what_is_not_drawn_goes() {
    let (mut teacher, _) = bodies(3, 600, 4);
    let table = teacher.deformation.table_mut().unwrap();
    let m = 600;
    for k in 0..table.times.len() {
        for i in (0..m).step_by(2) {
            (table.rotation[k * m + i], table.translation[k * m + i]) = ([0.0; 3], [0.0; 3]);
        }
    }
    teacher.gaussians.opacity_logit[7] = -9.0;
    let Distilled { scene, report, .. } = distilled(&teacher, 0.25, 2048);
    assert_eq!((report.gaussians, report.still), ([600, 599], 300), "{report:?}");
    assert_eq!(scene.deformation.superpoint_count(), 4, "{report:?}");
    assert!(report.dropped.iter().any(|d| d.contains("1 Gaussians with an opacity")), "{report:?}");
    assert!(scene.gaussians.mean[2] == teacher.gaussians.mean[2]);
    // Nothing moves enough.
    let Distilled { scene, report, .. } = distilled(&teacher, 1e5, 2048);
    assert!(!scene.deformation.moves() && report.is_within() && report.still == 599, "{report:?}");
}

#[test]
fn lifespans_stay_and_the_same_input_gives_the_same_bits() {
    let (mut teacher, _) = bodies(3, 500, 6);
    teacher.gaussians.optional = crate::scene::synthetic::random_optional(500, 3);
    let [one, two] = [0, 1].map(|_| distilled(&teacher, 0.25, 2048).scene);
    assert!(one == two);
    assert!(one.gaussians.optional == teacher.gaussians.optional && !one.gaussians.optional.is_empty());
}

#[test]
fn mistakes_are_named() {
    let (teacher, _) = bodies(2, 50, 1);
    let error = |teacher: &Scene, views: &Views<Camera>, options: Options, nan: bool| {
        let mut place = |t: f64| {
            let mut g = freeze(teacher, t, MotionSource::Auto)?;
            if nan && t > 0.4 {
                g.mean[3][1] = f32::NAN;
            }
            Ok(g)
        };
        distill(teacher, &mut place, views, &options, &mut |_, _, _| {}).unwrap_err().to_string()
    };
    let fine = Options::default();
    let none = Views { cameras: Vec::new(), ..views() };
    let still = Scene { gaussians: teacher.gaussians.clone(), ..Scene::default() };
    for (text, word) in [
        (error(&still, &views(), fine, false), "does not move"),
        (error(&teacher, &none, fine, false), "cameras"),
        (error(&teacher, &views(), Options { error_px: f64::NAN, ..fine }, false), "pixels above 0"),
        (error(&teacher, &views(), Options { max_superpoints: 0, ..fine }, false), "one or more"),
        (error(&teacher, &views(), fine, true), "Gaussian 3 is moved to no finite place"),
    ] {
        assert!(text.contains(word), "{text}");
    }
}

#[test]
fn many_gaussians_do_not_take_long() {
    let (teacher, group) = bodies(40, 4_000, 7);
    let Distilled { scene, report, .. } = distilled(&teacher, 0.25, 2048);
    let index = adjusted_rand(&group, scene.deformation.superpoint_of_gaussian());
    assert!(index > 0.999 && report.is_within(), "{index} {report:?}");
}
