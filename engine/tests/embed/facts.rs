//! What a host can ask a scene.

use engine::file::{self, Output};
use engine::render::{SceneHandle, SceneOptions};
use engine::scene::MotionSource;
use engine::scene::synthetic::{demo_scene, moving_scene, random_scene};

use super::*;

#[test]
fn what_was_dropped_on_reading_is_counted_and_told() {
    let host = Host::new();
    let mut scene = random_scene(200, 5, 1);
    (0..4).for_each(|i| scene.gaussians.mean[i * 9][1] = f32::NAN);
    (0..3).for_each(|i| scene.gaussians.rotation[100 + i] = [0.0; 4]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.ply");
    file::save_as(&path, &scene, Output::Ply).unwrap();
    let options = SceneOptions::default();
    let from_file = SceneHandle::load_file(host.gpu(), &path, &options).finish().unwrap();
    let uploaded = SceneHandle::upload(host.gpu(), &scene, &options).unwrap();
    for handle in [&from_file, &uploaded] {
        assert_eq!(handle.gaussians(), 200);
        assert_eq!((handle.rejected().not_finite, handle.rejected().zero_rotation), (4, 3));
        assert_eq!(handle.rejected().total(), 7);
    }
    assert_eq!(from_file.warnings().len(), 1);
    assert!(from_file.warnings()[0].contains("7 of 200 Gaussians are skipped"), "{:?}", from_file.warnings());
    assert!(uploaded.warnings().is_empty());
    let error = SceneHandle::load_file(host.gpu(), "/no/such/model.ply", &options).finish().unwrap_err();
    assert!(error.exit_code() == 3 && error.to_string().contains("/no/such/model.ply"), "{error}");
}

#[test]
fn time_place_and_motion_of_a_scene() {
    let host = Host::new();
    let upload = |scene: &engine::scene::Scene, motion| {
        SceneHandle::upload(host.gpu(), scene, &SceneOptions { motion, ..SceneOptions::default() }).unwrap()
    };
    let still = upload(&random_scene(50, 5, 0), MotionSource::Auto);
    assert_eq!((still.extent().times, still.motion(), still.one_after_another()), ([0.0; 2], None, false));

    let demo = demo_scene();
    let keys = demo.deformation.key_times().to_vec();
    let moving = upload(&demo, MotionSource::Auto);
    let ends = [keys[0], keys[keys.len() - 1]].map(f64::from);
    assert_eq!((moving.extent().times, moving.motion()), (ends, Some(MotionSource::Table)));
    let (center, radius) = (moving.extent().center, moving.extent().radius);
    assert!(center.is_finite() && center.length() < 2.0 && radius > 0.1 && radius < 5.0, "{center} {radius}");

    // Far away, where poses come from the host.
    let mut far = demo;
    far.gaussians.mean.iter_mut().for_each(|m| m[0] += 1.0e5);
    let motion = far.deformation.table_mut().unwrap();
    motion.rotation.iter_mut().for_each(|r| *r = [0.0; 3]);
    let there = upload(&far, MotionSource::Auto);
    assert_eq!(there.extent().times, ends);
    assert!((there.extent().center.x - 1.0e5).abs() < 5.0, "{}", there.extent().center);

    let network = upload(&moving_scene(60, 4, 5, 3, true), MotionSource::Network);
    assert_eq!((network.extent().times, network.motion()), ([0.0, 1.0], Some(MotionSource::Network)));
    assert!(network.one_after_another());
}
