//! Several scenes and views, threads, loading while frames go on.

use engine::gpu::GpuOptions;
use engine::render::{PixelFormat, SceneHandle, SceneOptions, Target, View, ViewOptions};
use engine::scene::synthetic::{demo_camera, demo_scene, random_scene};

use super::pictures::{assert_stored, expected};
use super::*;

#[test]
fn two_scenes_in_one_command_buffer() {
    let host = Host::new();
    let scenes = [demo_scene(), random_scene(500, 7, 2)];
    let camera = demo_camera(0.2, 72, 56);
    let mut views: Vec<View> = scenes
        .iter()
        .map(|scene| {
            let handle = SceneHandle::upload(host.gpu(), scene, &SceneOptions::default()).unwrap();
            let mut view = View::new(host.gpu(), &handle, &ViewOptions::default()).unwrap();
            view.warm_up(&camera, 0.2).unwrap();
            view
        })
        .collect();
    let pictures = [(); 2].map(|()| host.picture([72, 56], vk::Format::R8G8B8A8_UNORM));
    let frame = host.vulkan.frame().unwrap();
    host.vulkan.begin(frame).unwrap();
    for (view, picture) in views.iter_mut().zip(pictures) {
        let target = Target { color: to_read(picture), depth: None };
        view.record(&commands_of(frame), &camera, 0.2, &target).unwrap();
    }
    host.vulkan.submit(frame).unwrap();
    host.vulkan.wait(frame).unwrap();
    for (i, (scene, picture)) in scenes.iter().zip(pictures).enumerate() {
        let truth = expected(host.gpu(), scene, &camera, 0.2, [0.0; 3]);
        let bytes = host.vulkan.read(picture, 4).unwrap();
        assert_stored(&bytes, PixelFormat::Rgba8, &truth, &format!("scene {i}"));
    }
    // A view may change its scene.
    let other = SceneHandle::upload(host.gpu(), &scenes[1], &SceneOptions::default()).unwrap();
    views[0].set_scene(&other).unwrap();
    views[0].warm_up(&camera, 0.2).unwrap();
    submit(&host, frame, &mut views[0], &camera, 0.2, &Target { color: to_read(pictures[0]), depth: None });
    host.vulkan.wait(frame).unwrap();
    let truth = expected(host.gpu(), &scenes[1], &camera, 0.2, [0.0; 3]);
    assert_stored(&host.vulkan.read(pictures[0], 4).unwrap(), PixelFormat::Rgba8, &truth, "changed scene");
    drop(views);
    pictures.into_iter().for_each(|p| host.vulkan.destroy(p));
    host.vulkan.destroy_frame(frame);
}

#[test]
fn views_of_one_scene_are_recorded_on_several_threads() {
    let host = Host::new();
    let scene = demo_scene();
    let handle = SceneHandle::upload(host.gpu(), &scene, &SceneOptions::default()).unwrap();
    let truth: Vec<_> =
        (0..3).map(|i| expected(host.gpu(), &scene, &demo_camera(0.1, 48 + 16 * i, 40), 0.1, [0.0; 3])).collect();
    std::thread::scope(|threads| {
        for (i, truth) in (0..3).zip(&truth) {
            let (host, handle) = (&host, &handle);
            threads.spawn(move || {
                let camera = demo_camera(0.1, 48 + 16 * i, 40);
                let mut view = View::new(host.gpu(), handle, &ViewOptions::default()).unwrap();
                let picture = host.picture([48 + 16 * i, 40], vk::Format::R8G8B8A8_UNORM);
                let frame = host.vulkan.frame().unwrap();
                view.warm_up(&camera, 0.1).unwrap();
                for _ in 0..10 {
                    submit(host, frame, &mut view, &camera, 0.1, &Target { color: to_read(picture), depth: None });
                }
                host.vulkan.wait(frame).unwrap();
                let bytes = host.vulkan.read(picture, 4).unwrap();
                assert_stored(&bytes, PixelFormat::Rgba8, truth, &format!("thread {i}"));
                drop(view);
                host.vulkan.destroy(picture);
                host.vulkan.destroy_frame(frame);
            });
        }
    });
}

