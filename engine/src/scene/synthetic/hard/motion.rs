//! Hard cases of superpoint motion.

use glam::{DQuat, DVec3};

use super::HardCase;
use super::build::{case, cloud, look};
use crate::scene::synthetic::{moving_scene, random_network};
use crate::scene::{Camera, Gaussians, Motion, Scene, SuperpointDeformation, Superpoints};

/// A cloud whose Gaussians are dealt round-robin to `m` superpoints with the given motion.
fn moving(n: usize, groups: &[u32], motion: Motion) -> Scene {
    let m = motion.superpoint_count();
    let of_gaussian = (0..n).map(|i| groups[i % groups.len()]).collect();
    let superpoints = Superpoints { of_gaussian, position: vec![[0.0; 3]; m] };
    Scene {
        gaussians: cloud(n, 70),
        deformation: SuperpointDeformation::of_table(superpoints, motion).into(),
        ..Scene::default()
    }
}

/// A scene of superpoints with something of them changed.
fn changed(mut scene: Scene, change: impl FnOnce(&mut SuperpointDeformation)) -> Scene {
    scene.deformation.superpoint_deformation_mut().map(change);
    scene
}

/// The table of one superpoint with rotation vectors about `axis` of the given angles, one per key time 0, 1, 2, ….
fn turning(axis: [f32; 3], angles: &[f32]) -> Motion {
    Motion {
        times: (0..angles.len()).map(|k| k as f32).collect(),
        rotation: angles.iter().map(|a| axis.map(|x| a * x)).collect(),
        translation: vec![[0.0; 3]; angles.len()],
    }
}

fn at(name: &'static str, doc: &'static str, scene: Scene, time: f64) -> HardCase {
    HardCase { scene, time, ..case(name, doc, Gaussians::default(), look(64, 64)) }
}

pub(super) fn cases() -> Vec<HardCase> {
    let axis = [0.48, -0.6, 0.64];
    let tiny = [0.0, f32::MIN_POSITIVE, 1.0e-20, 1.0e-12, 1.0e-7, 1.0e-4, 1.0e-2];
    let spread = |angles: &[f32]| Motion { times: vec![0.0], ..turning(axis, angles) };
    let one = |angles: &[f32]| moving(300, &[0], turning(axis, angles));
    let table = moving_scene(300, 6, 5, 71, false);
    let single = moving_scene(300, 6, 1, 72, false);
    let with_network = changed(moving_scene(300, 6, 2, 73, true), |d| d.table = None);
    let unused_network = changed(table.clone(), |d| d.network = Some(random_network(9)));
    vec![
        at(
            "rotation_across_pi",
            "Key rotations of 3.0 and 3.3 rad: the angle passes π between them.",
            one(&[3.0, 3.3]),
            0.5,
        ),
        at(
            "rotation_flips_at_pi",
            "Keys 3.1 and -3.1 rad are almost the same rotation, but r is interpolated, through 0.",
            one(&[3.1, -3.1]),
            0.4,
        ),
        at("rotation_many_turns", "Rotation vectors of several turns.", one(&[20.0, 26.0]), 0.7),
        at(
            "rotation_tiny",
            "Angles from 0 over the smallest normal number to 0.01 rad.",
            moving(300, &[0, 1, 2, 3, 4, 5, 6], spread(&tiny)),
            0.0,
        ),
        at("time_before_first_key", "The pose is held before the first key time.", table.clone(), -3.0),
        at("time_at_first_key", "Exactly the first key time.", table.clone(), 0.0),
        at("time_at_inner_key", "Exactly a key time inside the table.", table.clone(), 0.25),
        at("time_at_last_key", "Exactly the last key time.", table.clone(), 1.0),
        at("time_after_last_key", "The pose is held after the last key time.", table, 1.0e30),
        at("single_key_time", "A table of one key time.", single, 0.6),
        at(
            "empty_superpoint",
            "Superpoints 1 and 3 have no Gaussians.",
            moving(300, &[0, 2, 4], spread(&[0.1, 9.0, 0.2, 9.0, 0.3])),
            0.0,
        ),
        at("one_superpoint", "One superpoint moves everything.", one(&[0.2, 0.9]), 0.5),
        at(
            "more_superpoints_than_gaussians",
            "Seven superpoints, three Gaussians.",
            moving(3, &[6, 0, 3], spread(&tiny)),
            0.0,
        ),
        at("network_only", "Network F moves a scene without a table.", with_network, 0.35),
        at("table_beats_network", "With both, the table is used.", unused_network, 0.35),
        far_away(),
    ]
}

/// A moving town, two kilometres wide, a million units from the origin about which it turns.
fn far_away() -> HardCase {
    let offset = DVec3::new(1.0e6, -1.0e6, 1.0e6);
    let mut scene = moving(400, &[0], turning([0.0, 0.0, 1.0], &[0.0, 0.002]));
    for (mean, scale) in scene.gaussians.mean.iter_mut().zip(&mut scene.gaussians.log_scale) {
        *mean = std::array::from_fn(|k| 1000.0 * mean[k] + offset[k] as f32);
        *scale = scale.map(|s| s + 1000.0f32.ln());
    }
    let turned = DQuat::from_rotation_z(0.001) * offset;
    let camera = look(64, 64);
    let camera = Camera { position: 1000.0 * camera.position + turned, ..camera };
    let doc = "Everything moves about an origin a million units away.";
    HardCase { camera, ..at("world_offset_1e6_moving", doc, scene, 0.5) }
}
