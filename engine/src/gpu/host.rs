//! Working inside another program: its Vulkan device, its queue, its command buffers and its images.
//!
//! Handles cross this border as the numbers that they are in C (dispatchable ones as the pointer's value, `ash`'s
//! `Handle::as_raw`), layouts, stages and access masks as the values of `VkImageLayout`, `VkPipelineStageFlags2` and
//! `VkAccessFlags2`. So a host needs no particular version of a Vulkan binding, and C gets the same calls.
//!
//! What a host must do to make a device that the engine can work on is said by [`host_requirements`]; that an existing
//! physical device is good enough is checked by [`Gpu::from_host`].

use std::ffi::{CStr, c_char, c_void};
use std::sync::Arc;

use ash::vk::{self, Handle as _};

use super::capability::DeviceInfo;
use super::device::{Gpu, Opened};
use super::instance::Messages;
use super::options::GpuOptions;
use super::reconvergence::Reconvergence;
use crate::error::{Error, Result};

/// `PFN_vkVoidFunction`.
pub type VoidFunction = Option<unsafe extern "system" fn()>;
/// `PFN_vkGetInstanceProcAddr`; the instance as a pointer, null for global functions.
pub type GetInstanceProcAddr = unsafe extern "system" fn(instance: *mut c_void, name: *const c_char) -> VoidFunction;

/// Guards a queue that host and engine both submit to: `vkQueueSubmit` must be externally synchronised. The engine holds it
/// for the length of one `vkQueueSubmit`, and only while a scene is uploaded or a view is warmed up; recording into a
/// host's command buffer submits nothing.
pub trait QueueLock: Send + Sync {
    /// Blocks until nobody else submits.
    fn lock(&self);
    /// Lets others submit again.
    fn unlock(&self);
}

/// A host's Vulkan device. The engine never destroys any of it.
#[derive(Clone)]
pub struct HostDevice {
    /// Where Vulkan's functions come from; `None`: the system's loader (`libvulkan.so.1`).
    pub get_instance_proc_addr: Option<GetInstanceProcAddr>,
    /// `VkApplicationInfo::apiVersion` of the instance: Vulkan 1.2 or later.
    pub api_version: u32,
    /// `VkInstance`.
    pub instance: u64,
    /// `VkPhysicalDevice`.
    pub physical_device: u64,
    /// `VkDevice`, made with what [`host_requirements`] lists.
    pub device: u64,
    /// `VkQueue` for the engine's own submissions (uploads). A second queue of the family needs no lock.
    pub queue: u64,
    /// Family of that queue, and of the command buffers that frames are recorded into; it must support compute.
    pub queue_family: u32,
    /// Taken around each of the engine's submissions; `None`: the host promises that nobody submits to the queue meanwhile.
    pub queue_lock: Option<Arc<dyn QueueLock>>,
}

impl std::fmt::Debug for HostDevice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "HostDevice(device {:#x}, queue {:#x} of family {})", self.device, self.queue, self.queue_family)
    }
}

/// What a host must enable when it makes the device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HostRequirements {
    /// Device extensions, beside those of [`HostRequirements::extensions_if_present`].
    pub extensions: Vec<&'static CStr>,
    /// Device extensions that must be enabled where the device has them.
    pub extensions_if_present: Vec<&'static CStr>,
    /// Members of `VkPhysicalDevice…Features` structures that must be true.
    pub features: Vec<&'static str>,
}

/// What a host must enable on a device when its instance was made for Vulkan `api_version` and the device's own version is
/// at least that; otherwise, the smaller of the two versions. The physical device must also meet the required lines of
/// [`super::capability::REQUIREMENTS`], which `spgs devices` shows.
pub fn host_requirements(api_version: u32) -> HostRequirements {
    let mut extensions = Vec::new();
    if api_version < vk::API_VERSION_1_3 {
        extensions.extend([ash::khr::synchronization2::NAME, ash::ext::subgroup_size_control::NAME]);
    }
    HostRequirements {
        extensions,
        extensions_if_present: vec![ash::khr::portability_subset::NAME],
        features: vec!["timelineSemaphore", "synchronization2", "subgroupSizeControl", "computeFullSubgroups"],
    }
}

