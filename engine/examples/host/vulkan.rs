//! The host's own Vulkan, as any program has it: instance, device, queue, images, command buffers. Nothing of it knows the
//! engine.
#![allow(dead_code, reason = "the tests use more of it than the example")]

use std::ffi::{CStr, c_void};
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use ash::vk;

/// Any error of the host.
pub(crate) type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// Instance, device and one queue.
pub(crate) struct Vulkan {
    pub(crate) entry: ash::Entry,
    pub(crate) instance: ash::Instance,
    pub(crate) physical: vk::PhysicalDevice,
    pub(crate) device: ash::Device,
    pub(crate) family: u32,
    pub(crate) queue: vk::Queue,
    /// Whose turn it is to submit to the queue.
    pub(crate) turn: Arc<Turn>,
    messenger: Option<(ash::ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    messages: Box<Mutex<Vec<String>>>,
}

/// A lock that is taken in one call and given back in another.
#[derive(Debug, Default)]
pub(crate) struct Turn {
    taken: Mutex<bool>,
    freed: Condvar,
}

impl Turn {
    pub(crate) fn take(&self) {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        while *taken {
            taken = self.freed.wait(taken).unwrap_or_else(PoisonError::into_inner);
        }
        *taken = true;
    }

    pub(crate) fn give_back(&self) {
        *self.taken.lock().unwrap_or_else(PoisonError::into_inner) = false;
        self.freed.notify_one();
    }
}

/// An image with its memory and view.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Picture {
    pub(crate) image: vk::Image,
    pub(crate) view: vk::ImageView,
    pub(crate) size: [u32; 2],
    memory: vk::DeviceMemory,
}

/// A buffer that the host reads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HostBuffer {
    pub(crate) raw: vk::Buffer,
    pub(crate) bytes: u64,
    memory: vk::DeviceMemory,
}

/// A command buffer in a pool of its own, and the fence of its last submission.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    pub(crate) commands: vk::CommandBuffer,
    pool: vk::CommandPool,
    fence: vk::Fence,
}

unsafe extern "system" fn on_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    let (text, list) =
        unsafe { (CStr::from_ptr((*data).p_message).to_string_lossy(), &*user.cast::<Mutex<Vec<String>>>()) };
    list.lock().unwrap_or_else(PoisonError::into_inner).push(text.into_owned());
    vk::FALSE
}

