#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::*;
use crate::scene::synthetic::{Random, hard_cases, moving_scene, random_gaussians, random_scene};
use crate::scene::{Blend, Motion, SuperpointDeformation, Superpoints};

/// The definition, word for word: at every pixel, every Gaussian.
fn brute_force(splats: &[Splat], camera: &Camera, background: [f64; 3]) -> ReferenceImage {
    let mut image = ReferenceImage { width: camera.width, height: camera.height, ..ReferenceImage::default() };
    for j in 0..camera.height {
        for i in 0..camera.width {
            let (mut t, mut color, mut depth) = (1.0, [0.0; 3], 0.0);
            for splat in splats {
                let alpha = splat.alpha(DVec2::new(f64::from(i) + 0.5, f64::from(j) + 0.5));
                if alpha >= 1.0 / 255.0 {
                    if t * (1.0 - alpha) < 1.0e-4 {
                        break;
                    }
                    let weight = alpha * t;
                    (0..3).for_each(|c| color[c] += weight * splat.color[c]);
                    depth += weight * splat.depth;
                    t *= 1.0 - alpha;
                }
            }
            image.rgb.extend((0..3).map(|c| color[c] + t * background[c]));
            image.alpha.push(1.0 - t);
            image.depth.push(depth);
        }
    }
    image
}

fn assert_same_as_brute_force(scene: &Scene, camera: &Camera, time: f64, options: &ReferenceOptions) {
    let parameters = Parameters::from(&scene.gaussians);
    let poses = poses(scene, time, options.motion).unwrap();
    let placed = place(&parameters, scene.deformation.superpoints(), poses.as_deref()).unwrap();
    let valid: Vec<bool> =
        (0..scene.gaussians.len()).map(|i| scene.gaussians.is_valid(i, &mut Rejected::default())).collect();
    let splats = sorted_splats(&parameters, &placed, &valid, camera, options);
    let expected = brute_force(&splats, camera, options.background);
    let found = render(scene, camera, time, options).unwrap();
    assert!(found.rgb == expected.rgb && found.alpha == expected.alpha && found.depth == expected.depth);
}

fn camera(width: u32, height: u32) -> Camera {
    Camera::look_at(DVec3::new(2.2, 1.4, 0.9), DVec3::ZERO, DVec3::Z, 0.8, [width, height])
}

/// A scene with lifespans, and the same made to stand still at a time, are one image; at other times they are not.
#[test]
fn a_moment_of_lifespans_is_frozen_in_the_opacity() {
    let mut gaussians = random_gaussians(60, 4, 1);
    gaussians.optional = crate::scene::synthetic::random_optional(60, 5);
    let scene = Scene { gaussians, ..Scene::default() };
    let camera = Camera::look_at(DVec3::new(0.3, -0.4, -3.5), DVec3::ZERO, DVec3::NEG_Y, 0.8, [24, 18]);
    let image = |scene: &Scene, time: f64| render(scene, &camera, time, &ReferenceOptions::default()).unwrap().rgb;
    let frozen = freeze(&scene, 0.2, MotionSource::Auto).unwrap();
    assert!(frozen.optional.is_empty() && scene.is_dynamic());
    let still = Scene { gaussians: frozen, ..Scene::default() };
    let largest = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // The opacity is rounded to f32.
    assert!(largest(image(&scene, 0.2), image(&still, 0.7)) < 1e-5);
    assert!(largest(image(&scene, 0.9), image(&still, 0.9)) > 1e-2);
}

#[test]
fn intervals_and_bands_change_nothing() {
    for (seed, (width, height)) in [(48, 40), (1, 1), (1, 17), (33, 7), (20, 65)].into_iter().enumerate() {
        let options = ReferenceOptions { background: [0.1, 0.2, 0.3], ..ReferenceOptions::default() };
        let scene = moving_scene(400, 5, 4, seed as u64, false);
        assert_same_as_brute_force(&scene, &camera(width, height), 0.37, &options);
    }
}

#[test]
fn intervals_change_nothing_for_wild_shapes() {
    let mut random = Random::new(11);
    for seed in 0..12 {
        let mut scene = random_scene(60, seed, 1);
        for scale in &mut scene.gaussians.log_scale {
            *scale = std::array::from_fn(|_| random.range(-14.0, 6.0) as f32);
        }
        for logit in &mut scene.gaussians.opacity_logit {
            *logit = random.range(-6.0, 12.0) as f32;
        }
        let options = ReferenceOptions { near: 0.01, ..ReferenceOptions::default() };
        assert_same_as_brute_force(&scene, &camera(37, 29), 0.0, &options);
    }
}

