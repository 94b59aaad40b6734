//! The engine inside another program: its device, its command buffers, its images; several scenes and views; memory; threads.
//! The host follows the documentation, and the validation layer has nothing to say.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "tests")]
#![allow(clippy::undocumented_unsafe_blocks, reason = "nearly every line is a raw Vulkan call")]

#[path = "../../examples/host/composite.rs"]
mod composite;
mod example;
mod facts;
mod growth;
mod input;
mod pictures;
mod several;
mod steady;
#[path = "../../examples/host/vulkan.rs"]
mod vulkan;

use std::sync::Arc;

use ash::vk::{self, Handle as _};
use engine::gpu::{Gpu, HostCommandBuffer, HostImage, ImageUse};
use engine::render::{PixelFormat, Recorded, Target, View};
use engine::scene::Camera;
use vulkan::{Frame, Picture, Vulkan};

/// A host whose validation messages must be empty when it goes, with the engine on its device.
struct Host {
    gpu: Option<Gpu>,
    vulkan: Arc<Vulkan>,
}

impl Host {
    fn new() -> Self {
        let validation = std::env::var("SPGS_VALIDATION").is_ok_and(|v| v != "0" && !v.is_empty());
        let vulkan = Vulkan::new(validation).expect("tests need a Vulkan device (run ci/setup --tests)");
        Self { gpu: Some(composite::engine_on(&vulkan).unwrap()), vulkan }
    }

    fn gpu(&self) -> &Gpu {
        self.gpu.as_ref().unwrap()
    }

    /// An image that the engine writes and the host reads.
    fn picture(&self, size: [u32; 2], format: vk::Format) -> Picture {
        let stored = if format == vk::Format::B8G8R8A8_UNORM {
            vk::ImageUsageFlags::empty()
        } else {
            vk::ImageUsageFlags::STORAGE
        };
        let usage = vk::ImageUsageFlags::TRANSFER_DST | vk::ImageUsageFlags::TRANSFER_SRC | stored;
        self.vulkan.picture(size, format, usage).unwrap()
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        self.gpu = None;
        let messages = self.vulkan.messages();
        if !messages.is_empty() && !std::thread::panicking() {
            panic!("the validation layer reported {} messages, first: {}", messages.len(), messages[0]);
        }
    }
}

/// Written whatever it held, then read by the host.
fn to_read(picture: Picture) -> HostImage {
    unsafe { HostImage::from_raw(picture.image.as_raw(), READ_BEFORE, ImageUse::TRANSFER_SOURCE) }
}

/// The same, written by a kernel.
fn to_store(picture: Picture) -> HostImage {
    unsafe { to_read(picture).with_storage_view(picture.view.as_raw()) }
}

/// An earlier copy out of the image is waited for.
const READ_BEFORE: ImageUse = ImageUse { layout: 0, ..ImageUse::TRANSFER_SOURCE };

fn commands_of(frame: Frame) -> HostCommandBuffer {
    unsafe { HostCommandBuffer::from_raw(frame.commands.as_raw()) }
}

/// Records one frame in a command buffer of its own, and submits it.
fn submit(host: &Host, frame: Frame, view: &mut View, camera: &Camera, time: f64, target: &Target) -> Recorded {
    host.vulkan.begin(frame).unwrap();
    let recorded = view.record(&commands_of(frame), camera, time, target).unwrap();
    host.vulkan.submit(frame).unwrap();
    recorded
}

fn vk_format(format: PixelFormat) -> vk::Format {
    match format {
        PixelFormat::Rgba8 => vk::Format::R8G8B8A8_UNORM,
        PixelFormat::Bgra8 => vk::Format::B8G8R8A8_UNORM,
        PixelFormat::Rgba16F => vk::Format::R16G16B16A16_SFLOAT,
        PixelFormat::Rgba32F => vk::Format::R32G32B32A32_SFLOAT,
    }
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}
