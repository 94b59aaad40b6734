//! What ends up in the host's images.

use engine::gpu::{Gpu, ImageUse};
use engine::image::Image;
use engine::render::{PixelFormat, RenderOptions, Renderer, SceneHandle, SceneOptions, Target, View, ViewOptions};
use engine::scene::synthetic::{DEMO_BACKGROUND, demo_camera, demo_scene, moving_scene};
use engine::scene::{Camera, MotionSource, Scene};

use super::*;

const FORMATS: [PixelFormat; 4] = [PixelFormat::Rgba8, PixelFormat::Bgra8, PixelFormat::Rgba16F, PixelFormat::Rgba32F];

/// The same frame by the engine alone.
pub(super) fn expected(gpu: &Gpu, scene: &Scene, camera: &Camera, time: f64, background: [f32; 3]) -> Image {
    let options = RenderOptions { background, depth: true, ..RenderOptions::default() };
    Renderer::new(gpu, scene, &options).unwrap().render(camera, time).unwrap()
}

/// The host's image is the engine's float image as the format stores it.
pub(super) fn assert_stored(bytes: &[u8], format: PixelFormat, image: &Image, context: &str) {
    let stored = words(bytes);
    let per_pixel = format.bytes() as usize / 4;
    assert_eq!(stored.len(), image.rgba.len() / 4 * per_pixel, "{context}");
    for (at, (got, value)) in stored.chunks_exact(per_pixel).zip(image.rgba.chunks_exact(4)).enumerate() {
        let exact = format.pack([value[0], value[1], value[2], value[3]]);
        if got != &exact[..per_pixel] {
            // A value at the edge between two levels may fall on either side.
            let (a, b) = (format.unpack(got), format.unpack(&exact[..per_pixel]));
            let step = if format.bytes() == 4 { 1.01 / 255.0 } else { 1.0 / 1024.0 };
            let near = a.iter().zip(b).all(|(a, b)| (a - b).abs() <= step * b.abs().max(1.0));
            assert!(near && format != PixelFormat::Rgba32F, "{context}: pixel {at} is {a:?}, expected {b:?}");
        }
    }
}

#[test]
fn every_format_holds_the_engines_own_image() {
    let host = Host::new();
    let scene = demo_scene();
    let size = [203, 131];
    let camera = demo_camera(0.3, size[0], size[1]);
    let handle = SceneHandle::upload(host.gpu(), &scene, &SceneOptions::default()).unwrap();
    let truth = expected(host.gpu(), &scene, &camera, 0.3, DEMO_BACKGROUND);
    let frame = host.vulkan.frame().unwrap();
    let ways = FORMATS.into_iter().flat_map(|f| [(f, false), (f, true)]);
    for (format, storage) in ways.filter(|way| *way != (PixelFormat::Bgra8, true)) {
        let color = host.picture(size, vk_format(format));
        let depth = host.picture(size, vk::Format::R32_SFLOAT);
        let options =
            ViewOptions { format, storage, depth: true, background: DEMO_BACKGROUND, ..ViewOptions::default() };
        let mut view = View::new(host.gpu(), &handle, &options).unwrap();
        view.warm_up(&camera, 0.3).unwrap();
        let image = if storage { to_store(color) } else { to_read(color) };
        let target = Target { color: image, depth: Some(to_read(depth)) };
        submit(&host, frame, &mut view, &camera, 0.3, &target);
        host.vulkan.wait(frame).unwrap();
        assert_stored(&host.vulkan.read(color, format.bytes()).unwrap(), format, &truth, &format!("{format:?}"));
        let depths: Vec<f32> = words(&host.vulkan.read(depth, 4).unwrap()).into_iter().map(f32::from_bits).collect();
        assert_eq!(depths, truth.depth, "{format:?}");
        drop(view);
        [color, depth].into_iter().for_each(|p| host.vulkan.destroy(p));
    }
    host.vulkan.destroy_frame(frame);
}

#[test]
fn black_background_gives_premultiplied_colour() {
    let host = Host::new();
    let scene = demo_scene();
    let camera = demo_camera(0.0, 64, 48);
    let [black, white] = [[0.0; 3], [1.0; 3]].map(|b| expected(host.gpu(), &scene, &camera, 0.0, b));
    for (p, q) in black.rgba.chunks_exact(4).zip(white.rgba.chunks_exact(4)) {
        assert_eq!(p[3], q[3]);
        (0..3).for_each(|c| assert!((p[c] + (1.0 - p[3]) - q[c]).abs() < 1e-5));
    }
}