#[test]
fn a_scene_loads_while_frames_go_on() {
    let host = Host::new();
    let first = random_scene(100, 1, 0);
    let camera = demo_camera(0.2, 64, 48);
    let handle = SceneHandle::upload(host.gpu(), &first, &SceneOptions::default()).unwrap();
    let mut view = View::new(host.gpu(), &handle, &ViewOptions::default()).unwrap();
    view.warm_up(&camera, 0.2).unwrap();
    let picture = host.picture([64, 48], vk::Format::R8G8B8A8_UNORM);
    let frame = host.vulkan.frame().unwrap();
    let (start, go) = std::sync::mpsc::channel();
    let source = move || {
        go.recv().unwrap();
        Ok(demo_scene())
    };
    let loading = SceneHandle::load(host.gpu(), source, &SceneOptions::default());
    let mut frames = 0;
    while !loading.is_finished() {
        submit(&host, frame, &mut view, &camera, 0.2, &Target { color: to_read(picture), depth: None });
        frames += 1;
        if frames == 3 {
            start.send(()).unwrap();
        }
    }
    assert!(frames >= 3);
    view.set_scene(&loading.finish().unwrap()).unwrap();
    host.vulkan.wait(frame).unwrap();
    view.warm_up(&camera, 0.2).unwrap();
    submit(&host, frame, &mut view, &camera, 0.2, &Target { color: to_read(picture), depth: None });
    host.vulkan.wait(frame).unwrap();
    let truth = expected(host.gpu(), &demo_scene(), &camera, 0.2, [0.0; 3]);
    assert_stored(&host.vulkan.read(picture, 4).unwrap(), PixelFormat::Rgba8, &truth, "loaded");
    drop(view);
    host.vulkan.destroy(picture);
    host.vulkan.destroy_frame(frame);
    let broken = SceneHandle::load(host.gpu(), || panic!("a source that fails"), &SceneOptions::default());
    assert!(broken.finish().unwrap_err().to_string().contains("panic"));
}

#[test]
fn the_host_goes_on_when_the_engine_is_gone() {
    let mut host = Host::new();
    let handle = SceneHandle::upload(host.gpu(), &demo_scene(), &SceneOptions::default()).unwrap();
    let camera = demo_camera(0.0, 32, 32);
    let mut view = View::new(host.gpu(), &handle, &ViewOptions::default()).unwrap();
    let picture = host.picture([32, 32], vk::Format::R8G8B8A8_UNORM);
    let frame = host.vulkan.frame().unwrap();
    submit(&host, frame, &mut view, &camera, 0.0, &Target { color: to_read(picture), depth: None });
    host.vulkan.wait(frame).unwrap();
    assert_eq!(host.gpu().handles().queue_family, host.vulkan.family);
    drop((view, handle));
    assert_eq!(host.gpu().buffer_count(), 0);
    host.gpu = None;
    // The image is the host's, and so is the device.
    assert_eq!(host.vulkan.read(picture, 4).unwrap().len(), 32 * 32 * 4);
    host.vulkan.destroy(picture);
    host.vulkan.destroy_frame(frame);
}

#[test]
fn a_device_that_the_engine_made_serves_a_host_too() {
    let options = GpuOptions { pipeline_cache: false, ..GpuOptions::default() };
    let gpu = Gpu::open(&options).unwrap();
    let handles = gpu.handles();
    assert!(handles.instance != 0 && handles.physical_device != 0 && handles.device != 0);
    assert_ne!(gpu.with_queue(|queue| queue), 0);
    for (field, text) in [("instance", "VK_NO_such_instance"), ("device", "VK_NO_such_device")] {
        let name = vec![std::ffi::CString::new(text).unwrap()];
        let options = if field == "instance" {
            GpuOptions { instance_extensions: name, ..options.clone() }
        } else {
            GpuOptions { device_extensions: name, ..options.clone() }
        };
        assert!(Gpu::open(&options).unwrap_err().to_string().contains(text));
    }
    let messages = gpu.take_validation_messages();
    assert!(messages.is_empty(), "{messages:?}");
}
