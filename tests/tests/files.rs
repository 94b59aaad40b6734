//! Files from outside: real data sets, and the time that loading takes.
//!
//! Real data are found by the environment variable `SPGS_DATA`; without it those tests say so and pass.

use std::path::Path;
use std::time::Instant;

use engine::data::{CameraSet, load_cameras};
use engine::file::{self, model, picture, ply};
use engine::scene::{Gaussians, Rejected, Scene};
use glam::{DMat3, DVec3};
use tests_harness::data;

#[test]
fn trained_models_load_and_round_trip() {
    for (relative, count) in
        [("splats/inria_sh3_9k.ply", 9080), ("splats/fruit_drops_sh3_5k.ply", 4721), ("bench_s50k/model.ply", 50_000)]
    {
        let Some(path) = data(relative) else { continue };
        let begin = Instant::now();
        let loaded = file::load(&path).unwrap();
        println!("{relative}: {:?}, {:?}, warnings {:?}", begin.elapsed(), loaded.rejected, loaded.warnings);
        let g = &loaded.scene.gaussians;
        assert_eq!((g.len() + loaded.rejected.total(), g.sh_degree), (count, 3));
        let description = file::describe(&path).unwrap();
        println!("{description}");
        assert_eq!((description.gaussians, description.rejected), (count, loaded.rejected));

        let folder = tempfile::tempdir().unwrap();
        for name in ["copy.ply", "copy.safetensors"] {
            let copy = folder.path().join(name);
            assert!(file::save(&copy, &loaded.scene).unwrap().is_empty());
            let back = file::load(&copy).unwrap();
            assert_eq!((&back.scene.gaussians, back.rejected), (g, Rejected::default()));
        }
        // A file in the usual layout without extras comes back byte for byte.
        if relative.starts_with("bench") {
            let (a, b) = (std::fs::read(&path).unwrap(), std::fs::read(folder.path().join("copy.ply")).unwrap());
            assert!(a == b, "{relative} changed on a round trip");
        }
    }
}

fn assert_sane(set: &CameraSet, count: usize, size: [u32; 2]) {
    assert_eq!(set.cameras.len(), count, "{}", set.source);
    for camera in &set.cameras {
        assert_eq!([camera.width, camera.height], size, "{}", camera.name);
        let gram = camera.rotation.transpose() * camera.rotation - DMat3::IDENTITY;
        let error = gram.to_cols_array().iter().fold(0.0f64, |worst, v| worst.max(v.abs()));
        assert!(error < 1.0e-12 && (camera.rotation.determinant() - 1.0).abs() < 1.0e-12);
        assert!(camera.fx > 0.0 && camera.fy > 0.0 && (0.0..=1.0).contains(&camera.time), "{camera:?}");
    }
}

#[test]
fn dnerf_cameras_look_at_the_object() {
    let Some(path) = data("dnerf_lego") else { return };
    for (split, count) in [(None, 20), (Some("train"), 50), (Some("val"), 11)] {
        let set = load_cameras(&path, split, None).unwrap();
        assert!(set.warnings.is_empty(), "{:?}", set.warnings);
        assert_sane(&set, count, [800, 800]);
        for camera in &set.cameras {
            // The object is at the origin: in front of the camera, within the image.
            let p = camera.world_to_camera().transform_point3(DVec3::ZERO);
            let (x, y) = (camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy);
            assert!(p.z > 0.0 && (0.0..800.0).contains(&x) && (0.0..800.0).contains(&y), "{}: {x} {y}", camera.name);
            // The cameras stand upright on a world with z up: z points up in the image (−y).
            assert!((camera.rotation * DVec3::Z).y < 0.0, "{}", camera.name);
        }
    }
}

#[test]
fn other_camera_files_load() {
    if let Some(path) = data("dnerf_hook_cameras") {
        let message = load_cameras(&path, None, None).unwrap_err().to_string();
        assert!(message.contains("frame 0 key `w`: found no size and no image"), "{message}");
        assert_sane(&load_cameras(&path, None, Some([800, 800])).unwrap(), 20, [800, 800]);
        assert_matches_camera_list(&path, &load_cameras(&path, Some("train"), Some([800, 800])).unwrap());
    }
    for (folder, split, size) in [
        ("mujoco_collision", "train", [800, 800]),
        ("mujoco_collision", "test", [800, 800]),
        ("mujoco_deformation", "train", [800, 800]),
        ("robot_dance", "test", [400, 400]),
        ("bench_s50k", "train", [400, 400]),
    ] {
        let Some(path) = data(folder) else { continue };
        let set = load_cameras(&path, Some(split), None).unwrap();
        println!("{folder} {split}: {} cameras, {:?}", set.cameras.len(), set.warnings);
        let text = std::fs::read_to_string(path.join(format!("transforms_{split}.json"))).unwrap();
        assert_sane(&set, text.matches("\"transform_matrix\"").count(), size);
    }
    if let Some(path) = data("bench_s50k") {
        let set = load_cameras(&path, None, None).unwrap();
        assert!(set.warnings[0].contains("transforms_train.json"), "{:?}", set.warnings);
    }
}