#[test]
fn hard_cases_equal_brute_force_where_small() {
    let mut compared = 0;
    for case in hard_cases() {
        let pixels = case.camera.width as usize * case.camera.height as usize;
        if pixels * case.scene.gaussians.len() <= 2_000_000 {
            assert_same_as_brute_force(&case.scene, &case.camera, case.time, &ReferenceOptions::from(&case));
            compared += 1;
        }
    }
    assert!(compared >= 20, "{compared}");
}

#[test]
fn hard_cases_render_finite_images_with_the_expected_rejects() {
    for case in hard_cases() {
        let image = render(&case.scene, &case.camera, case.time, &ReferenceOptions::from(&case)).unwrap();
        assert!(image.rgb.iter().chain(&image.alpha).chain(&image.depth).all(|x| x.is_finite()), "{}", case.name);
        assert_eq!(image.rejected.total(), case.rejected, "{}", case.name);
        let covered = image.alpha.iter().any(|&a| a > 0.0);
        assert_eq!(covered, !case.empty, "{}: anything to see", case.name);
    }
}

#[test]
fn the_clamp_case_holds_pixels_exactly_at_the_stop_threshold() {
    let case = hard_cases().into_iter().find(|case| case.name == "alpha_clamp").unwrap();
    let image = render(&case.scene, &case.camera, case.time, &ReferenceOptions::from(&case)).unwrap();
    let at_threshold = image.alpha.iter().filter(|&&a| (1.0 - a - 1.0e-4).abs() < 1.0e-12).count();
    assert!(at_threshold >= 10, "{at_threshold}");
}

/// One pixel in front of which everything is known in closed form.
#[test]
fn one_gaussian_by_hand() {
    let scene = Scene {
        gaussians: Gaussians {
            mean: vec![[0.0, 0.0, 2.0]],
            log_scale: vec![[0.1f32.ln(), 0.2f32.ln(), -3.0]],
            rotation: vec![[2.0, 0.0, 0.0, 0.0]],
            opacity_logit: vec![0.0],
            sh_degree: 0,
            sh: vec![1.0, -0.5, -5.0],
            ..Gaussians::default()
        },
        ..Scene::default()
    };
    let mut camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 1.0, [8, 8]);
    (camera.fx, camera.fy, camera.cx, camera.cy) = (10.0, 20.0, 4.5, 3.5);
    let options = ReferenceOptions { background: [0.0, 0.0, 1.0], ..ReferenceOptions::default() };
    let image = render(&scene, &camera, 0.0, &options).unwrap();
    let scale = |s: f32| f64::from(s.ln()).exp();
    let (a, c) = ((scale(0.1) * 5.0).powi(2) + 0.3, (scale(0.2) * 10.0).powi(2) + 0.3);
    for (i, j) in [(4, 3), (5, 3), (2, 3), (4, 6), (6, 1)] {
        let (dx, dy) = (f64::from(i) + 0.5 - 4.5, f64::from(j) + 0.5 - 3.5);
        let alpha = 0.5 * (-0.5 * (dx * dx / a + dy * dy / c)).exp();
        let alpha = if alpha < 1.0 / 255.0 { 0.0 } else { alpha };
        let pixel = (j * 8 + i) as usize;
        let red = alpha * (0.5 + 0.282_094_791_773_878_14);
        let green = alpha * (0.5 - 0.5 * 0.282_094_791_773_878_14);
        let found = [image.rgb[3 * pixel], image.rgb[3 * pixel + 1], image.rgb[3 * pixel + 2]];
        for (found, expected) in found.iter().zip([red, green, 1.0 - alpha]) {
            assert!((found - expected).abs() < 1.0e-14, "{i} {j}: {found} {expected}");
        }
        assert!((image.depth[pixel] - 2.0 * alpha).abs() < 1.0e-14);
    }
    assert!(image.alpha.contains(&0.0), "the 1/255 threshold cuts something off");
}