/// A version that was left out or is too low would else be told as all that such a device lacks.
fn check_version(api_version: u32) -> Result<()> {
    if api_version >= vk::API_VERSION_1_2 {
        return Ok(());
    }
    let (major, minor) = (vk::api_version_major(api_version), vk::api_version_minor(api_version));
    let found = if major == 0 { api_version.to_string() } else { format!("{major}.{minor}") };
    Err(Error::usage("HostDevice::api_version", found, "at least 1.2"))
}

/// Raw handles of an open device, whoever made it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Handles {
    /// `VkInstance`.
    pub instance: u64,
    /// `VkPhysicalDevice`.
    pub physical_device: u64,
    /// `VkDevice`.
    pub device: u64,
    /// Family of the queue of [`Gpu::with_queue`].
    pub queue_family: u32,
}

impl Gpu {
    /// Works on a host's device. The device's functions are loaded anew, nothing is created on the queue.
    ///
    /// # Safety
    /// - The handles are valid, belong together and outlive the last [`Gpu`] and everything made from it.
    /// - The device was made with everything that [`host_requirements`] lists, the queue with family `queue_family`.
    /// - The queue is submitted to by others only under `queue_lock`, or not while the engine uploads or warms up.
    ///
    /// # Errors
    /// `NoDevice` when the loader is missing or the physical device lacks something, with what it lacks; `Usage` for a null
    /// handle or an `api_version` below 1.2.
    pub unsafe fn from_host(host: &HostDevice, options: &GpuOptions) -> Result<Self> {
        let handles = [host.instance, host.physical_device, host.device, host.queue];
        for (name, handle) in ["VkInstance", "VkPhysicalDevice", "VkDevice", "VkQueue"].into_iter().zip(handles) {
            if handle == 0 {
                return Err(Error::usage(format!("host device, {name}"), "null", "a valid handle"));
            }
        }
        check_version(host.api_version)?;
        let entry = match host.get_instance_proc_addr {
            // SAFETY: the caller's function behaves as vkGetInstanceProcAddr does; both types describe its C signature.
            Some(function) => unsafe {
                let get_instance_proc_addr =
                    std::mem::transmute::<GetInstanceProcAddr, vk::PFN_vkGetInstanceProcAddr>(function);
                ash::Entry::from_static_fn(ash::StaticFn { get_instance_proc_addr })
            },
            // SAFETY: loading the system's Vulkan loader runs its initialisers, which are trusted.
            None => unsafe { ash::Entry::load() }.map_err(|e| Error::NoDevice {
                reason: format!("the Vulkan loader (libvulkan.so.1) cannot be loaded: {e}"),
            })?,
        };
        // SAFETY: the caller promises that the instance is valid.
        let instance = unsafe { ash::Instance::load(entry.static_fn(), vk::Instance::from_raw(host.instance)) };
        let physical = vk::PhysicalDevice::from_raw(host.physical_device);
        let mut info = DeviceInfo::query_up_to(&instance, physical, 0, host.api_version);
        let missing = info.missing();
        if !missing.is_empty() {
            return Err(Error::NoDevice { reason: format!("{}: lacks {}", info.name, missing.join(", ")) });
        }
        // SAFETY: plain query.
        let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
        let family = families.get(host.queue_family as usize);
        if !family.is_some_and(|f| f.queue_flags.contains(vk::QueueFlags::COMPUTE)) {
            let found = format!("{} of {}", host.queue_family, families.len());
            return Err(Error::usage("host device, queue family", found, "a family with compute"));
        }
        // Whether a host enabled what is optional cannot be asked.
        info.capabilities.float_atomics = false;
        info.capabilities.work_on(Some(host.queue_family));
        info.capabilities.reconvergence = Reconvergence::None;
        // SAFETY: the caller promises that the device is valid and of this instance.
        let device = unsafe { ash::Device::load(instance.fp_v1_0(), vk::Device::from_raw(host.device)) };
        let opened = Opened {
            entry,
            instance,
            physical,
            info,
            device,
            family: host.queue_family,
            queue: vk::Queue::from_raw(host.queue),
            owned: false,
            statistics: false,
            host_lock: host.queue_lock.clone(),
            debug: None,
            messages: Messages::default(),
        };
        Self::from_opened(opened, options)
    }

