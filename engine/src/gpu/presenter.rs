//! Shows pictures in a window: a picture that a kernel left in a buffer, and triangles over it.
//!
//! ```text
//! begin   waits for the frame before the last one, takes an image of the window
//! show    buffer → image (a copy on the device), triangles, hands the image to the window
//! ```
//!
//! Two frames may be in flight. Nothing is allocated per frame once buffers have their size.

use std::sync::atomic::Ordering;

use ash::vk;

use super::commands::Submission;
use super::device::{Gpu, vk_error};
use super::memory::Buffer;
use super::painter::{Kept, Mesh, Painter, TextureUpdate};
use super::surface::Surface;
use super::swapchain::Swapchain;
use super::texture::{layers, whole};
use crate::error::{Error, Result};

/// Frames that may be in flight.
const FRAMES: usize = 2;

/// One frame in flight.
struct Slot {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    /// Signalled when the window gives the image.
    acquired: vk::Semaphore,
    last: Submission,
    kept: Kept,
    /// What the frame copies from.
    picture: Option<Buffer>,
}

/// What lies over the picture.
#[derive(Debug)]
pub struct Overlay<'a, M> {
    /// Textures that changed.
    pub updates: &'a [TextureUpdate<'a>],
    /// Textures that are no longer used after this frame.
    pub forget: &'a [u64],
    /// Triangles, in order; called several times.
    pub meshes: M,
    /// Pixels per point of the triangles' coordinates.
    pub pixels_per_point: f32,
}

/// A window's swapchain with what is needed to fill it.
pub struct Presenter {
    gpu: Gpu,
    painter: Painter,
    slots: Vec<Slot>,
    turn: usize,
    acquired: Option<usize>,
    stale: bool,
    swapchain: Swapchain,
}

impl std::fmt::Debug for Presenter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Presenter({}x{})", self.swapchain.size[0], self.swapchain.size[1])
    }
}

impl Presenter {
    /// For a surface of [`Gpu::with_window`]. `vsync`: pictures change with the display, else as fast as they come.
    pub fn new(surface: Surface, vsync: bool) -> Result<Self> {
        let gpu = surface.gpu.clone();
        let swapchain = Swapchain::new(surface, vsync)?;
        let painter = Painter::new(&gpu, swapchain.render_pass)?;
        let mut presenter = Self { gpu, painter, slots: Vec::new(), turn: 0, acquired: None, stale: true, swapchain };
        for _ in 0..FRAMES {
            presenter.add_slot()?;
        }
        Ok(presenter)
    }

    fn add_slot(&mut self) -> Result<()> {
        let device = &self.gpu.0.device;
        let pool = vk::CommandPoolCreateInfo::default()
            .queue_family_index(self.gpu.0.family)
            .flags(vk::CommandPoolCreateFlags::TRANSIENT);
        // SAFETY: plain creation; what was pushed is destroyed by `Drop`.
        unsafe {
            let pool = device.create_command_pool(&pool, None).map_err(vk_error("vkCreateCommandPool"))?;
            self.slots.push(Slot {
                pool,
                commands: vk::CommandBuffer::null(),
                acquired: vk::Semaphore::null(),
                last: Submission::default(),
                kept: Kept::default(),
                picture: None,
            });
            let allocate = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
            let commands = device.allocate_command_buffers(&allocate).map_err(vk_error("vkAllocateCommandBuffers"))?;
            let semaphore = vk::SemaphoreCreateInfo::default();
            let acquired = device.create_semaphore(&semaphore, None).map_err(vk_error("vkCreateSemaphore"))?;
            if let Some(slot) = self.slots.last_mut() {
                (slot.commands, slot.acquired) = (commands[0], acquired);
            }
        }
        Ok(())
    }

    /// Size of the pictures that the window takes, pixels; zero while it is minimised.
    pub fn size(&self) -> [u32; 2] {
        self.swapchain.size
    }

    /// Whether pictures are packed as blue, green, red, alpha (from the lowest byte) instead of red, green, blue, alpha.
    pub fn is_bgra(&self) -> bool {
        self.swapchain.is_bgra()
    }

    /// The window has changed, or its size did not fit any more.
    pub fn is_stale(&self) -> bool {
        self.stale
    }

    /// Makes images for a window of this size. Blocks until the device is idle.
    pub fn resize(&mut self, size: [u32; 2], vsync: bool) -> Result<()> {
        self.release()?;
        self.swapchain.resize(size, vsync)?;
        self.stale = false;
        Ok(())
    }