#[test]
fn alpha_is_clamped_and_the_stop_rule_leaves_the_last_gaussian_out() {
    // Three opaque Gaussians on one pixel: T = 1 → 0.01 → would be 1e-4 (not below 1e-4 only by rounding) → stop.
    let layer = |z: f32| [0.0, 0.0, z];
    let gaussians = Gaussians {
        mean: vec![layer(3.0), layer(1.0), layer(2.0)],
        log_scale: vec![[0.0; 3]; 3],
        rotation: vec![[1.0, 0.0, 0.0, 0.0]; 3],
        opacity_logit: vec![f32::INFINITY; 3],
        sh_degree: 0,
        sh: [[9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 9.0]].concat(),
        ..Gaussians::default()
    };
    let scene = Scene { gaussians, ..Scene::default() };
    let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.1, [1, 1]);
    let image = render(&scene, &camera, 0.0, &ReferenceOptions::default()).unwrap();
    let t: f64 = 1.0 - 0.99;
    let blended = if t * (1.0 - 0.99) < 1.0e-4 { 1 } else { 2 };
    let expected = 1.0 - t.powi(blended);
    assert!((image.alpha[0] - expected).abs() < 1.0e-15, "{} {expected}", image.alpha[0]);
    let bright = 0.5 + 9.0 * 0.282_094_791_773_878_14;
    assert!((image.rgb[1] - (0.99 * bright + if blended == 2 { 0.0099 * 0.5 } else { 0.0 })).abs() < 1.0e-12);
}

#[test]
fn ties_in_depth_go_by_index() {
    let mut scene = random_scene(2, 1, 0);
    let g = &mut scene.gaussians;
    g.mean = vec![[0.0, 0.0, 1.0]; 2];
    g.log_scale = vec![[-1.0; 3]; 2];
    g.opacity_logit = vec![3.0; 2];
    g.sh = vec![9.0, 0.0, 0.0, 0.0, 9.0, 0.0];
    let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.5, [4, 4]);
    let image = render(&scene, &camera, 0.0, &ReferenceOptions::default()).unwrap();
    assert!(image.rgb.chunks(3).all(|p| p[0] > 2.0 * p[1]), "index 0 is in front");
    scene.gaussians.sh.rotate_left(3);
    let swapped = render(&scene, &camera, 0.0, &ReferenceOptions::default()).unwrap();
    assert!(swapped.rgb.chunks(3).all(|p| p[1] > 2.0 * p[0]));
}

#[test]
fn near_plane_is_exclusive() {
    let mut scene = random_scene(1, 1, 0);
    scene.gaussians.opacity_logit[0] = 2.0;
    let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.5, [4, 4]);
    let options = ReferenceOptions { near: 0.25, ..ReferenceOptions::default() };
    for (z, visible) in [(0.25f32, 0), (0.25f32.next_up(), 1), (0.25f32.next_down(), 0), (-1.0, 0)] {
        scene.gaussians.mean[0] = [0.0, 0.0, z];
        assert_eq!(render(&scene, &camera, 0.0, &options).unwrap().visible, visible, "z = {z}");
    }
}

#[test]
fn exponential_map() {
    let mut random = Random::new(3);
    for magnitude in [0.0, 1.0e-300, 1.0e-9, 9.9e-3, 1.01e-2, 0.5, PI, 3.0 * PI, 100.0] {
        let r = random.direction() * magnitude;
        let error = exp(r) - DMat3::from_quat(DQuat::from_scaled_axis(r));
        assert!(error.to_cols_array().iter().all(|e| e.abs() < 1.0e-14), "{magnitude}: {error}");
        let inverse = exp(r) * exp(-r) - DMat3::IDENTITY;
        assert!(inverse.to_cols_array().iter().all(|e| e.abs() < 1.0e-14), "{magnitude}");
    }
    // To first order Exp(r)x = x + r×x, also where θ² underflows.
    let tiny = DVec3::new(1.0e-200, 0.0, 0.0);
    assert_eq!((exp(tiny) * DVec3::Y).z, 1.0e-200);
}