    /// Whether both are clones of one: what was made from the one works with the other. The same `VkDevice` given to
    /// [`Gpu::from_host`] twice makes two.
    pub fn is_clone_of(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    /// Raw handles, for a caller that works on the same device (a window, a debugger); one that draws asks for a queue that
    /// does ([`GpuOptions::draws`]).
    pub fn handles(&self) -> Handles {
        Handles {
            instance: self.0.instance.handle().as_raw(),
            physical_device: self.0.physical.as_raw(),
            device: self.0.device.handle().as_raw(),
            queue_family: self.0.family,
        }
    }

    /// `vkGetInstanceProcAddr` of the loader that the engine uses.
    pub fn get_instance_proc_addr(&self) -> GetInstanceProcAddr {
        let function = self.0.entry.static_fn().get_instance_proc_addr;
        // SAFETY: both types describe the same C signature; `vk::Instance` is a transparent pointer-sized handle.
        unsafe { std::mem::transmute::<vk::PFN_vkGetInstanceProcAddr, GetInstanceProcAddr>(function) }
    }

    /// Runs `submit` with the raw `VkQueue` while nobody else, the engine included, submits to it. Calling the engine from
    /// inside deadlocks.
    pub fn with_queue<T>(&self, submit: impl FnOnce(u64) -> T) -> T {
        let queue = self.0.lock_queue();
        submit(queue.as_raw())
    }
}

/// A host's command buffer that is being recorded.
#[derive(Debug)]
pub struct HostCommandBuffer(pub(super) vk::CommandBuffer);

impl HostCommandBuffer {
    /// Takes a `VkCommandBuffer`.
    ///
    /// # Safety
    /// - It is of the engine's device, from a pool of the engine's queue family, primary or secondary, in the recording
    ///   state and outside of a render pass whenever it is handed to the engine, and no other thread records into it or
    ///   its pool meanwhile.
    /// - What is recorded into it and executed has finished before the view that recorded it, its scene, or the images of
    ///   its target are destroyed; and command buffers that share a view, or a scene with network F or G or a deformation field
    ///   ([`SceneHandle::one_after_another`](crate::render::SceneHandle::one_after_another)), execute one after another: in
    ///   submission order on one queue, or ordered by semaphores.
    pub unsafe fn from_raw(command_buffer: u64) -> Self {
        Self(vk::CommandBuffer::from_raw(command_buffer))
    }
}

/// How an image is used before or after the engine writes it: the engine waits for `stages` and `access` on the one side,
/// and makes its writes visible to them on the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageUse {
    /// `VkImageLayout`; on the side of after neither `UNDEFINED` nor `PREINITIALIZED`.
    pub layout: i32,
    /// `VkPipelineStageFlags2`.
    pub stages: u64,
    /// `VkAccessFlags2`; reads need not be named on the side of `before`.
    pub access: u64,
}

impl ImageUse {
    const fn new(layout: vk::ImageLayout, stages: vk::PipelineStageFlags2, access: vk::AccessFlags2) -> Self {
        Self { layout: layout.as_raw(), stages: stages.as_raw(), access: access.as_raw() }
    }

