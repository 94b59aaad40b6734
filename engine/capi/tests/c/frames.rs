//! Frames on a host's device through the C interface.

use std::ffi::c_void;
use std::ptr::{null, null_mut};
use std::sync::Arc;

use ash::vk::{self, Handle as _};
use spgs::*;

use super::misuse::{camera, message};
use super::vulkan::Vulkan;

fn host(vulkan: &Vulkan) -> spgs_host {
    spgs_host {
        struct_size: size_of::<spgs_host>() as u32,
        api_version: vk::API_VERSION_1_3,
        instance: vulkan.instance.handle().as_raw() as *mut c_void,
        physical_device: vulkan.physical.as_raw() as *mut c_void,
        device: vulkan.device.handle().as_raw() as *mut c_void,
        queue: vulkan.queue.as_raw() as *mut c_void,
        queue_family: vulkan.family,
        ..Default::default()
    }
}

/// A host, the engine on it, and the demo scene in a view.
struct Shown {
    gpu: *mut spgs_gpu,
    scene: *mut spgs_scene,
    view: *mut spgs_view,
    vulkan: Arc<Vulkan>,
}

impl Shown {
    fn new(options: spgs_view_options) -> Self {
        let vulkan = Vulkan::new(true).unwrap();
        let (mut gpu, mut scene, mut view) = (null_mut(), null_mut(), null_mut());
        let host = host(&vulkan);
        let options = spgs_view_options { struct_size: size_of::<spgs_view_options>() as u32, ..options };
        unsafe {
            assert_eq!(spgs_gpu_from_host(&raw const host, &raw mut gpu), 0, "{}", message());
            assert_eq!(spgs_scene_demo(gpu, null(), &raw mut scene), 0, "{}", message());
            assert_eq!(spgs_view_create(gpu, scene, &raw const options, &raw mut view), 0, "{}", message());
        }
        Self { gpu, scene, view, vulkan }
    }
}

impl Drop for Shown {
    fn drop(&mut self) {
        unsafe {
            spgs_view_destroy(self.view);
            spgs_scene_destroy(self.scene);
            spgs_gpu_destroy(self.gpu);
        }
        let messages = self.vulkan.messages();
        assert!(messages.is_empty() || std::thread::panicking(), "{messages:?}");
    }
}

fn image(raw: vk::Image) -> spgs_image {
    spgs_image {
        image: raw.as_raw(),
        new_layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL.as_raw(),
        before_stages: vk::PipelineStageFlags2::TRANSFER.as_raw(),
        after_stages: vk::PipelineStageFlags2::TRANSFER.as_raw(),
        after_access: vk::AccessFlags2::TRANSFER_READ.as_raw(),
        ..Default::default()
    }
}

#[test]
fn versions_below_1_2_are_refused_by_name() {
    let vulkan = Vulkan::new(false).unwrap();
    let mut gpu = null_mut();
    for (api_version, said) in [(0, "0"), (vk::API_VERSION_1_1, "1.1")] {
        let host = spgs_host { api_version, ..host(&vulkan) };
        assert_eq!(unsafe { spgs_gpu_from_host(&raw const host, &raw mut gpu) }, 2, "{}", message());
        assert_eq!(message(), format!("spgs_host.api_version: found {said}, expected at least 1.2"));
        assert!(gpu.is_null());
    }
}

#[test]
fn serial_numbers_are_those_of_record() {
    let shown = Shown::new(spgs_view_options { in_flight: 1, ..Default::default() });
    let usage = vk::ImageUsageFlags::TRANSFER_DST | vk::ImageUsageFlags::TRANSFER_SRC;
    let picture = shown.vulkan.picture([64, 48], vk::Format::R8G8B8A8_UNORM, usage).unwrap();
    let frame = shown.vulkan.frame().unwrap();
    let (camera, target) = (camera(), spgs_target { color: image(picture.image), depth: null() });
    let (view, mut finished) = (shown.view, spgs_finished::default());
    unsafe {
        assert_eq!(spgs_view_warm_up(view, &raw const camera, 0.0, null_mut()), 0, "{}", message());
        for before in 0..3 {
            shown.vulkan.begin(frame).unwrap();
            let commands = frame.commands.as_raw() as *mut c_void;
            let status = spgs_view_record(view, commands, &raw const camera, 0.0, &raw const target, &raw mut finished);
            assert_eq!(status, 0, "{}", message());
            assert_eq!(finished.serial, before);
            shown.vulkan.submit(frame).unwrap();
            shown.vulkan.wait(frame).unwrap();
        }
        assert_eq!(spgs_view_all_finished(view, &raw mut finished), 0);
        assert_eq!(finished.serial, 3);
        assert!(finished.statistics.visible > 0 && finished.overflowed == 0);
    }
    shown.vulkan.destroy(picture);
    shown.vulkan.destroy_frame(frame);
}

#[test]
fn images_that_are_none_or_go_nowhere_are_refused() {
    let shown = Shown::new(spgs_view_options { depth: 1, ..Default::default() });
    let usage = vk::ImageUsageFlags::TRANSFER_DST | vk::ImageUsageFlags::STORAGE;
    let picture = shown.vulkan.picture([64, 48], vk::Format::R8G8B8A8_UNORM, usage).unwrap();
    let frame = shown.vulkan.frame().unwrap();
    shown.vulkan.begin(frame).unwrap();
    assert_ne!(picture.view, vk::ImageView::null());
    let (camera, commands, good) = (camera(), frame.commands.as_raw() as *mut c_void, image(picture.image));
    let [none, lost, fresh, seen] = [
        spgs_image { image: 0, ..good },
        spgs_image { new_layout: 0, ..good },
        spgs_image { new_layout: 8, ..good },
        spgs_image { storage_view: picture.view.as_raw(), ..good },
    ];
    for (color, depth, said) in [
        (none, good, "target.color.image: found null"),
        (good, none, "target.depth.image: found null"),
        (lost, good, "target.color.new_layout: found VK_IMAGE_LAYOUT_UNDEFINED"),
        (good, fresh, "target.depth.new_layout: found VK_IMAGE_LAYOUT_PREINITIALIZED"),
        (seen, good, "colour image: found one with a storage view"),
        (good, seen, "depth image: found one with a storage view"),
    ] {
        let target = spgs_target { color, depth: &raw const depth };
        let status =
            unsafe { spgs_view_record(shown.view, commands, &raw const camera, 0.0, &raw const target, null_mut()) };
        assert!(status == 2 && message().contains(said), "{status} {}", message());
    }
    // Nothing was recorded.
    shown.vulkan.submit(frame).unwrap();
    shown.vulkan.wait(frame).unwrap();
    let stored = Shown::new(spgs_view_options { storage: 1, ..Default::default() });
    let target = spgs_target { color: image(picture.image), depth: null() };
    let status =
        unsafe { spgs_view_record(stored.view, commands, &raw const camera, 0.0, &raw const target, null_mut()) };
    assert!(status == 2 && message().contains("colour image: found one without a storage view"), "{}", message());
    shown.vulkan.destroy(picture);
    shown.vulkan.destroy_frame(frame);
}
