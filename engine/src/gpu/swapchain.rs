//! The images of a window: made for its size, made anew when it changes.

use ash::vk;

use super::device::vk_error;
use super::surface::Surface;
use crate::error::{Error, Result};

/// Colour formats that hold values as they are (no sRGB encoding), in order of preference.
const FORMATS: [vk::Format; 2] = [vk::Format::B8G8R8A8_UNORM, vk::Format::R8G8B8A8_UNORM];

/// A window's images with what drawing into them needs.
pub(super) struct Swapchain {
    pub(super) surface: Surface,
    loader: ash::khr::swapchain::Device,
    pub(super) raw: vk::SwapchainKHR,
    pub(super) format: vk::SurfaceFormatKHR,
    pub(super) size: [u32; 2],
    pub(super) render_pass: vk::RenderPass,
    pub(super) images: Vec<SwapchainImage>,
    vsync: bool,
}

/// One image of the window.
#[derive(Default)]
pub(super) struct SwapchainImage {
    pub(super) raw: vk::Image,
    view: vk::ImageView,
    pub(super) framebuffer: vk::Framebuffer,
    /// Signalled when the image is ready to be shown.
    pub(super) finished: vk::Semaphore,
}

impl Swapchain {
    /// Chooses a format and makes the render pass; there are no images before [`Swapchain::resize`].
    pub(super) fn new(surface: Surface, vsync: bool) -> Result<Self> {
        let shared = surface.gpu.0.clone();
        // SAFETY: plain query of live handles.
        let formats = unsafe { surface.loader.get_physical_device_surface_formats(shared.physical, surface.raw) }
            .map_err(vk_error("vkGetPhysicalDeviceSurfaceFormatsKHR"))?;
        let wanted = FORMATS.iter().find_map(|f| formats.iter().find(|s| s.format == *f));
        let format = *wanted.ok_or_else(|| Error::NoDevice {
            reason: format!(
                "the window takes none of {FORMATS:?}, only {:?}",
                formats.iter().map(|f| f.format).collect::<Vec<_>>()
            ),
        })?;
        let loader = ash::khr::swapchain::Device::new(&shared.instance, &shared.device);
        let render_pass = create_render_pass(&shared.device, format.format)?;
        Ok(Self {
            surface,
            loader,
            raw: vk::SwapchainKHR::null(),
            format,
            size: [0, 0],
            render_pass,
            images: Vec::new(),
            vsync,
        })
    }

    /// Whether red and blue change places in memory.
    pub(super) fn is_bgra(&self) -> bool {
        self.format.format == vk::Format::B8G8R8A8_UNORM
    }

    /// Makes the images for a window of `wanted` pixels. A minimised window has none; `size` is then zero.
    pub(super) fn resize(&mut self, wanted: [u32; 2], vsync: bool) -> Result<()> {
        let gpu = self.surface.gpu.clone();
        gpu.wait_idle()?;
        self.destroy_images();
        self.vsync = vsync;
        let surface = &self.surface;
        // SAFETY: plain query of live handles.
        let capabilities =
            unsafe { surface.loader.get_physical_device_surface_capabilities(gpu.0.physical, surface.raw) }
                .map_err(|code| gpu.vulkan_error("vkGetPhysicalDeviceSurfaceCapabilitiesKHR", code))?;
        let extent = extent(&capabilities, wanted);
        self.size = [extent.width, extent.height];
        if extent.width == 0 || extent.height == 0 {
            self.size = [0, 0];
            return self.destroy_chain();
        }
        let most = if capabilities.max_image_count == 0 { u32::MAX } else { capabilities.max_image_count };
        let usage = vk::ImageUsageFlags::TRANSFER_DST | vk::ImageUsageFlags::COLOR_ATTACHMENT;
        if !capabilities.supported_usage_flags.contains(usage) {
            let reason = format!("the window's images allow {:?} only", capabilities.supported_usage_flags);
            return Err(Error::NoDevice { reason });
        }
        let alpha = [vk::CompositeAlphaFlagsKHR::OPAQUE, vk::CompositeAlphaFlagsKHR::INHERIT];
        let alpha = alpha.into_iter().find(|a| capabilities.supported_composite_alpha.contains(*a));
        let old = self.raw;
        let create = vk::SwapchainCreateInfoKHR::default()
            .surface(surface.raw)
            .min_image_count(3.clamp(capabilities.min_image_count, most))
            .image_format(self.format.format)
            .image_color_space(self.format.color_space)
            .image_extent(extent)
            .image_array_layers(1)
            .image_usage(usage)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(capabilities.current_transform)
            .composite_alpha(alpha.unwrap_or(vk::CompositeAlphaFlagsKHR::OPAQUE))
            .present_mode(self.present_mode()?)
            .clipped(true)
            .old_swapchain(old);
        // SAFETY: the surface is live and its old swapchain is handed over.
        let made = unsafe { self.loader.create_swapchain(&create, None) };
        self.destroy_chain()?;
        self.raw = made.map_err(|code| gpu.vulkan_error("vkCreateSwapchainKHR", code))?;
        self.create_images()
    }