    /// Before: the content does not matter and nothing that still runs uses the image. For a swapchain image: the
    /// acquisition's semaphore is waited for at stage `TRANSFER` or `COMPUTE_SHADER` (or `ALL_COMMANDS`).
    pub const UNDEFINED: Self = Self::new(
        vk::ImageLayout::UNDEFINED,
        // Both ways of writing: the change of layout waits for a semaphore only through a stage that both name.
        vk::PipelineStageFlags2::from_raw(
            vk::PipelineStageFlags2::TRANSFER.as_raw() | vk::PipelineStageFlags2::COMPUTE_SHADER.as_raw(),
        ),
        vk::AccessFlags2::NONE,
    );
    /// Before: the content does not matter, but earlier commands of the queue may still sample the image in fragment or
    /// compute shaders. The usual choice for an image that is written and sampled in every frame.
    pub const DISCARD_AFTER_SAMPLING: Self = Self::new(
        vk::ImageLayout::UNDEFINED,
        vk::PipelineStageFlags2::from_raw(
            vk::PipelineStageFlags2::FRAGMENT_SHADER.as_raw() | vk::PipelineStageFlags2::COMPUTE_SHADER.as_raw(),
        ),
        vk::AccessFlags2::NONE,
    );
    /// Sampled by fragment shaders, `SHADER_READ_ONLY_OPTIMAL`.
    pub const FRAGMENT_SAMPLED: Self = Self::new(
        vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
        vk::PipelineStageFlags2::FRAGMENT_SHADER,
        vk::AccessFlags2::SHADER_READ,
    );
    /// Drawn over as a colour attachment, blending included.
    pub const COLOR_ATTACHMENT: Self = Self::new(
        vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
        vk::PipelineStageFlags2::COLOR_ATTACHMENT_OUTPUT,
        vk::AccessFlags2::from_raw(
            vk::AccessFlags2::COLOR_ATTACHMENT_READ.as_raw() | vk::AccessFlags2::COLOR_ATTACHMENT_WRITE.as_raw(),
        ),
    );
    /// Copied from.
    pub const TRANSFER_SOURCE: Self = Self::new(
        vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
        vk::PipelineStageFlags2::TRANSFER,
        vk::AccessFlags2::TRANSFER_READ,
    );
    /// After: handed to the presentation engine; the semaphore that presenting waits for orders it.
    pub const PRESENT: Self =
        Self::new(vk::ImageLayout::PRESENT_SRC_KHR, vk::PipelineStageFlags2::NONE, vk::AccessFlags2::NONE);
    /// Read and written by compute shaders in `GENERAL`.
    pub const COMPUTE: Self = Self::new(
        vk::ImageLayout::GENERAL,
        vk::PipelineStageFlags2::COMPUTE_SHADER,
        vk::AccessFlags2::from_raw(vk::AccessFlags2::SHADER_READ.as_raw() | vk::AccessFlags2::SHADER_WRITE.as_raw()),
    );
}

/// A rectangle of one layer of a host's image, to be written. The image has usage `TRANSFER_DST`, one sample and a colour
/// format of the size that the engine writes; a swapchain's image will do. With [`HostImage::with_storage_view`] kernels write
/// it instead.
#[derive(Debug, Clone, Copy)]
pub struct HostImage {
    pub(super) raw: vk::Image,
    /// Null: it is copied to.
    pub(super) view: vk::ImageView,
    pub(super) offset: [u32; 2],
    pub(super) layer: u32,
    pub(super) level: u32,
    pub(super) before: ImageUse,
    pub(super) after: ImageUse,
}

impl HostImage {
    /// Takes a `VkImage`: its first layer and level from pixel (0, 0) on.
    ///
    /// # Safety
    /// - It is a valid image of the engine's device with usage `TRANSFER_DST`, colour aspect, one sample, of the format
    ///   that the engine is told, owned by the engine's queue family when the commands execute, and at least as large as
    ///   what is written.
    /// - `before` is true when the commands execute: that is its layout (or `UNDEFINED`), and whatever else uses the image
    ///   is covered by those stages and accesses or by a semaphore.
    pub unsafe fn from_raw(image: u64, before: ImageUse, after: ImageUse) -> Self {
        let (raw, view) = (vk::Image::from_raw(image), vk::ImageView::null());
        Self { raw, view, offset: [0, 0], layer: 0, level: 0, before, after }
    }

