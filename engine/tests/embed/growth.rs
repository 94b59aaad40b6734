//! Views that need more room, other sizes, timings.

use engine::render::{PixelFormat, SceneHandle, SceneOptions, Target, View, ViewOptions};
use engine::scene::synthetic::{demo_camera, demo_scene, random_scene};

use super::pictures::{assert_stored, expected};
use super::*;

#[test]
fn a_frame_that_does_not_fit_is_reported_and_the_next_ones_do() {
    let host = Host::new();
    // So far away that few tiles have them all.
    let scene = random_scene(3000, 5, 1);
    let eye = glam::DVec3::new(0.0, -20.0, 0.4);
    let camera = Camera::look_at(eye, glam::DVec3::ZERO, glam::DVec3::Z, 0.9, [320, 240]);
    let handle = SceneHandle::upload(host.gpu(), &scene, &SceneOptions::default()).unwrap();
    let mut view = View::new(host.gpu(), &handle, &ViewOptions { in_flight: 3, ..ViewOptions::default() }).unwrap();
    let pictures = [(); 3].map(|()| host.picture([320, 240], vk::Format::R8G8B8A8_UNORM));
    let frames = [(); 3].map(|()| host.vulkan.frame().unwrap());
    let mut overflowed = Vec::new();
    for i in 0..8 {
        let target = Target { color: to_read(pictures[i % 3]), depth: None };
        let recorded = submit(&host, frames[i % 3], &mut view, &camera, 0.0, &target);
        assert_eq!(recorded.serial, i as u64 + 1);
        assert_eq!(recorded.finished.is_some(), i >= 3, "frame {i}");
        overflowed.extend(recorded.finished.map(|f| f.overflowed));
    }
    assert_eq!(overflowed, [true, true, true, false, false]);
    frames.into_iter().for_each(|f| host.vulkan.wait(f).unwrap());
    let truth = expected(host.gpu(), &scene, &camera, 0.0, [0.0; 3]);
    for picture in pictures {
        assert_stored(&host.vulkan.read(picture, 4).unwrap(), PixelFormat::Rgba8, &truth, "after growth");
    }
    let finished = view.all_finished().unwrap().unwrap();
    assert!(finished.serial == 8 && !finished.overflowed && finished.statistics.visible > 0);

    // A view that may not grow says so, and goes on with what fits.
    let options = ViewOptions { max_instances: Some(1000), in_flight: 1, ..ViewOptions::default() };
    let mut small = View::new(host.gpu(), &handle, &options).unwrap();
    let error = small.warm_up(&camera, 0.0).unwrap_err();
    assert_eq!(error.exit_code(), 4, "{error}");
    drop((view, small));
    pictures.into_iter().for_each(|p| host.vulkan.destroy(p));
    frames.into_iter().for_each(|f| host.vulkan.destroy_frame(f));
}

#[test]
fn warming_up_does_not_count_as_a_frame() {
    let host = Host::new();
    let handle = SceneHandle::upload(host.gpu(), &demo_scene(), &SceneOptions::default()).unwrap();
    let mut view = View::new(host.gpu(), &handle, &ViewOptions { in_flight: 2, ..ViewOptions::default() }).unwrap();
    let camera = demo_camera(0.0, 48, 32);
    let picture = host.picture([48, 32], vk::Format::R8G8B8A8_UNORM);
    let frame = host.vulkan.frame().unwrap();
    let target = Target { color: to_read(picture), depth: None };
    view.warm_up(&camera, 0.0).unwrap();
    assert_eq!(view.finished(), None);
    assert_eq!(view.all_finished().unwrap(), None);
    let mut serials = Vec::new();
    for i in 1..=6 {
        let recorded = submit(&host, frame, &mut view, &camera, 0.0, &target);
        host.vulkan.wait(frame).unwrap();
        assert_eq!(recorded.serial, i);
        serials.extend(recorded.finished.map(|f| f.serial));
        if i == 3 {
            // What is in flight counts as seen; the next frames begin anew.
            view.warm_up(&camera, 0.5).unwrap();
            assert_eq!(view.finished().map(|f| f.serial), Some(3));
        }
    }
    assert_eq!(serials, [1, 4]);
    assert_eq!(view.all_finished().unwrap().map(|f| f.serial), Some(6));
    drop(view);
    host.vulkan.destroy(picture);
    host.vulkan.destroy_frame(frame);
}

