//! What C can ask a scene, and where it may be shown.

use std::ffi::{CStr, CString};
use std::path::Path;
use std::ptr::{null, null_mut};

use engine::file::{Output, save_as};
use engine::scene::synthetic::{demo_scene, random_scene};
use spgs::*;

use super::misuse::{Made, message};

/// A file with 7 Gaussians of 200 that cannot be shown.
fn flawed(folder: &Path) -> CString {
    let mut scene = random_scene(200, 5, 1);
    (0..7).for_each(|i| scene.gaussians.mean[i * 9][1] = f32::NAN);
    let path = folder.join("bad.ply");
    save_as(&path, &scene, Output::Ply).unwrap();
    CString::new(path.to_str().unwrap()).unwrap()
}

/// Both ways of loading.
unsafe fn loaded(gpu: *const spgs_gpu, path: &CStr) -> [*mut spgs_scene; 2] {
    let (mut scenes, mut loading) = ([null_mut(); 2], null_mut());
    unsafe {
        assert_eq!(spgs_scene_load(gpu, path.as_ptr(), null(), &raw mut scenes[0]), 0, "{}", message());
        assert_eq!(spgs_scene_load_async(gpu, path.as_ptr(), null(), &raw mut loading), 0, "{}", message());
        assert_eq!(spgs_loading_finish(loading, &raw mut scenes[1]), 0, "{}", message());
    }
    scenes
}

#[test]
fn what_was_skipped_is_counted_and_told() {
    let made = Made::new();
    let folder = tempfile::tempdir().unwrap();
    let path = flawed(folder.path());
    unsafe {
        for scene in loaded(made.gpu, &path) {
            let mut info = spgs_scene_info::default();
            assert_eq!(spgs_scene_get_info(scene, &raw mut info), 0);
            assert_eq!((info.gaussians, info.rejected), (200, 7));
            let (mut warnings, mut count) = (null(), 99);
            assert_eq!(spgs_scene_warnings(scene, &raw mut warnings, &raw mut count), 0);
            assert_eq!(count, 1);
            let warning = CStr::from_ptr(*warnings).to_str().unwrap();
            assert!(warning.contains("7 of 200 Gaussians are skipped"), "{warning}");
            spgs_scene_destroy(scene);
        }
        let (mut warnings, mut count) = (null(), 99);
        assert_eq!(spgs_scene_warnings(made.scene, &raw mut warnings, &raw mut count), 0);
        assert_eq!(count, 0);
        assert_eq!(spgs_scene_warnings(made.scene, null_mut(), &raw mut count), 2);
        assert_eq!(spgs_scene_warnings(null(), &raw mut warnings, &raw mut count), 2);
    }
}

#[test]
fn time_place_and_motion_are_told() {
    let made = Made::new();
    let folder = tempfile::tempdir().unwrap();
    let times = demo_scene().deformation.key_times().to_vec();
    unsafe {
        let mut extent = spgs_scene_extent::default();
        assert_eq!(spgs_scene_get_extent(made.scene, &raw mut extent), 0);
        let ends = [times[0], times[times.len() - 1]].map(f64::from);
        assert_eq!([extent.first_time, extent.last_time], ends);
        assert_eq!((extent.motion, extent.one_after_another), (1, 0));
        assert!(extent.radius > 0.1 && extent.radius < 5.0 && extent.center.iter().all(|c| c.abs() < 2.0));
        for scene in loaded(made.gpu, &flawed(folder.path())) {
            assert_eq!(spgs_scene_get_extent(scene, &raw mut extent), 0);
            assert_eq!((extent.first_time, extent.last_time, extent.motion), (0.0, 0.0, 0));
            assert!(extent.radius > 0.0 && extent.radius.is_finite());
            spgs_scene_destroy(scene);
        }
        assert_eq!(spgs_scene_get_extent(made.scene, null_mut()), 2);
        assert_eq!(spgs_scene_get_extent(null(), &raw mut extent), 2);
    }
}

#[test]
fn scenes_of_another_gpu_are_refused() {
    let [here, there] = [Made::new(), Made::new()];
    let mut view = null_mut();
    unsafe {
        assert_eq!(spgs_view_create(here.gpu, there.scene, null(), &raw mut view), 2);
        assert!(message().contains("scene of a view: found one of another gpu") && view.is_null(), "{}", message());
        assert_eq!(spgs_view_create(here.gpu, here.scene, null(), &raw mut view), 0);
        assert_eq!(spgs_view_set_scene(view, there.scene), 2);
        assert!(message().contains("scene of a view: found one of another gpu"), "{}", message());
        assert_eq!(spgs_view_set_scene(view, here.scene), 0);
        spgs_view_destroy(view);
    }
}

#[test]
fn messages_name_no_option_of_the_command_line() {
    let made = Made::new();
    let (mut gpu, mut scene) = (null_mut(), null_mut());
    let folder = tempfile::tempdir().unwrap();
    let path = flawed(folder.path());
    unsafe {
        let size = size_of::<spgs_gpu_options>() as u32;
        let options = spgs_gpu_options { struct_size: size, device_name: c"nonesuch".as_ptr(), ..Default::default() };
        assert_eq!(spgs_gpu_create(&raw const options, &raw mut gpu), 2);
        assert!(message().starts_with("device: found nonesuch"), "{}", message());
        let size = size_of::<spgs_scene_options>() as u32;
        for (motion, name) in [(1, "table"), (2, "network")] {
            let options = spgs_scene_options { struct_size: size, motion, ..Default::default() };
            assert_eq!(spgs_scene_load(made.gpu, path.as_ptr(), &raw const options, &raw mut scene), 2);
            assert!(message().starts_with(&format!("motion: found {name}")), "{}", message());
        }
        assert!(gpu.is_null() && scene.is_null());
    }
}