    /// A kernel writes the pixels through this `VkImageView`; no copy is made.
    ///
    /// # Safety
    /// - The image has usage `STORAGE` (it needs no `TRANSFER_DST` then).
    /// - It is a valid 2D view of the image's layer and level, of the format that the engine is told, with no swizzle, and stays
    ///   until the commands have finished.
    #[must_use]
    pub unsafe fn with_storage_view(self, view: u64) -> Self {
        Self { view: vk::ImageView::from_raw(view), ..self }
    }

    /// Refuses what can be seen to be wrong without asking the device.
    pub(crate) fn check(&self, what: &str) -> Result<()> {
        if self.raw == vk::Image::null() {
            return Err(Error::usage(what, "null", "a VkImage"));
        }
        let layout = vk::ImageLayout::from_raw(self.after.layout);
        if matches!(layout, vk::ImageLayout::UNDEFINED | vk::ImageLayout::PREINITIALIZED) {
            let what = format!("{what}, layout after the frame");
            return Err(Error::usage(what, format!("{layout:?}"), "the layout that its next use wants"));
        }
        Ok(())
    }

    /// Whether kernels write it.
    pub fn is_storage(&self) -> bool {
        self.view != vk::ImageView::null()
    }

    /// The rectangle's first pixel, for several views beside one another in one image. The whole layer changes its layout:
    /// after the first view of a frame, `before` must not be `UNDEFINED`.
    #[must_use]
    pub fn at(self, x: u32, y: u32) -> Self {
        Self { offset: [x, y], ..self }
    }

    /// Another array layer, for stereo into one layered image.
    #[must_use]
    pub fn layer(self, layer: u32) -> Self {
        Self { layer, ..self }
    }

    /// Another mip level.
    #[must_use]
    pub fn level(self, level: u32) -> Self {
        Self { level, ..self }
    }

    pub(super) fn barrier(&self, first: bool) -> vk::ImageMemoryBarrier2<'static> {
        let written = if self.is_storage() {
            let (stages, access) = (vk::PipelineStageFlags2::COMPUTE_SHADER, vk::AccessFlags2::SHADER_STORAGE_WRITE);
            ImageUse::new(vk::ImageLayout::GENERAL, stages, access)
        } else {
            let (stages, access) = (vk::PipelineStageFlags2::TRANSFER, vk::AccessFlags2::TRANSFER_WRITE);
            ImageUse::new(vk::ImageLayout::TRANSFER_DST_OPTIMAL, stages, access)
        };
        let (from, to) = if first { (self.before, written) } else { (written, self.after) };
        vk::ImageMemoryBarrier2::default()
            .image(self.raw)
            .subresource_range(vk::ImageSubresourceRange {
                aspect_mask: vk::ImageAspectFlags::COLOR,
                base_mip_level: self.level,
                level_count: 1,
                base_array_layer: self.layer,
                layer_count: 1,
            })
            .old_layout(vk::ImageLayout::from_raw(from.layout))
            .new_layout(vk::ImageLayout::from_raw(to.layout))
            .src_stage_mask(vk::PipelineStageFlags2::from_raw(from.stages))
            .src_access_mask(vk::AccessFlags2::from_raw(from.access))
            .dst_stage_mask(vk::PipelineStageFlags2::from_raw(to.stages))
            .dst_access_mask(vk::AccessFlags2::from_raw(to.access))
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
    }

    pub(super) fn region(&self, buffer_offset: u64, [width, height]: [u32; 2]) -> vk::BufferImageCopy {
        vk::BufferImageCopy::default()
            .buffer_offset(buffer_offset)
            .image_subresource(vk::ImageSubresourceLayers {
                aspect_mask: vk::ImageAspectFlags::COLOR,
                mip_level: self.level,
                base_array_layer: self.layer,
                layer_count: 1,
            })
            .image_offset(vk::Offset3D { x: self.offset[0] as i32, y: self.offset[1] as i32, z: 0 })
            .image_extent(vk::Extent3D { width, height, depth: 1 })
    }
}