#[test]
fn an_overflowed_frame_shows_the_background() {
    let host = Host::new();
    let mut camera = demo_camera(0.0, 160, 120);
    camera.position += camera.rotation.transpose() * glam::DVec3::Z * 5.5;
    let handle = SceneHandle::upload(host.gpu(), &demo_scene(), &SceneOptions::default()).unwrap();
    let options = ViewOptions { max_instances: Some(64), background: [0.0, 1.0, 0.0], ..ViewOptions::default() };
    let mut view = View::new(host.gpu(), &handle, &options).unwrap();
    let picture = host.picture([160, 120], vk::Format::R8G8B8A8_UNORM);
    let frame = host.vulkan.frame().unwrap();
    submit(&host, frame, &mut view, &camera, 0.0, &Target { color: to_read(picture), depth: None });
    host.vulkan.wait(frame).unwrap();
    assert!(words(&host.vulkan.read(picture, 4).unwrap()).iter().all(|w| *w == 0x0000_FF00));
    assert!(view.all_finished().is_err());
    drop(view);
    host.vulkan.destroy(picture);
    host.vulkan.destroy_frame(frame);
}

#[test]
fn sizes_change_while_frames_are_in_flight() {
    let host = Host::new();
    let scene = demo_scene();
    let handle = SceneHandle::upload(host.gpu(), &scene, &SceneOptions::default()).unwrap();
    let mut view = View::new(host.gpu(), &handle, &ViewOptions { in_flight: 3, ..ViewOptions::default() }).unwrap();
    let sizes = [[40, 30], [64, 48], [1, 1], [33, 70], [64, 48], [16, 16]];
    let pictures = sizes.map(|size| host.picture(size, vk::Format::R8G8B8A8_UNORM));
    let frames = [(); 3].map(|()| host.vulkan.frame().unwrap());
    let cameras = sizes.map(|[w, h]| demo_camera(0.4, w, h));
    view.warm_up(&cameras[1], 0.4).unwrap();
    for i in 0..sizes.len() {
        let target = Target { color: to_read(pictures[i]), depth: None };
        submit(&host, frames[i % 3], &mut view, &cameras[i], 0.4, &target);
    }
    frames.into_iter().for_each(|f| host.vulkan.wait(f).unwrap());
    for (picture, camera) in pictures.iter().zip(&cameras) {
        let truth = expected(host.gpu(), &scene, camera, 0.4, [0.0; 3]);
        assert_stored(&host.vulkan.read(*picture, 4).unwrap(), PixelFormat::Rgba8, &truth, &camera.width.to_string());
    }
    drop(view);
    pictures.into_iter().for_each(|p| host.vulkan.destroy(p));
    frames.into_iter().for_each(|f| host.vulkan.destroy_frame(f));
}

#[test]
fn timings_name_the_operations() {
    let host = Host::new();
    let handle = SceneHandle::upload(host.gpu(), &demo_scene(), &SceneOptions::default()).unwrap();
    let camera = demo_camera(0.4, 64, 48);
    let options = ViewOptions { profile: true, ..ViewOptions::default() };
    let mut view = View::new(host.gpu(), &handle, &options).unwrap();
    assert!(view.timings().unwrap().is_empty());
    view.warm_up(&camera, 0.4).unwrap();
    let timings = view.timings().unwrap();
    let time = |label: &str| timings.iter().find(|t| t.label == label).unwrap_or_else(|| panic!("no {label}")).us;
    assert!(time("blend_packed") > 0.0 && time("deform_project") > 0.0);
    assert!(timings.iter().all(|t| t.us < 1e7), "{timings:?}");
}
