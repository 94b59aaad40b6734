//! What does not make sense is refused by name, and nothing is recorded.

use engine::Error;
use engine::gpu::host::host_requirements;
use engine::gpu::{GpuOptions, HostDevice};
use engine::render::{Quality, SceneHandle, SceneOptions, Target, View, ViewOptions};
use engine::scene::synthetic::{demo_camera, demo_scene, random_scene};
use glam::DMat3;

use super::*;

#[test]
fn null_handles_and_old_versions_are_refused() {
    let host = Host::new();
    let device = HostDevice {
        get_instance_proc_addr: Some(host.gpu().get_instance_proc_addr()),
        api_version: vk::API_VERSION_1_3,
        instance: host.vulkan.instance.handle().as_raw(),
        physical_device: host.vulkan.physical.as_raw(),
        device: host.vulkan.device.handle().as_raw(),
        queue: host.vulkan.queue.as_raw(),
        queue_family: host.vulkan.family,
        queue_lock: None,
    };
    let options = GpuOptions { pipeline_cache: false, ..GpuOptions::default() };
    let open = |device: &HostDevice| unsafe { Gpu::from_host(device, &options) };
    assert!(open(&device).is_ok());
    let refused = |change: fn(&mut HostDevice)| {
        let mut changed = device.clone();
        change(&mut changed);
        open(&changed).unwrap_err().to_string()
    };
    assert!(refused(|d| d.instance = 0).contains("VkInstance"));
    assert!(refused(|d| d.physical_device = 0).contains("VkPhysicalDevice"));
    assert!(refused(|d| d.device = 0).contains("VkDevice"));
    assert!(refused(|d| d.queue = 0).contains("VkQueue"));
    let refused_version = "HostDevice::api_version: found 1.1, expected at least 1.2";
    assert_eq!(refused(|d| d.api_version = vk::API_VERSION_1_1), refused_version);
    assert_eq!(refused(|d| d.api_version = 0), refused_version.replace("1.1", "0"));
    assert!(refused(|d| d.queue_family = 99).contains("family"));
}

#[test]
fn requirements_are_those_of_the_version() {
    assert!(host_requirements(vk::API_VERSION_1_3).extensions.is_empty());
    let old = host_requirements(vk::API_VERSION_1_2);
    assert_eq!(old.extensions, [c"VK_KHR_synchronization2", c"VK_EXT_subgroup_size_control"]);
    assert!(old.features.contains(&"timelineSemaphore"));
}

#[test]
fn views_and_targets_without_sense_are_refused() {
    let host = Host::new();
    let coarse = SceneOptions { quality: Quality { resolution: 0.5, ..Quality::EXACT }, ..SceneOptions::default() };
    assert!(SceneHandle::upload(host.gpu(), &demo_scene(), &coarse).unwrap_err().to_string().contains("resolution"));
    let handle = SceneHandle::upload(host.gpu(), &demo_scene(), &SceneOptions::default()).unwrap();
    for in_flight in [0, 17, u32::MAX] {
        let options = ViewOptions { in_flight, ..ViewOptions::default() };
        assert!(View::new(host.gpu(), &handle, &options).unwrap_err().to_string().contains("in flight"));
    }
    let mut view = View::new(host.gpu(), &handle, &ViewOptions::default()).unwrap();
    let picture = host.picture([32, 32], vk::Format::R8G8B8A8_UNORM);
    let target = Target { color: to_read(picture), depth: None };
    let frame = host.vulkan.frame().unwrap();
    host.vulkan.begin(frame).unwrap();
    let commands = commands_of(frame);
    let camera = demo_camera(0.0, 32, 32);
    let both = Target { depth: Some(to_read(picture)), ..target };
    assert!(view.record(&commands, &camera, 0.0, &both).unwrap_err().to_string().contains("depth"));
    let stored = Target { color: to_store(picture), depth: None };
    let error = view.record(&commands, &camera, 0.0, &stored).unwrap_err().to_string();
    assert!(error.contains("expected one without a storage view"), "{error}");
    let deep = ViewOptions { depth: true, ..ViewOptions::default() };
    let stored = Target { depth: Some(to_store(picture)), ..target };
    let error = View::new(host.gpu(), &handle, &deep).unwrap().record(&commands, &camera, 0.0, &stored).unwrap_err();
    assert!(error.to_string().contains("depth image"), "{error}");
    let options = ViewOptions { storage: true, ..ViewOptions::default() };
    let error = View::new(host.gpu(), &handle, &options).unwrap().record(&commands, &camera, 0.0, &target).unwrap_err();
    assert!(error.to_string().contains("expected one with a storage view"), "{error}");
    let options = ViewOptions { format: PixelFormat::Bgra8, ..options };
    assert!(View::new(host.gpu(), &handle, &options).unwrap_err().to_string().contains("Rgba16F"));
    let mut broken = camera.clone();
    broken.fx = f64::NAN;
    assert!(matches!(view.record(&commands, &broken, 0.0, &target), Err(Error::NonFinite { .. })));
    assert!(view.record(&commands, &demo_camera(0.0, 0, 32), 0.0, &target).is_err());
    assert!(view.record(&commands, &camera, f64::INFINITY, &target).is_err());
    // Device memory that is not there: an error, the view lives on.
    host.gpu().set_byte_budget(host.gpu().memory_used().0);
    assert_eq!(view.record(&commands, &camera, 0.0, &target).unwrap_err().exit_code(), 4);
    host.gpu().set_byte_budget(1 << 32);
    assert_eq!(view.record(&commands, &camera, 0.0, &target).unwrap().serial, 1);
    host.vulkan.submit(frame).unwrap();
    host.vulkan.wait(frame).unwrap();
    drop(view);
    host.vulkan.destroy(picture);
    host.vulkan.destroy_frame(frame);
}