    fn present_mode(&self) -> Result<vk::PresentModeKHR> {
        let surface = &self.surface;
        let physical = surface.gpu.0.physical;
        // SAFETY: plain query of live handles.
        let modes = unsafe { surface.loader.get_physical_device_surface_present_modes(physical, surface.raw) }
            .map_err(vk_error("vkGetPhysicalDeviceSurfacePresentModesKHR"))?;
        let free = [vk::PresentModeKHR::MAILBOX, vk::PresentModeKHR::IMMEDIATE];
        let chosen = if self.vsync { None } else { free.into_iter().find(|m| modes.contains(m)) };
        Ok(chosen.unwrap_or(vk::PresentModeKHR::FIFO))
    }

    fn create_images(&mut self) -> Result<()> {
        let device = &self.surface.gpu.0.device;
        // SAFETY: live swapchain.
        let raw = unsafe { self.loader.get_swapchain_images(self.raw) }.map_err(vk_error("vkGetSwapchainImagesKHR"))?;
        for image in raw {
            // Pushed first, so that what is made is destroyed when a later call fails.
            self.images.push(SwapchainImage { raw: image, ..SwapchainImage::default() });
            let Some(slot) = self.images.last_mut() else { continue };
            let range = vk::ImageSubresourceRange::default()
                .aspect_mask(vk::ImageAspectFlags::COLOR)
                .level_count(1)
                .layer_count(1);
            let view = vk::ImageViewCreateInfo::default()
                .image(image)
                .view_type(vk::ImageViewType::TYPE_2D)
                .format(self.format.format)
                .subresource_range(range);
            // SAFETY: plain creation from live handles.
            unsafe {
                slot.view = device.create_image_view(&view, None).map_err(vk_error("vkCreateImageView"))?;
                let views = [slot.view];
                let create = vk::FramebufferCreateInfo::default()
                    .render_pass(self.render_pass)
                    .attachments(&views)
                    .width(self.size[0])
                    .height(self.size[1])
                    .layers(1);
                slot.framebuffer = device.create_framebuffer(&create, None).map_err(vk_error("vkCreateFramebuffer"))?;
                slot.finished = device
                    .create_semaphore(&vk::SemaphoreCreateInfo::default(), None)
                    .map_err(vk_error("vkCreateSemaphore"))?;
            }
        }
        Ok(())
    }

    /// The next image; `None` when the images no longer fit the window.
    pub(super) fn acquire(&self, ready: vk::Semaphore) -> Result<Option<(usize, bool)>> {
        let gpu = &self.surface.gpu;
        let timeout = (gpu.0.options.timeout_s.clamp(0.001, 1e6) * 1e9) as u64;
        // SAFETY: live handles; the semaphore is unsignalled and nobody waits for it.
        match unsafe { self.loader.acquire_next_image(self.raw, timeout, ready, vk::Fence::null()) } {
            Ok((index, suboptimal)) => Ok(Some((index as usize, suboptimal))),
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => Ok(None),
            Err(code) => Err(gpu.vulkan_error("vkAcquireNextImageKHR", code)),
        }
    }