#[test]
fn scenes_whose_poses_come_from_the_host_or_from_network_f() {
    let host = Host::new();
    let mut far = demo_scene();
    let shift = [1.0e6_f32, -2.0e6, 0.0];
    far.gaussians.mean.iter_mut().for_each(|m| (0..3).for_each(|i| m[i] += shift[i]));
    let mut camera = demo_camera(0.6, 96, 64);
    camera.position += glam::DVec3::from(shift.map(f64::from));
    let cases = [
        (far, camera, MotionSource::Table),
        (moving_scene(600, 8, 5, 3, true), demo_camera(0.6, 96, 64), MotionSource::Network),
    ];
    let frame = host.vulkan.frame().unwrap();
    let color = host.picture([96, 64], vk::Format::R32G32B32A32_SFLOAT);
    for (scene, camera, motion) in cases {
        let options = RenderOptions { motion, ..RenderOptions::default() };
        let truth = Renderer::new(host.gpu(), &scene, &options).unwrap().render(&camera, 0.6).unwrap();
        assert!(truth.rgba.iter().any(|v| *v > 0.1), "{motion:?}: an empty picture");
        let options = SceneOptions { motion, ..SceneOptions::default() };
        let handle = SceneHandle::upload(host.gpu(), &scene, &options).unwrap();
        let options = ViewOptions { format: PixelFormat::Rgba32F, ..ViewOptions::default() };
        let mut view = View::new(host.gpu(), &handle, &options).unwrap();
        view.warm_up(&camera, 0.1).unwrap();
        submit(&host, frame, &mut view, &camera, 0.6, &Target { color: to_read(color), depth: None });
        host.vulkan.wait(frame).unwrap();
        let bytes = host.vulkan.read(color, 16).unwrap();
        assert_stored(&bytes, PixelFormat::Rgba32F, &truth, &format!("{motion:?}"));
    }
    host.vulkan.destroy(color);
    host.vulkan.destroy_frame(frame);
}

#[test]
fn views_beside_one_another_in_one_image() {
    let host = Host::new();
    let scene = demo_scene();
    let handle = SceneHandle::upload(host.gpu(), &scene, &SceneOptions::default()).unwrap();
    for storage in [false, true] {
        beside_one_another(&host, &scene, &handle, storage);
    }
}

fn beside_one_another(host: &Host, scene: &Scene, handle: &SceneHandle, storage: bool) {
    let options = ViewOptions { storage, ..ViewOptions::default() };
    let mut view = View::new(host.gpu(), handle, &options).unwrap();
    // Two eyes, 6 cm apart, side by side; one view is recorded twice.
    let eyes = [-0.03, 0.03].map(|x| {
        let mut camera = demo_camera(0.5, 80, 60);
        camera.position += camera.rotation.transpose() * glam::DVec3::X * x;
        camera
    });
    view.warm_up(&eyes[0], 0.5).unwrap();
    let image = host.picture([160, 60], vk::Format::R8G8B8A8_UNORM);
    let frame = host.vulkan.frame().unwrap();
    host.vulkan.begin(frame).unwrap();
    let between = ImageUse { layout: ImageUse::TRANSFER_SOURCE.layout, ..ImageUse::UNDEFINED };
    let second = unsafe { HostImage::from_raw(image.image.as_raw(), between, ImageUse::TRANSFER_SOURCE) };
    for (i, mut color) in [to_read(image), second.at(80, 0)].into_iter().enumerate() {
        if storage {
            color = unsafe { color.with_storage_view(image.view.as_raw()) };
        }
        view.record(&commands_of(frame), &eyes[i], 0.5, &Target { color, depth: None }).unwrap();
    }
    host.vulkan.submit(frame).unwrap();
    host.vulkan.wait(frame).unwrap();
    let bytes = host.vulkan.read(image, 4).unwrap();
    for (i, eye) in eyes.iter().enumerate() {
        let half: Vec<u8> = bytes.chunks_exact(640).flat_map(|row| row[320 * i..320 * (i + 1)].to_vec()).collect();
        let truth = expected(host.gpu(), scene, eye, 0.5, [0.0; 3]);
        assert_stored(&half, PixelFormat::Rgba8, &truth, &format!("eye {i}, storage {storage}"));
    }
    drop(view);
    host.vulkan.destroy(image);
    host.vulkan.destroy_frame(frame);
}
