//! A sampled RGBA8 image with its descriptor set.

use std::sync::Arc;

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use super::device::{Gpu, Shared, lock, vk_error};
use super::memory::Buffer;
use crate::error::{Error, Result};

const FORMAT: vk::Format = vk::Format::R8G8B8A8_UNORM;

/// An image that fragment shaders sample.
pub(super) struct Texture {
    gpu: Arc<Shared>,
    raw: vk::Image,
    view: vk::ImageView,
    allocation: Option<Allocation>,
    pool: vk::DescriptorPool,
    pub(super) set: vk::DescriptorSet,
    size: [u32; 2],
    written: bool,
}

impl std::fmt::Debug for Texture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Texture({}x{})", self.size[0], self.size[1])
    }
}

impl Texture {
    /// An image of undefined content. The set is taken from `pool` and given back when the texture goes.
    pub(super) fn new(
        gpu: &Gpu,
        size: [u32; 2],
        pool: vk::DescriptorPool,
        layout: vk::DescriptorSetLayout,
        sampler: vk::Sampler,
    ) -> Result<Self> {
        let device = &gpu.0.device;
        let create = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(FORMAT)
            .extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(vk::ImageUsageFlags::SAMPLED | vk::ImageUsageFlags::TRANSFER_DST);
        // SAFETY: plain creation.
        let raw = unsafe { device.create_image(&create, None) }.map_err(vk_error("vkCreateImage"))?;
        // From here on `Drop` cleans up.
        let mut texture = Self {
            gpu: Arc::clone(&gpu.0),
            raw,
            view: vk::ImageView::null(),
            allocation: None,
            pool,
            set: vk::DescriptorSet::null(),
            size,
            written: false,
        };
        texture.bind_memory()?;
        texture.describe(layout, sampler)?;
        Ok(texture)
    }

    fn bind_memory(&mut self) -> Result<()> {
        let device = &self.gpu.device;
        // SAFETY: the image is live.
        let requirements = unsafe { device.get_image_memory_requirements(self.raw) };
        let describe = AllocationCreateDesc {
            name: "texture",
            requirements,
            location: MemoryLocation::GpuOnly,
            linear: false,
            allocation_scheme: AllocationScheme::GpuAllocatorManaged,
        };
        let allocated = lock(&self.gpu.allocator).as_mut().map(|a| a.allocate(&describe));
        let Some(Ok(allocation)) = allocated else {
            let need = requirements.size;
            return Err(Error::OutOfMemory { name: "texture".into(), need, free: 0, budget: 0 });
        };
        let allocation = self.allocation.insert(allocation);
        // SAFETY: the allocation satisfies the image's requirements.
        unsafe { device.bind_image_memory(self.raw, allocation.memory(), allocation.offset()) }
            .map_err(vk_error("vkBindImageMemory"))
    }

    fn describe(&mut self, layout: vk::DescriptorSetLayout, sampler: vk::Sampler) -> Result<()> {
        let device = &self.gpu.device;
        let view = vk::ImageViewCreateInfo::default()
            .image(self.raw)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(FORMAT)
            .subresource_range(whole());
        let layouts = [layout];
        let allocate = vk::DescriptorSetAllocateInfo::default().descriptor_pool(self.pool).set_layouts(&layouts);
        // SAFETY: plain creation from live handles.
        unsafe {
            self.view = device.create_image_view(&view, None).map_err(vk_error("vkCreateImageView"))?;
            self.set = device.allocate_descriptor_sets(&allocate).map_err(vk_error("vkAllocateDescriptorSets"))?[0];
            let images = [vk::DescriptorImageInfo::default()
                .image_view(self.view)
                .sampler(sampler)
                .image_layout(vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL)];
            let writes = [vk::WriteDescriptorSet::default()
                .dst_set(self.set)
                .descriptor_type(vk::DescriptorType::COMBINED_IMAGE_SAMPLER)
                .image_info(&images)];
            device.update_descriptor_sets(&writes, &[]);
        }
        Ok(())
    }

    /// Records the copy of `size` texels from `source` to `offset`; what lies outside the texture is not copied.
    pub(super) fn record_copy(
        &mut self,
        commands: vk::CommandBuffer,
        source: &Buffer,
        offset: [u32; 2],
        size: [u32; 2],
    ) {
        if offset[0] + size[0] > self.size[0] || offset[1] + size[1] > self.size[1] {
            return;
        }
        let read = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;
        let write = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        let before = if self.written { read } else { vk::ImageLayout::UNDEFINED };
        let (fragment, transfer) = (vk::PipelineStageFlags::FRAGMENT_SHADER, vk::PipelineStageFlags::TRANSFER);
        let barrier = |from, to, source_access, destination_access| {
            [vk::ImageMemoryBarrier::default()
                .image(self.raw)
                .old_layout(from)
                .new_layout(to)
                .src_access_mask(source_access)
                .dst_access_mask(destination_access)
                .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                .subresource_range(whole())]
        };
        let region = vk::BufferImageCopy::default()
            .image_subresource(layers())
            .image_offset(vk::Offset3D { x: offset[0] as i32, y: offset[1] as i32, z: 0 })
            .image_extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 });
        let none = vk::AccessFlags::empty();
        let opened = barrier(before, write, none, vk::AccessFlags::TRANSFER_WRITE);
        let closed = barrier(write, read, vk::AccessFlags::TRANSFER_WRITE, vk::AccessFlags::SHADER_READ);
        let device = &self.gpu.device;
        let flags = vk::DependencyFlags::empty();
        // SAFETY: recording; earlier frames sample the image in the stage that the first barrier waits for.
        unsafe {
            device.cmd_pipeline_barrier(commands, fragment | transfer, transfer, flags, &[], &[], &opened);
            device.cmd_copy_buffer_to_image(commands, source.raw(), self.raw, write, &[region]);
            device.cmd_pipeline_barrier(commands, transfer, fragment, flags, &[], &[], &closed);
        }
        self.written = true;
    }
}

impl Drop for Texture {
    fn drop(&mut self) {
        let device = &self.gpu.device;
        // SAFETY: the frames that sampled it have finished; null handles are ignored.
        unsafe {
            if self.set != vk::DescriptorSet::null() {
                let _ = device.free_descriptor_sets(self.pool, &[self.set]);
            }
            device.destroy_image_view(self.view, None);
            device.destroy_image(self.raw, None);
        }
        if let (Some(allocation), Some(allocator)) = (self.allocation.take(), lock(&self.gpu.allocator).as_mut())
            && let Err(error) = allocator.free(allocation)
        {
            log::error!("freeing a texture: {error}");
        }
    }
}

/// The colour of a whole image.
pub(super) fn whole() -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange::default().aspect_mask(vk::ImageAspectFlags::COLOR).level_count(1).layer_count(1)
}

/// The colour of a whole image, for copies.
pub(super) fn layers() -> vk::ImageSubresourceLayers {
    vk::ImageSubresourceLayers::default().aspect_mask(vk::ImageAspectFlags::COLOR).layer_count(1)
}