#[test]
fn scenes_of_another_gpu_are_refused() {
    let hosts = [Host::new(), Host::new()];
    let [own, other] =
        [0, 1].map(|i| SceneHandle::upload(hosts[i].gpu(), &random_scene(20, 1, 0), &SceneOptions::default()).unwrap());
    let said = "scene of a view: found one of another gpu";
    let new = |gpu: &Gpu, scene| View::new(gpu, scene, &ViewOptions::default());
    let error = new(hosts[0].gpu(), &other).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains(said), "{error}");
    // A clone is the same.
    let mut view = new(&hosts[0].gpu().clone(), &own).unwrap();
    let error = view.set_scene(&other).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains(said), "{error}");
    // The view has kept its own.
    view.warm_up(&demo_camera(0.0, 32, 32), 0.0).unwrap();
    view.set_scene(&own.clone()).unwrap();
}

#[test]
fn images_that_are_none_or_go_nowhere_are_refused() {
    let host = Host::new();
    let handle = SceneHandle::upload(host.gpu(), &random_scene(20, 1, 0), &SceneOptions::default()).unwrap();
    let mut view = View::new(host.gpu(), &handle, &ViewOptions { depth: true, ..ViewOptions::default() }).unwrap();
    let color = host.picture([32, 32], vk::Format::R8G8B8A8_UNORM);
    let frame = host.vulkan.frame().unwrap();
    host.vulkan.begin(frame).unwrap();
    let none = unsafe { HostImage::from_raw(0, READ_BEFORE, ImageUse::TRANSFER_SOURCE) };
    let going = |layout| unsafe {
        let after = ImageUse { layout, ..ImageUse::TRANSFER_SOURCE };
        HostImage::from_raw(color.image.as_raw(), READ_BEFORE, after)
    };
    let image = to_read(color);
    for (color, depth, said) in [
        (none, Some(image), "colour image: found null"),
        (image, Some(none), "depth image: found null"),
        (going(0), None, "colour image, layout after the frame: found UNDEFINED"),
        (image, Some(going(8)), "depth image, layout after the frame: found PREINITIALIZED"),
    ] {
        let target = Target { color, depth };
        let error = view.record(&commands_of(frame), &demo_camera(0.0, 32, 32), 0.0, &target).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains(said), "{error}");
    }
    host.vulkan.submit(frame).unwrap();
    host.vulkan.wait(frame).unwrap();
    drop(view);
    host.vulkan.destroy(color);
    host.vulkan.destroy_frame(frame);
}

#[test]
fn options_and_cameras_without_sense_are_refused() {
    let host = Host::new();
    let handle = SceneHandle::upload(host.gpu(), &random_scene(20, 1, 0), &SceneOptions::default()).unwrap();
    let refused = |options: &ViewOptions| View::new(host.gpu(), &handle, options).unwrap_err();
    for near in [-1.0, f32::NAN, f32::INFINITY] {
        let error = refused(&ViewOptions { near, ..ViewOptions::default() });
        assert!(error.exit_code() == 2 && error.to_string().contains("near plane"), "{error}");
    }
    let error = refused(&ViewOptions { background: [0.0, f32::NAN, 0.0], ..ViewOptions::default() });
    assert!(error.exit_code() == 6 && error.to_string().contains("background"), "{error}");
    let mut view = View::new(host.gpu(), &handle, &ViewOptions::default()).unwrap();
    let camera = demo_camera(0.0, 32, 32);
    let mirror = DMat3::from_diagonal(glam::DVec3::new(1.0, -1.0, 1.0));
    for rotation in [DMat3::ZERO, camera.rotation * 2.0, mirror * camera.rotation] {
        let error = view.warm_up(&Camera { rotation, ..camera.clone() }, 0.0).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("rotation"), "{error}");
    }
    view.warm_up(&camera, 0.0).unwrap();
}

/// The proof that silence means something: a host that lies about its image's layout is noticed.
#[test]
fn a_host_that_breaks_the_contract_is_noticed() {
    let mut host = Host::new();
    if !host.vulkan.validates() {
        println!("not looked at: SPGS_VALIDATION is off");
        return;
    }
    let handle = SceneHandle::upload(host.gpu(), &demo_scene(), &SceneOptions::default()).unwrap();
    let mut view = View::new(host.gpu(), &handle, &ViewOptions::default()).unwrap();
    let picture = host.picture([32, 32], vk::Format::R8G8B8A8_UNORM);
    let frame = host.vulkan.frame().unwrap();
    let before = ImageUse::COLOR_ATTACHMENT;
    let color = unsafe { HostImage::from_raw(picture.image.as_raw(), before, ImageUse::TRANSFER_SOURCE) };
    submit(&host, frame, &mut view, &demo_camera(0.0, 32, 32), 0.0, &Target { color, depth: None });
    host.vulkan.wait(frame).unwrap();
    assert!(host.vulkan.take_messages().iter().any(|m| m.contains("VK_IMAGE_LAYOUT")), "nothing was said");
    drop((view, handle));
    host.gpu = None;
    host.vulkan.destroy(picture);
    host.vulkan.destroy_frame(frame);
}