#[test]
fn table_is_interpolated_inside_and_held_outside() {
    let motion = Motion {
        times: vec![0.5, 1.0, 3.0],
        rotation: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
        translation: vec![[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [4.0, 8.0, 0.0]],
    };
    let at = |t: f64| table_poses(&motion, t)[0];
    assert_eq!(at(-9.0), at(0.5));
    assert_eq!(at(0.5).translation, DVec3::X);
    assert_eq!(at(1.5).translation, DVec3::new(2.5, 2.0, 0.0));
    assert_eq!(at(1.5).rotation, DVec3::new(0.75, 0.5, 0.0));
    assert_eq!(at(3.0), at(1.0e30));
    assert_eq!(at(3.0).rotation, DVec3::new(0.0, 2.0, 0.0));
    assert_eq!(table_poses(&Motion { times: vec![0.0], ..motion.clone() }, 7.0).len(), 3);
    assert_eq!(table_poses(&Motion::default(), 0.0), []);
}

/// Superpoint 0 turns about z by `angle` and shifts along x; superpoint 1 turns by −`angle`.
fn soft_scene(angle: f32, weight: [f32; 2]) -> Scene {
    let mut scene = random_scene(50, 3, 0);
    let blend = Blend { neighbors: 2, index: [0, 1].repeat(50), weight: weight.repeat(50) };
    let table = Motion {
        times: vec![0.0],
        rotation: vec![[0.0, 0.0, angle], [0.0, 0.0, -angle]],
        translation: vec![[1.0, 0.0, 0.0], [0.0; 3]],
    };
    let superpoints = Superpoints { of_gaussian: blend.of_gaussian(), position: vec![[0.0; 3]; 2] };
    let motion = SuperpointDeformation { blend: Some(blend), ..SuperpointDeformation::of_table(superpoints, table) };
    scene.deformation = motion.into();
    scene
}

#[test]
fn soft_superpoints_by_hand() {
    // Weights 3 : 1 at ±1 radian: the quaternions' mean turns by 2·atan(½·tan ½).
    let small = 2.0 * (0.5 * 0.5_f64.tan()).atan();
    // At ±3 radians the second quaternion is on the other side of the first one's, and is turned round: (½cos, sin) of 1½.
    let large = 2.0 * 1.5_f64.sin().atan2(0.5 * 1.5_f64.cos());
    for (angle, expected) in [(1.0, small), (3.0, large)] {
        let scene = soft_scene(angle, [0.75, 0.25]);
        let placed = place_scene(&scene, 0.0, MotionSource::Auto).unwrap();
        let frozen = freeze(&scene, 0.0, MotionSource::Auto).unwrap();
        for (i, &mean) in scene.gaussians.mean.iter().enumerate() {
            let mean = DVec3::from(mean.map(f64::from));
            let turn = |a: f64| DMat3::from_rotation_z(a);
            let angle = f64::from(angle);
            let by_hand = 0.75 * (turn(angle) * mean + DVec3::X) + 0.25 * (turn(-angle) * mean);
            assert!((placed.mean[i] - by_hand).length() < 1e-12, "{} {by_hand}", placed.mean[i]);
            let own = rotation_of_quaternion(scene.gaussians.rotation[i].map(f64::from));
            let off = (placed.rotation[i] - turn(expected) * own).to_cols_array();
            assert!(off.iter().all(|x| x.abs() < 1e-12), "{angle}: {off:?}");
            assert_eq!(frozen.mean[i], placed.mean[i].as_vec3().to_array());
        }
    }
}

#[test]
fn weights_are_normalised_and_one_superpoint_stays_exact() {
    let place = |scene: &Scene| place_scene(scene, 0.0, MotionSource::Auto).unwrap();
    assert_eq!(place(&soft_scene(0.7, [6.0, 2.0])), place(&soft_scene(0.7, [0.75, 0.25])));
    for weight in [[0.3, 0.0], [0.0, 1e-30]] {
        let soft = soft_scene(0.7, weight);
        let mut hard = soft.clone();
        hard.deformation.superpoint_deformation_mut().unwrap().blend = None;
        assert_eq!(place(&soft), place(&hard), "{weight:?}");
    }
    let mut bad = soft_scene(0.7, [1.0, 1.0]);
    bad.deformation.superpoint_deformation_mut().unwrap().blend.as_mut().unwrap().index[3] = 2;
    let message = place_scene(&bad, 0.0, MotionSource::Auto).unwrap_err().to_string();
    assert!(message.contains("superpoints.blend_index") && message.contains("2 at element 3"), "{message}");
}

#[test]
fn moving_the_scene_rigidly_equals_moving_the_camera() {
    let still = random_scene(300, 9, 0);
    let superpoints = Superpoints { of_gaussian: vec![0; 300], position: vec![[0.0; 3]] };
    let table = Motion { times: vec![0.0], rotation: vec![[0.3, -0.2, 0.9]], translation: vec![[0.2, 0.1, -0.3]] };
    let moved = Scene { deformation: SuperpointDeformation::of_table(superpoints, table).into(), ..still.clone() };
    let f32_exact = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    let motion = moved.deformation.table().unwrap();
    let pose = Pose { rotation: f32_exact(motion.rotation[0]), translation: f32_exact(motion.translation[0]) };
    let camera = camera(40, 30);
    let turn = exp(pose.rotation);
    let other = Camera {
        rotation: camera.rotation * turn,
        position: turn.transpose() * (camera.position - pose.translation),
        ..camera.clone()
    };
    let options = ReferenceOptions::default();
    let a = render(&moved, &camera, 0.0, &options).unwrap();
    let b = render(&still, &other, 0.0, &options).unwrap();
    assert!(a.alpha.iter().any(|&a| a > 0.5));
    assert!(a.rgb.iter().zip(&b.rgb).all(|(a, b)| (a - b).abs() < 1.0e-11));
}

#[test]
fn a_camera_moved_by_whole_pixels_moves_the_image() {
    // Splats of at most 2 px: no Gaussian that reaches into the crop is beyond the crop's Jacobian clamp (2.5 px outside).
    let mut scene = random_scene(300, 4, 3);
    scene.gaussians.log_scale.fill([-4.6; 3]);
    let (whole, options) = (camera(40, 32), ReferenceOptions::default());
    let image = render(&scene, &whole, 0.0, &options).unwrap();
    let crop = Camera { width: 17, height: 17, cx: whole.cx - 9.0, cy: whole.cy - 5.0, ..whole };
    let part = render(&scene, &crop, 0.0, &options).unwrap();
    assert!(part.alpha.iter().filter(|&&a| a > 0.1).count() > 50);
    for i in 0..17 * 17 {
        let (x, y) = (9 + i % 17, 5 + i / 17);
        assert!((image.alpha[y * 40 + x] - part.alpha[i]).abs() < 1.0e-12, "{x} {y}");
    }
}

#[test]
fn malformed_scenes_are_refused() {
    let options = ReferenceOptions::default();
    let refused = |scene: &Scene, camera: &Camera| render(scene, camera, 0.0, &options).unwrap_err().exit_code() == 2;
    let good = moving_scene(10, 2, 2, 0, false);
    assert!(render(&good, &camera(4, 4), 0.0, &options).is_ok());
    assert!(refused(&good, &camera(0, 4)));
    let mut short = good.clone();
    short.gaussians.sh.pop();
    assert!(refused(&short, &camera(4, 4)));
    let mut lost = good.clone();
    lost.deformation.superpoints_mut().unwrap().of_gaussian[3] = 2;
    assert!(refused(&lost, &camera(4, 4)));
    let network = ReferenceOptions { motion: MotionSource::Network, ..options };
    assert_eq!(render(&good, &camera(4, 4), 0.0, &network).unwrap_err().exit_code(), 2);
}

#[test]
fn poisoned_gaussians_are_left_out_and_counted() {
    let clean = random_scene(50, 2, 1);
    let mut scene = clean.clone();
    let extra = random_gaussians(4, 3, 1);
    let g = &mut scene.gaussians;
    g.mean.extend(&extra.mean);
    g.log_scale.extend(&extra.log_scale);
    g.rotation.extend(&extra.rotation);
    g.opacity_logit.extend(&extra.opacity_logit);
    g.sh.extend(&extra.sh);
    g.mean[50][1] = f32::NAN;
    g.rotation[51] = [0.0; 4];
    g.log_scale[52][0] = 31.0;
    g.opacity_logit[53] = f32::NAN;
    let (camera, options) = (camera(20, 20), ReferenceOptions::default());
    let (a, b) = (render(&clean, &camera, 0.0, &options).unwrap(), render(&scene, &camera, 0.0, &options).unwrap());
    assert_eq!((a.rgb, 4), (b.rgb, b.rejected.total()));
}

#[test]
fn image_in_the_renderers_precision() {
    let image = render(&random_scene(50, 2, 1), &camera(6, 5), 0.0, &ReferenceOptions::default()).unwrap();
    let rounded = image.to_image();
    assert_eq!((rounded.rgba.len(), rounded.depth.len()), (6 * 5 * 4, 6 * 5));
    assert!(rounded.rgb().zip(&image.rgb).all(|(a, b)| a == f64::from(*b as f32)));
    assert!(rounded.rgba.chunks(4).zip(&image.alpha).all(|(p, a)| p[3] == *a as f32));
}