    /// Lets go of an image that was taken and will not be shown: its semaphore is waited for, so that it can be signalled again
    /// or destroyed.
    fn release(&mut self) -> Result<()> {
        if self.acquired.take().is_none() {
            return Ok(());
        }
        let (waits, stages) = ([self.slots[self.turn].acquired], [vk::PipelineStageFlags::TRANSFER]);
        let submit = [vk::SubmitInfo::default().wait_semaphores(&waits).wait_dst_stage_mask(&stages)];
        let queue = self.gpu.0.lock_queue();
        // SAFETY: the semaphore is signalled by the image's acquisition and nobody waits for it; the queue is locked.
        unsafe { self.gpu.0.device.queue_submit(*queue, &submit, vk::Fence::null()) }
            .map_err(|code| self.gpu.vulkan_error("vkQueueSubmit", code))
    }

    /// Blocks until the device is idle; an image that was taken will not be shown. For the end: errors are only logged.
    pub fn rest(&mut self) {
        let (released, idle) = (self.release(), self.gpu.wait_idle());
        for error in [released, idle].into_iter().filter_map(Result::err) {
            log::debug!("closing the window: {error}");
        }
    }

    /// Takes an image of the window; false when there is none (minimised, or [`Presenter::resize`] is due).
    pub fn begin(&mut self) -> Result<bool> {
        if self.swapchain.raw == vk::SwapchainKHR::null() || self.stale {
            return Ok(false);
        }
        if self.acquired.is_some() {
            return Ok(true);
        }
        let slot = &self.slots[self.turn];
        self.gpu.wait(slot.last)?;
        match self.swapchain.acquire(slot.acquired)? {
            Some((index, suboptimal)) => {
                self.stale |= suboptimal;
                self.acquired = Some(index);
                Ok(true)
            }
            None => {
                self.stale = true;
                Ok(false)
            }
        }
    }

    /// Frames that were shown and that the device has not finished.
    pub fn in_flight(&self) -> Result<u64> {
        let mut count = 0;
        for slot in &self.slots {
            count += u64::from(!self.gpu.is_finished(slot.last)?);
        }
        Ok(count)
    }

    /// Shows `picture`, `uint[H,W]` of 8-bit values packed as [`Presenter::is_bgra`] says, with `overlay` on top. An
    /// image was taken by [`Presenter::begin`]. The picture may be written by submissions before and after this call.
    pub fn show<'a, I, M>(&mut self, picture: &Buffer, overlay: Overlay<'_, M>) -> Result<Submission>
    where
        I: Iterator<Item = Mesh<'a>>,
        M: Fn() -> I,
    {
        let Some(image) = self.acquired.take() else {
            return Err(Error::usage("presenter", "no image of the window", "`begin` before `show`"));
        };
        let [width, height] = self.swapchain.size;
        let need = u64::from(width) * u64::from(height) * 4;
        if picture.bytes() < need {
            let what = format!("bytes of `{}` for a window of {width}x{height}", picture.name());
            return Err(Error::Limit { what, need: need.into(), have: picture.bytes().into() });
        }
        let turn = self.turn;
        // Whoever made it may let go of it before the copy has run.
        self.slots[turn].picture = Some(picture.clone());
        self.painter.upload(&mut self.slots[turn].kept, &overlay.meshes)?;
        self.record(image, picture, overlay)?;
        let submission = self.submit(image)?;
        self.turn = (turn + 1) % self.slots.len();
        if !self.swapchain.present(image)? {
            self.stale = true;
        }
        Ok(submission)
    }

    fn record<'a, I, M>(&mut self, image: usize, picture: &Buffer, overlay: Overlay<'_, M>) -> Result<()>
    where
        I: Iterator<Item = Mesh<'a>>,
        M: Fn() -> I,
    {
        let device = &self.gpu.0.device;
        let slot = &mut self.slots[self.turn];
        let commands = slot.commands;
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: `begin` waited for the slot's last submission.
        unsafe {
            device
                .reset_command_pool(slot.pool, vk::CommandPoolResetFlags::empty())
                .map_err(vk_error("vkResetCommandPool"))?;
            device.begin_command_buffer(commands, &begin).map_err(vk_error("vkBeginCommandBuffer"))?;
        }
        self.painter.update(commands, &mut slot.kept, overlay.updates)?;
        for texture in overlay.forget {
            self.painter.forget(&mut slot.kept, *texture);
        }
        let target = &self.swapchain.images[image];
        let size = self.swapchain.size;
        record_copy(device, commands, picture, target.raw, size);
        let area = vk::Rect2D::default().extent(vk::Extent2D { width: size[0], height: size[1] });
        let pass = vk::RenderPassBeginInfo::default()
            .render_pass(self.swapchain.render_pass)
            .framebuffer(target.framebuffer)
            .render_area(area);
        // SAFETY: recording; the framebuffer belongs to the render pass.
        unsafe { device.cmd_begin_render_pass(commands, &pass, vk::SubpassContents::INLINE) };
        self.painter.draw(commands, &slot.kept, (overlay.meshes)(), size, overlay.pixels_per_point);
        // What is later made where the overlay's vertices lay, once their buffer is gone, is written after they were read. The
        // host has waited for that already, which the validation layer does not see.
        let (read, written) = (vk::PipelineStageFlags::VERTEX_INPUT, vk::PipelineStageFlags::TRANSFER);
        let written = written | vk::PipelineStageFlags::COMPUTE_SHADER;
        // SAFETY: as above.
        unsafe {
            device.cmd_end_render_pass(commands);
            device.cmd_pipeline_barrier(commands, read, written, vk::DependencyFlags::empty(), &[], &[], &[]);
            device.end_command_buffer(commands).map_err(vk_error("vkEndCommandBuffer"))
        }
    }

    fn submit(&mut self, image: usize) -> Result<Submission> {
        let slot = &mut self.slots[self.turn];
        let finished = self.swapchain.images[image].finished;
        let wait = (slot.acquired, vk::PipelineStageFlags::TRANSFER);
        slot.last = self.gpu.submit_between("present", slot.commands, wait, finished)?;
        slot.kept.used_by(slot.last);
        Ok(slot.last)
    }
}