impl Vulkan {
    /// A device with what the engine requires, and dynamic rendering for the host's own drawing. `validation`: with the
    /// Khronos layer, synchronisation included.
    pub(crate) fn new(validation: bool) -> Result<Arc<Self>> {
        let entry = unsafe { ash::Entry::load()? };
        let app = vk::ApplicationInfo::default().application_name(c"host").api_version(vk::API_VERSION_1_3);
        let layers = [c"VK_LAYER_KHRONOS_validation".as_ptr()];
        let extensions = [ash::ext::debug_utils::NAME.as_ptr(), ash::ext::validation_features::NAME.as_ptr()];
        let used = usize::from(validation);
        let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
        let mut create = vk::InstanceCreateInfo::default()
            .application_info(&app)
            .enabled_layer_names(&layers[..used])
            .enabled_extension_names(&extensions[..2 * used]);
        if validation {
            create = create.push_next(&mut features);
        }
        let instance = unsafe { entry.create_instance(&create, None)? };
        let messages = Box::new(Mutex::new(Vec::new()));
        let messenger = if validation {
            let loader = ash::ext::debug_utils::Instance::new(&entry, &instance);
            let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
                .message_severity(
                    vk::DebugUtilsMessageSeverityFlagsEXT::ERROR | vk::DebugUtilsMessageSeverityFlagsEXT::WARNING,
                )
                .message_type(
                    vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION | vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE,
                )
                .pfn_user_callback(Some(on_message))
                .user_data((&raw const *messages).cast_mut().cast());
            let made = unsafe { loader.create_debug_utils_messenger(&create, None)? };
            Some((loader, made))
        } else {
            None
        };
        let physical = Self::choose(&instance)?;
        let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
        let both = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
        let family =
            families.iter().position(|f| f.queue_flags.contains(both)).ok_or("no graphics and compute queue")?;
        let family = family as u32;
        let priorities = [1.0];
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&priorities)];
        // What engine::gpu::host::host_requirements(VK_API_VERSION_1_3) lists, and dynamicRendering.
        let mut vulkan_12 = vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true);
        let mut vulkan_13 = vk::PhysicalDeviceVulkan13Features::default()
            .synchronization2(true)
            .subgroup_size_control(true)
            .compute_full_subgroups(true)
            .dynamic_rendering(true);
        let create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .push_next(&mut vulkan_12)
            .push_next(&mut vulkan_13);
        let device = unsafe { instance.create_device(physical, &create, None)? };
        let (queue, turn) = (unsafe { device.get_device_queue(family, 0) }, Arc::default());
        Ok(Arc::new(Self { entry, instance, physical, device, family, queue, turn, messenger, messages }))
    }

    /// `SPGS_DEVICE`, an index or part of a name; else the first device with Vulkan 1.3.
    fn choose(instance: &ash::Instance) -> Result<vk::PhysicalDevice> {
        let wanted = std::env::var("SPGS_DEVICE").unwrap_or_default().to_lowercase();
        let all = unsafe { instance.enumerate_physical_devices()? };
        let fits = |(index, device): &(usize, &vk::PhysicalDevice)| {
            let properties = unsafe { instance.get_physical_device_properties(**device) };
            let name = properties.device_name_as_c_str().map(CStr::to_string_lossy).unwrap_or_default().to_lowercase();
            properties.api_version >= vk::API_VERSION_1_3 && (name.contains(&wanted) || index.to_string() == wanted)
        };
        Ok(*all.iter().enumerate().find(fits).ok_or("no device with Vulkan 1.3")?.1)
    }

    /// Whether the validation layer looks on.
    pub(crate) fn validates(&self) -> bool {
        self.messenger.is_some()
    }

    /// What the validation layer has said since the last call.
    pub(crate) fn take_messages(&self) -> Vec<String> {
        std::mem::take(&mut self.messages.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// What the validation layer has said so far.
    pub(crate) fn messages(&self) -> Vec<String> {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn memory(&self, needs: vk::MemoryRequirements, flags: vk::MemoryPropertyFlags) -> Result<vk::DeviceMemory> {
        let properties = unsafe { self.instance.get_physical_device_memory_properties(self.physical) };
        let fits = |i: &u32| {
            needs.memory_type_bits >> i & 1 == 1 && properties.memory_types[*i as usize].property_flags.contains(flags)
        };
        let index = (0..properties.memory_type_count).find(fits).ok_or("no such memory")?;
        let allocate = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(index);
        Ok(unsafe { self.device.allocate_memory(&allocate, None)? })
    }

    /// An image in device memory.
    pub(crate) fn picture(&self, size: [u32; 2], format: vk::Format, usage: vk::ImageUsageFlags) -> Result<Picture> {
        let depth = format == vk::Format::D32_SFLOAT;
        let create = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(format)
            .extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(usage);
        let image = unsafe { self.device.create_image(&create, None)? };
        let needs = unsafe { self.device.get_image_memory_requirements(image) };
        let memory = self.memory(needs, vk::MemoryPropertyFlags::empty())?;
        unsafe { self.device.bind_image_memory(image, memory, 0)? };
        let viewable = vk::ImageUsageFlags::SAMPLED
            | vk::ImageUsageFlags::STORAGE
            | vk::ImageUsageFlags::COLOR_ATTACHMENT
            | vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT;
        let mut view = vk::ImageView::null();
        if usage.intersects(viewable) {
            let create = vk::ImageViewCreateInfo::default()
                .image(image)
                .view_type(vk::ImageViewType::TYPE_2D)
                .format(format)
                .subresource_range(layers(depth));
            view = unsafe { self.device.create_image_view(&create, None)? };
        }
        Ok(Picture { image, view, size, memory })
    }

    /// Frees an image that is not in use any more.
    pub(crate) fn destroy(&self, picture: Picture) {
        unsafe {
            self.device.destroy_image_view(picture.view, None);
            self.device.destroy_image(picture.image, None);
            self.device.free_memory(picture.memory, None);
        }
    }

    /// A buffer that the device copies to and the host reads.
    pub(crate) fn host_buffer(&self, bytes: u64) -> Result<HostBuffer> {
        let create = vk::BufferCreateInfo::default().size(bytes).usage(vk::BufferUsageFlags::TRANSFER_DST);
        let raw = unsafe { self.device.create_buffer(&create, None)? };
        let needs = unsafe { self.device.get_buffer_memory_requirements(raw) };
        let flags = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
        let memory = self.memory(needs, flags)?;
        unsafe { self.device.bind_buffer_memory(raw, memory, 0)? };
        Ok(HostBuffer { raw, bytes, memory })
    }

    /// A command buffer with its fence, signalled.
    pub(crate) fn frame(&self) -> Result<Frame> {
        let create = vk::CommandPoolCreateInfo::default().queue_family_index(self.family);
        let pool = unsafe { self.device.create_command_pool(&create, None)? };
        let allocate = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
        let commands = unsafe { self.device.allocate_command_buffers(&allocate)? }[0];
        let create = vk::FenceCreateInfo::default().flags(vk::FenceCreateFlags::SIGNALED);
        let fence = unsafe { self.device.create_fence(&create, None)? };
        Ok(Frame { commands, pool, fence })
    }

    /// Waits until the frame's last submission has finished, and begins to record it anew.
    pub(crate) fn begin(&self, frame: Frame) -> Result<()> {
        let once = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        unsafe {
            self.device.wait_for_fences(&[frame.fence], true, u64::MAX)?;
            self.device.reset_fences(&[frame.fence])?;
            self.device.reset_command_pool(frame.pool, vk::CommandPoolResetFlags::empty())?;
            Ok(self.device.begin_command_buffer(frame.commands, &once)?)
        }
    }

    /// Ends the recording and submits it.
    pub(crate) fn submit(&self, frame: Frame) -> Result<()> {
        let commands = [frame.commands];
        let submit = [vk::SubmitInfo::default().command_buffers(&commands)];
        unsafe { self.device.end_command_buffer(frame.commands)? };
        self.turn.take();
        let submitted = unsafe { self.device.queue_submit(self.queue, &submit, frame.fence) };
        self.turn.give_back();
        Ok(submitted?)
    }

    /// Waits for a submitted frame.
    pub(crate) fn wait(&self, frame: Frame) -> Result<()> {
        unsafe { self.device.wait_for_fences(&[frame.fence], true, u64::MAX)? };
        Ok(())
    }

    /// Frees a frame that has finished.
    pub(crate) fn destroy_frame(&self, frame: Frame) {
        unsafe {
            self.device.destroy_fence(frame.fence, None);
            self.device.destroy_command_pool(frame.pool, None);
        }
    }

    /// Reads an image in layout `TRANSFER_SRC_OPTIMAL`, whose writes were made visible to transfers.
    pub(crate) fn read(&self, picture: Picture, pixel_bytes: u64) -> Result<Vec<u8>> {
        let [width, height] = picture.size;
        let buffer = self.host_buffer(u64::from(width) * u64::from(height) * pixel_bytes)?;
        let frame = self.frame()?;
        self.begin(frame)?;
        let region = [vk::BufferImageCopy::default()
            .image_subresource(
                vk::ImageSubresourceLayers::default().aspect_mask(vk::ImageAspectFlags::COLOR).layer_count(1),
            )
            .image_extent(vk::Extent3D { width, height, depth: 1 })];
        let visible = [vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::TRANSFER)
            .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::HOST)
            .dst_access_mask(vk::AccessFlags2::HOST_READ)];
        let layout = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        unsafe {
            self.device.cmd_copy_image_to_buffer(frame.commands, picture.image, layout, buffer.raw, &region);
            let dependency = vk::DependencyInfo::default().memory_barriers(&visible);
            self.device.cmd_pipeline_barrier2(frame.commands, &dependency);
        }
        self.submit(frame)?;
        self.wait(frame)?;
        let mut bytes = vec![0; buffer.bytes as usize];
        unsafe {
            let flags = vk::MemoryMapFlags::empty();
            let mapped = self.device.map_memory(buffer.memory, 0, vk::WHOLE_SIZE, flags)?.cast::<u8>();
            std::ptr::copy_nonoverlapping(mapped, bytes.as_mut_ptr(), bytes.len());
            self.device.destroy_buffer(buffer.raw, None);
            self.device.free_memory(buffer.memory, None);
        }
        self.destroy_frame(frame);
        Ok(bytes)
    }
}

impl Drop for Vulkan {
    fn drop(&mut self) {
        unsafe {
            let _ = self.device.device_wait_idle();
            self.device.destroy_device(None);
            if let Some((loader, messenger)) = &self.messenger {
                loader.destroy_debug_utils_messenger(*messenger, None);
            }
            self.instance.destroy_instance(None);
        }
    }
}

/// The first layer and level of an image.
pub(crate) fn layers(depth: bool) -> vk::ImageSubresourceRange {
    let aspect = if depth { vk::ImageAspectFlags::DEPTH } else { vk::ImageAspectFlags::COLOR };
    vk::ImageSubresourceRange::default().aspect_mask(aspect).level_count(1).layer_count(1)
}
