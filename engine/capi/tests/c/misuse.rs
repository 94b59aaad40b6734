//! Null, nonsense and panics: a status and a message, never a crash.

use std::ffi::{CStr, CString, c_void};
use std::ptr::{null, null_mut};

use spgs::*;

pub(super) fn message() -> String {
    unsafe { CStr::from_ptr(spgs_message()) }.to_str().unwrap().to_owned()
}

/// A device of the engine's and the demo scene on it.
pub(super) struct Made {
    pub(super) gpu: *mut spgs_gpu,
    pub(super) scene: *mut spgs_scene,
}

impl Made {
    pub(super) fn new() -> Self {
        let mut made = Self { gpu: null_mut(), scene: null_mut() };
        unsafe {
            assert_eq!(spgs_gpu_create(null(), &raw mut made.gpu), 0, "{}", message());
            assert_eq!(spgs_scene_demo(made.gpu, null(), &raw mut made.scene), 0, "{}", message());
        }
        made
    }
}

/// Looks at the demo scene along z.
pub(super) fn camera() -> spgs_camera {
    let mut world_to_camera = [0.0; 16];
    (0..4).for_each(|i| world_to_camera[5 * i] = 1.0);
    world_to_camera[14] = 4.0;
    spgs_camera { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0, world_to_camera }
}

impl Drop for Made {
    fn drop(&mut self) {
        unsafe {
            spgs_scene_destroy(self.scene);
            spgs_gpu_destroy(self.gpu);
        }
    }
}

#[test]
fn null_is_a_usage_error_and_destroying_it_nothing() {
    unsafe {
        assert_eq!(spgs_gpu_create(null(), null_mut()), 2);
        assert!(message().contains("null"), "{}", message());
        assert_eq!(spgs_gpu_from_host(null(), null_mut()), 2);
        assert_eq!(spgs_gpu_handles(null(), null_mut()), 2);
        assert_eq!(spgs_gpu_with_queue(null(), None, null_mut()), 2);
        assert_eq!(spgs_required_features(null_mut(), null_mut()), 2);
        assert_eq!(spgs_scene_load(null(), null(), null(), null_mut()), 2);
        assert_eq!(spgs_scene_get_info(null(), null_mut()), 2);
        assert_eq!(spgs_loading_poll(null()), 2);
        assert_eq!(spgs_loading_finish(null_mut(), null_mut()), 2);
        assert_eq!(spgs_view_create(null(), null(), null(), null_mut()), 2);
        assert_eq!(spgs_view_record(null_mut(), null_mut(), null(), 0.0, null(), null_mut()), 2);
        assert_eq!(spgs_view_warm_up(null_mut(), null(), 0.0, null_mut()), 2);
        assert_eq!(spgs_view_all_finished(null_mut(), null_mut()), 2);
        assert_eq!(spgs_view_set_scene(null_mut(), null()), 2);
        spgs_view_destroy(null_mut());
        spgs_scene_destroy(null_mut());
        spgs_loading_cancel(null_mut());
        spgs_gpu_destroy(null_mut());
    }
}

#[test]
fn nonsense_is_refused_by_name() {
    let made = Made::new();
    let mut scene = null_mut();
    let mut view = null_mut();
    unsafe {
        let missing = CString::new("/no/such/model.safetensors").unwrap();
        assert_eq!(spgs_scene_load(made.gpu, missing.as_ptr(), null(), &raw mut scene), 3);
        assert!(message().contains("/no/such/model.safetensors"), "{}", message());
        assert_eq!(spgs_scene_load(made.gpu, c"\xff".as_ptr(), null(), &raw mut scene), 2);
        let size = size_of::<spgs_scene_options>() as u32;
        let options = spgs_scene_options { struct_size: size, quality: 9, ..Default::default() };
        assert_eq!(spgs_scene_demo(made.gpu, &raw const options, &raw mut scene), 2);
        assert!(message().contains("quality") && scene.is_null(), "{}", message());
        let options = spgs_scene_options { struct_size: 0, ..Default::default() };
        assert_eq!(spgs_scene_demo(made.gpu, &raw const options, &raw mut scene), 2);
        assert!(message().contains("struct_size"), "{}", message());
        let size = size_of::<spgs_view_options>() as u32;
        for (field, options) in [
            ("format", spgs_view_options { format: 4, ..Default::default() }),
            ("format", spgs_view_options { format: 1, storage: 1, ..Default::default() }),
            ("in flight", spgs_view_options { in_flight: 99, ..Default::default() }),
            ("near plane", spgs_view_options { near_plane: -1.0, ..Default::default() }),
            ("near plane", spgs_view_options { near_plane: f32::NAN, ..Default::default() }),
            ("near plane", spgs_view_options { near_plane: f32::INFINITY, ..Default::default() }),
            ("background", spgs_view_options { background: [0.0, 0.0, f32::NAN], ..Default::default() }),
        ] {
            let options = spgs_view_options { struct_size: size, ..options };
            let status = if field == "background" { 6 } else { 2 };
            assert_eq!(spgs_view_create(made.gpu, made.scene, &raw const options, &raw mut view), status);
            assert!(message().contains(field) && view.is_null(), "{}", message());
        }
        assert_eq!(spgs_view_create(made.gpu, made.scene, null(), &raw mut view), 0);
        let mut camera = spgs_camera { fy: f64::NAN, ..camera() };
        assert_eq!(spgs_view_warm_up(view, &raw const camera, 0.0, null_mut()), 6, "{}", message());
        camera.fy = 60.0;
        assert_eq!(spgs_view_warm_up(view, &raw const camera, f64::NAN, null_mut()), 6);
        let target = spgs_target::default();
        assert_eq!(spgs_view_record(view, 8 as *mut c_void, &raw const camera, 0.0, &raw const target, null_mut()), 2);
        assert!(message().contains("image"), "{}", message());
        spgs_view_destroy(view);
    }
}