/// Records the copy of a picture to an image, which is then in the layout for it.
fn record_copy(device: &ash::Device, commands: vk::CommandBuffer, picture: &Buffer, image: vk::Image, size: [u32; 2]) {
    let transfer = vk::PipelineStageFlags::TRANSFER;
    let written = [vk::MemoryBarrier::default().src_access_mask(vk::AccessFlags::SHADER_WRITE).dst_access_mask(
        vk::AccessFlags::TRANSFER_READ | vk::AccessFlags::VERTEX_ATTRIBUTE_READ | vk::AccessFlags::INDEX_READ,
    )];
    let layout = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
    let opened = [vk::ImageMemoryBarrier::default()
        .image(image)
        .old_layout(vk::ImageLayout::UNDEFINED)
        .new_layout(layout)
        .dst_access_mask(vk::AccessFlags::TRANSFER_WRITE)
        .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .subresource_range(whole())];
    let region = vk::BufferImageCopy::default().image_subresource(layers()).image_extent(vk::Extent3D {
        width: size[0],
        height: size[1],
        depth: 1,
    });
    let compute = vk::PipelineStageFlags::COMPUTE_SHADER;
    // The overlay's vertices may lie where a buffer that is gone was written.
    let read = transfer | vk::PipelineStageFlags::VERTEX_INPUT;
    // SAFETY: recording. The submission waits for the image in the transfer stage, from which the barrier goes on.
    unsafe {
        let flags = vk::DependencyFlags::empty();
        device.cmd_pipeline_barrier(commands, compute | transfer, read, flags, &written, &[], &opened);
        device.cmd_copy_buffer_to_image(commands, picture.raw(), image, layout, &[region]);
    }
}

impl Gpu {
    /// Submits a raw command buffer between two binary semaphores: it waits for the first in its stage and signals the
    /// second.
    fn submit_between(
        &self,
        call: &'static str,
        commands: vk::CommandBuffer,
        (wait, stage): (vk::Semaphore, vk::PipelineStageFlags),
        signal: vk::Semaphore,
    ) -> Result<Submission> {
        let shared = &self.0;
        let queue = shared.lock_queue();
        let value = shared.submissions.load(Ordering::SeqCst) + 1;
        let (waits, stages, buffers) = ([wait], [stage], [commands]);
        let signals = [shared.timeline, signal];
        // A binary semaphore has a value too, which is ignored.
        let values = [value, 0];
        let mut timeline = vk::TimelineSemaphoreSubmitInfo::default().signal_semaphore_values(&values);
        let submit = [vk::SubmitInfo::default()
            .wait_semaphores(&waits)
            .wait_dst_stage_mask(&stages)
            .command_buffers(&buffers)
            .signal_semaphores(&signals)
            .push_next(&mut timeline)];
        // SAFETY: the command buffer is recorded and not pending; the queue is locked.
        match unsafe { shared.device.queue_submit(*queue, &submit, vk::Fence::null()) } {
            Ok(()) => {
                shared.submissions.store(value, Ordering::SeqCst);
                Ok(Submission(value))
            }
            Err(code) => Err(self.vulkan_error(call, code)),
        }
    }
}

impl Drop for Presenter {
    fn drop(&mut self) {
        self.rest();
        let device = &self.gpu.0.device;
        for slot in self.slots.drain(..) {
            // SAFETY: the device is idle or lost; null handles are ignored.
            unsafe {
                device.destroy_semaphore(slot.acquired, None);
                device.destroy_command_pool(slot.pool, None);
            }
        }
    }
}