    /// Shows an image; false when the images no longer fit the window.
    pub(super) fn present(&self, index: usize) -> Result<bool> {
        let gpu = &self.surface.gpu;
        let waits = [self.images[index].finished];
        let chains = [self.raw];
        let indices = [index as u32];
        let present = vk::PresentInfoKHR::default().wait_semaphores(&waits).swapchains(&chains).image_indices(&indices);
        let queue = gpu.0.lock_queue();
        // SAFETY: the queue is locked; the semaphore is signalled by the submission before.
        match unsafe { self.loader.queue_present(*queue, &present) } {
            Ok(suboptimal) => Ok(!suboptimal),
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => Ok(false),
            Err(code) => Err(gpu.vulkan_error("vkQueuePresentKHR", code)),
        }
    }

    fn destroy_images(&mut self) {
        let device = &self.surface.gpu.0.device;
        for image in self.images.drain(..) {
            // SAFETY: the device is idle; null handles are ignored.
            unsafe {
                device.destroy_semaphore(image.finished, None);
                device.destroy_framebuffer(image.framebuffer, None);
                device.destroy_image_view(image.view, None);
            }
        }
    }

    fn destroy_chain(&mut self) -> Result<()> {
        // SAFETY: the device is idle and nothing made from its images is left; null is ignored.
        unsafe { self.loader.destroy_swapchain(self.raw, None) };
        self.raw = vk::SwapchainKHR::null();
        Ok(())
    }
}

impl Drop for Swapchain {
    fn drop(&mut self) {
        if let Err(error) = self.surface.gpu.wait_idle() {
            log::debug!("closing the window: {error}");
        }
        self.destroy_images();
        let _ = self.destroy_chain();
        // SAFETY: the device is idle or lost.
        unsafe { self.surface.gpu.0.device.destroy_render_pass(self.render_pass, None) };
    }
}

fn extent(capabilities: &vk::SurfaceCapabilitiesKHR, wanted: [u32; 2]) -> vk::Extent2D {
    if capabilities.current_extent.width != u32::MAX {
        return capabilities.current_extent;
    }
    let (low, high) = (capabilities.min_image_extent, capabilities.max_image_extent);
    vk::Extent2D {
        width: wanted[0].min(high.width).max(low.width.min(wanted[0])),
        height: wanted[1].min(high.height).max(low.height.min(wanted[1])),
    }
}

/// One colour attachment that holds the scene already and is shown afterwards.
fn create_render_pass(device: &ash::Device, format: vk::Format) -> Result<vk::RenderPass> {
    let attachments = [vk::AttachmentDescription::default()
        .format(format)
        .samples(vk::SampleCountFlags::TYPE_1)
        .load_op(vk::AttachmentLoadOp::LOAD)
        .store_op(vk::AttachmentStoreOp::STORE)
        .initial_layout(vk::ImageLayout::TRANSFER_DST_OPTIMAL)
        .final_layout(vk::ImageLayout::PRESENT_SRC_KHR)];
    let colors = [vk::AttachmentReference::default().attachment(0).layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)];
    let subpasses = [vk::SubpassDescription::default().color_attachments(&colors)];
    let dependencies = [vk::SubpassDependency::default()
        .src_subpass(vk::SUBPASS_EXTERNAL)
        .dst_subpass(0)
        .src_stage_mask(vk::PipelineStageFlags::TRANSFER)
        .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
        .dst_stage_mask(vk::PipelineStageFlags::COLOR_ATTACHMENT_OUTPUT)
        .dst_access_mask(vk::AccessFlags::COLOR_ATTACHMENT_READ | vk::AccessFlags::COLOR_ATTACHMENT_WRITE)];
    let create =
        vk::RenderPassCreateInfo::default().attachments(&attachments).subpasses(&subpasses).dependencies(&dependencies);
    // SAFETY: plain creation.
    unsafe { device.create_render_pass(&create, None) }.map_err(vk_error("vkCreateRenderPass"))
}