/// `cameras.json` of 3DGS lists the same cameras: position, camera-to-world rotation (OpenCV) and focal length. It begins
/// with the 20 test cameras.
fn assert_matches_camera_list(folder: &Path, set: &CameraSet) {
    let text = std::fs::read(folder.join("cameras.json")).unwrap();
    let list: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let list = list.as_array().unwrap();
    let mut compared = 0;
    for camera in &set.cameras {
        let name = camera.name.trim_start_matches("./train/");
        let Some(entry) = list.iter().skip(20).find(|entry| entry["img_name"] == name) else { continue };
        let close = |a: f64, b: &serde_json::Value| (a - b.as_f64().unwrap()).abs() < 1.0e-5;
        for axis in 0..3 {
            assert!(close(camera.position[axis], &entry["position"][axis]), "{name}");
            // Row `axis` of camera-to-world is column `axis` of world-to-camera.
            assert!((0..3).all(|c| close(camera.rotation.col(axis)[c], &entry["rotation"][axis][c])), "{name}");
        }
        assert!((camera.fx - entry["fx"].as_f64().unwrap()).abs() < 1.0e-2);
        compared += 1;
    }
    println!("{compared} cameras agree with cameras.json");
    assert!(compared >= 50, "only {compared} cameras were compared");
}

#[test]
fn a_real_colmap_model_loads() {
    for relative in ["nerfies_capture1/colmap", "nerfies_capture1/colmap/sparse/0"] {
        let Some(path) = data(relative) else { continue };
        let set = load_cameras(&path, None, None).unwrap();
        println!("{relative}: {} cameras, {:?}", set.cameras.len(), set.warnings);
        assert_sane(&set, set.cameras.len(), [120, 214]);
        assert!(set.cameras.len() > 50 && set.warnings[0].contains("is distorted"), "{:?}", set.warnings);
        assert!(set.cameras.is_sorted_by(|a, b| a.name < b.name && a.time < b.time));
        let test = load_cameras(&path, Some("test"), None).unwrap();
        assert_eq!(test.cameras.len(), set.cameras.len().div_ceil(8));
        assert_eq!(test.cameras[1], set.cameras[8]);
    }
}

#[test]
fn real_pictures_are_read() {
    let Some(path) = data("dnerf_lego/test/r_000.png") else { return };
    let image = picture::read(&path).unwrap();
    assert_eq!((image.width, image.height, image.rgba.len()), (800, 800, 800 * 800 * 4));
    assert!(image.rgba.iter().all(|v| (0.0..=1.0).contains(v)) && image.rgba.contains(&1.0));
}

fn many(count: usize) -> Gaussians {
    let value = |i: usize| (i % 1000) as f32 * 1.0e-3;
    let triples = || (0..count).map(|i| [value(i), value(i + 1), value(i + 2)]).collect();
    Gaussians {
        mean: triples(),
        log_scale: triples(),
        rotation: vec![[1.0, 0.0, 0.0, 0.1]; count],
        opacity_logit: (0..count).map(value).collect(),
        sh_degree: 3,
        sh: (0..count * 48).map(value).collect(),
        ..Gaussians::default()
    }
}

/// Prints the times; the bound is loose enough for an unoptimised build on a busy machine.
#[test]
fn half_a_million_gaussians_load_quickly() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene { gaussians: many(500_000), ..Scene::default() };
    for name in ["big.ply", "big.safetensors"] {
        let path = folder.path().join(name);
        let begin = Instant::now();
        file::save(&path, &scene).unwrap();
        let saved = begin.elapsed();
        let begin = Instant::now();
        let read =
            if name.ends_with("ply") { ply::read(&path).unwrap() } else { model::read(&path).unwrap().0.gaussians };
        let parsed = begin.elapsed();
        let begin = Instant::now();
        let loaded = file::load(&path).unwrap();
        println!("{name}: saved in {saved:?}, read in {parsed:?}, loaded and checked in {:?}", begin.elapsed());
        assert!(read == loaded.scene.gaussians && read == scene.gaussians);
        assert!(parsed.as_secs() < 20, "{name} took {parsed:?}");
    }
}