#[test]
fn cameras_that_are_not_rigid_are_refused() {
    type Change = fn(&mut [f64; 16]);
    let made = Made::new();
    let mut view = null_mut();
    assert_eq!(unsafe { spgs_view_create(made.gpu, made.scene, null(), &raw mut view) }, 0);
    let changed = |change: Change| {
        let mut camera = camera();
        change(&mut camera.world_to_camera);
        let status = unsafe { spgs_view_warm_up(view, &raw const camera, 0.0, null_mut()) };
        (status, message())
    };
    assert_eq!(changed(|_| ()).0, 0);
    assert_eq!(changed(|m| m[0] = 1.0001).0, 0);
    let cases: [(Change, &str); 6] = [
        (|m| *m = [0.0; 16], "last row: found [0.0, 0.0, 0.0, 0.0]"),
        (|m| (0..15).for_each(|i| m[i] = 0.0), "lengths 0.0000, 0.0000, 0.0000"),
        (|m| (0..12).for_each(|i| m[i] *= 2.0), "lengths 2.0000, 2.0000, 2.0000"),
        (|m| m[5] = -1.0, "a mirror, determinant -1.0000"),
        (|m| m[15] = 2.0, "last row"),
        (|m| m[3] = f64::NAN, "last row"),
    ];
    for (change, said) in cases {
        let (status, message) = changed(change);
        assert!(status == 2 && message.contains(said), "{status} {message}");
    }
    unsafe { spgs_view_destroy(view) };
}

#[test]
fn older_and_newer_callers_are_understood() {
    let made = Made::new();
    // A caller that knows only the first two fields, and one whose structure is longer than ours.
    let mut scene = null_mut();
    let old = [8_u32, 1];
    let mut new = [0_u32; 16];
    new[..2].copy_from_slice(&[64, 1]);
    for words in [&old[..], &new] {
        unsafe {
            assert_eq!(spgs_scene_demo(made.gpu, words.as_ptr().cast(), &raw mut scene), 0, "{}", message());
            let mut info = spgs_scene_info::default();
            assert_eq!(spgs_scene_get_info(scene, &raw mut info), 0);
            assert!(info.gaussians > 1000 && info.rejected == 0 && info.bytes > 0);
            spgs_scene_destroy(scene);
        }
    }
}

#[test]
fn loading_goes_on_beside_the_caller() {
    let made = Made::new();
    unsafe {
        let mut loading = null_mut();
        let missing = CString::new("/no/such/model.ply").unwrap();
        assert_eq!(spgs_scene_load_async(made.gpu, missing.as_ptr(), null(), &raw mut loading), 0);
        while spgs_loading_poll(loading) == 8 {
            std::thread::yield_now();
        }
        assert_eq!(spgs_loading_poll(loading), 0);
        let mut scene = null_mut();
        assert_eq!(spgs_loading_finish(loading, &raw mut scene), 3);
        assert!(message().contains("model.ply") && scene.is_null());
        assert_eq!(spgs_scene_load_async(made.gpu, missing.as_ptr(), null(), &raw mut loading), 0);
        spgs_loading_cancel(loading);
    }
}

#[test]
fn lists_of_requirements_and_handles() {
    let made = Made::new();
    unsafe {
        let (mut names, mut count) = (null(), 99);
        assert_eq!(spgs_required_extensions(1 << 22 | 3 << 12, &raw mut names, &raw mut count), 0);
        assert_eq!(count, 0);
        assert_eq!(spgs_required_extensions(1 << 22 | 2 << 12, &raw mut names, &raw mut count), 0);
        assert_eq!(CStr::from_ptr(*names), c"VK_KHR_synchronization2");
        assert_eq!(count, 2);
        assert_eq!(spgs_required_features(&raw mut names, &raw mut count), 0);
        assert_eq!(CStr::from_ptr(*names), c"timelineSemaphore");
        let mut handles = spgs_handles::default();
        assert_eq!(spgs_gpu_handles(made.gpu, &raw mut handles), 0);
        assert!(!handles.instance.is_null() && !handles.device.is_null());
        extern "C" fn look(queue: *mut c_void, user: *mut c_void) {
            unsafe { *user.cast::<bool>() = !queue.is_null() };
        }
        let mut seen = false;
        assert_eq!(spgs_gpu_with_queue(made.gpu, Some(look), (&raw mut seen).cast()), 0);
        assert!(seen);
    }
    assert_eq!(spgs_version(), 1 << 8);
}
