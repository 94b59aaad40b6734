//! Choosing a Vulkan device, what is required of it, and the [`Gpu`] handle that everything else is made from.

use std::ffi::{CStr, CString};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ash::vk;
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};

use super::account::MemoryBudget;
use super::cache_folder::cache_folder;
use super::capability::{Capabilities, DeviceInfo, REQUIREMENTS};
use super::host::QueueLock;
use super::instance::{Messages, Messenger, create_instance, validation_layer_is_old};
use super::options::{GpuOptions, has_lost};
use super::pipeline::{PipelineCacheFile, Pipelines};
use super::proof::Watch;
use super::reconvergence::Reconvergence;
use super::trust::Trust;
use crate::error::{Error, Result};

/// A Vulkan device with one compute queue. Cheap to clone; everything made from it keeps it alive.
#[derive(Clone)]
pub struct Gpu(pub(super) Arc<Shared>, pub(super) Option<Arc<Watch>>);

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Gpu").field(&self.0.info.name).finish()
    }
}

pub(super) struct Shared {
    pub(super) info: DeviceInfo,
    pub(super) options: GpuOptions,
    pub(super) messages: Messages,
    pub(super) pipelines: Mutex<Pipelines>,
    pub(super) cache: PipelineCacheFile,
    pub(super) allocator: Mutex<Option<Allocator>>,
    pub(super) memory: MemoryBudget,
    pub(super) timeline: vk::Semaphore,
    pub(super) submissions: AtomicU64,
    pub(super) newest_waits: AtomicU64,
    pub(super) queue: Mutex<vk::Queue>,
    pub(super) lost: AtomicBool,
    /// Test seam: device loss is reported at the n-th submission from now (0 = never).
    pub(super) lose_at: AtomicU64,
    pub(super) family: u32,
    pub(super) sync2: Sync2,
    /// Pipelines are made with statistics.
    pub(super) statistics: bool,
    pub(super) device: ash::Device,
    pub(super) physical: vk::PhysicalDevice,
    /// Made by the engine, and destroyed by it; a host's device is neither.
    pub(super) owned: bool,
    /// The host's own lock of the queue, when it submits to it too.
    pub(super) host_lock: Option<Arc<dyn QueueLock>>,
    /// What the device has proven.
    pub(super) trust: Trust,
    debug: Option<Messenger>,
    pub(super) instance: ash::Instance,
    pub(super) entry: ash::Entry,
}

/// What is opened: by the engine or by a host.
pub(super) struct Opened {
    pub(super) entry: ash::Entry,
    pub(super) instance: ash::Instance,
    pub(super) physical: vk::PhysicalDevice,
    pub(super) info: DeviceInfo,
    pub(super) device: ash::Device,
    pub(super) family: u32,
    pub(super) queue: vk::Queue,
    pub(super) owned: bool,
    /// `pipelineExecutableInfo` is enabled.
    pub(super) statistics: bool,
    pub(super) host_lock: Option<Arc<dyn QueueLock>>,
    pub(super) debug: Option<Messenger>,
    pub(super) messages: Messages,
}

/// `vkCmdPipelineBarrier2`, from Vulkan 1.3 or from the extension.
pub(super) enum Sync2 {
    Core,
    Extension(ash::khr::synchronization2::Device),
}

/// Locks a mutex; a panic elsewhere while it was held cannot leave its data half-changed in a way that matters here.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Wraps a Vulkan result with the call's name.
pub(super) fn vk_error(call: &'static str) -> impl Fn(vk::Result) -> Error {
    move |code| Error::Vulkan { call, code: format!("{code:?}") }
}

impl Gpu {
    /// Opens a device as it is, without a self-test ([`Gpu::new`] has one).
    pub fn open(options: &GpuOptions) -> Result<Self> {
        Self::open_except(options, &[])
    }

    /// [`Gpu::open`], but none of the devices with an index in `refused`.
    pub(crate) fn open_except(options: &GpuOptions, refused: &[usize]) -> Result<Self> {
        let (entry, instance, debug, messages) = create_instance(options)?;
        let result = Self::open_on(entry.clone(), &instance, debug.clone(), messages, options, refused);
        if result.is_err() {
            if let Some((loader, messenger)) = debug {
                // SAFETY: made from this instance, not used afterwards.
                unsafe { loader.destroy_debug_utils_messenger(messenger, None) };
            }
            // SAFETY: `open_on` destroys what it made from the instance before it fails.
            unsafe { instance.destroy_instance(None) };
        }
        result
    }

    fn open_on(
        entry: ash::Entry,
        instance: &ash::Instance,
        debug: Option<Messenger>,
        messages: Messages,
        options: &GpuOptions,
        refused: &[usize],
    ) -> Result<Self> {
        let mut candidates = enumerate(instance)?;
        candidates.retain(|(_, info)| !refused.contains(&info.index));
        let index = choose(&candidates, options)?;
        let (physical, mut info) = candidates[index].clone();
        if options.draws {
            info.draw();
        }
        if options.validation && validation_layer_is_old(&entry) {
            info.capabilities.reconvergence = Reconvergence::None;
        }
        let statistics =
            options.statistics && info.capabilities.has_extension(ash::khr::pipeline_executable_properties::NAME);
        let (device, family) = create_device(instance, physical, &info, &options.device_extensions, statistics)?;
        // SAFETY: the queue was requested at device creation.
        let queue = unsafe { device.get_device_queue(family, 0) };
        let instance = instance.clone();
        let (owned, host_lock) = (true, None);
        let opened = Opened {
            entry,
            instance,
            physical,
            info,
            device: device.clone(),
            family,
            queue,
            owned,
            statistics,
            host_lock,
            debug,
            messages,
        };
        let made = Self::from_opened(opened, options);
        if made.is_err() {
            // SAFETY: nothing made from the device is left.
            unsafe { device.destroy_device(None) };
        }
        made
    }

    /// The engine's own objects on an open device. When it fails, nothing of them is left.
    pub(super) fn from_opened(opened: Opened, options: &GpuOptions) -> Result<Self> {
        let Opened {
            entry,
            instance,
            physical,
            info,
            device,
            family,
            queue,
            owned,
            statistics,
            host_lock,
            debug,
            messages,
        } = opened;
        let sync2 = if info.capabilities.api_version >= vk::API_VERSION_1_3 {
            Sync2::Core
        } else {
            Sync2::Extension(ash::khr::synchronization2::Device::new(&instance, &device))
        };
        let (timeline, allocator, cache) = Self::device_objects(&instance, &device, physical, &info, options)?;
        let budget = options.byte_budget.unwrap_or(info.capabilities.device_heap.budget(0));
        let follows = AtomicBool::new(options.byte_budget.is_none());
        let memory = MemoryBudget { budget: AtomicU64::new(budget), follows, ..MemoryBudget::default() };
        let shared = Shared {
            info,
            options: GpuOptions { breadcrumbs: options.breadcrumbs || has_lost(), ..options.clone() },
            messages,
            pipelines: Mutex::new(Pipelines::default()),
            cache,
            allocator: Mutex::new(Some(allocator)),
            memory,
            timeline,
            submissions: AtomicU64::new(0),
            newest_waits: AtomicU64::new(0),
            queue: Mutex::new(queue),
            lost: AtomicBool::new(false),
            lose_at: AtomicU64::new(0),
            family,
            sync2,
            statistics,
            device,
            physical,
            owned,
            host_lock,
            trust: Trust::default(),
            debug,
            instance,
            entry,
        };
        Ok(Self(Arc::new(shared), None))
    }

    fn device_objects(
        instance: &ash::Instance,
        device: &ash::Device,
        physical: vk::PhysicalDevice,
        info: &DeviceInfo,
        options: &GpuOptions,
    ) -> Result<(vk::Semaphore, Allocator, PipelineCacheFile)> {
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.clone(),
            device: device.clone(),
            physical_device: physical,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: gpu_allocator::AllocationSizes::default(),
        })
        .map_err(|e| Error::Vulkan { call: "gpu_allocator::Allocator::new", code: e.to_string() })?;
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: timelineSemaphore was enabled.
        let timeline = unsafe { device.create_semaphore(&create, None) }.map_err(vk_error("vkCreateSemaphore"))?;
        let path = options.pipeline_cache.then(|| cache_path(info)).flatten();
        match PipelineCacheFile::open(device, path) {
            Ok(cache) => Ok((timeline, allocator, cache)),
            Err(error) => {
                // SAFETY: just made, unused.
                unsafe { device.destroy_semaphore(timeline, None) };
                Err(error)
            }
        }
    }

    /// What the device is and can do.
    pub fn info(&self) -> &DeviceInfo {
        &self.0.info
    }

    /// How it was made.
    pub fn options(&self) -> &GpuOptions {
        &self.0.options
    }

    /// The driver's usual subgroup size; that of a kernel is [`Gpu::subgroup_size_of`].
    pub fn subgroup_size(&self) -> u32 {
        self.0.info.capabilities.subgroup_size
    }

    /// Takes the validation layer's messages (WARNING and above) since the last call.
    pub fn take_validation_messages(&self) -> Vec<String> {
        std::mem::take(&mut *lock(&self.0.messages))
    }

    /// Test seam: the n-th submission from now reports a lost device (0 = never).
    pub fn inject_device_lost(&self, submission: u64) {
        self.0.lose_at.store(submission, Ordering::SeqCst);
    }

    /// Blocks until the device is idle. Of a host's device: until what the engine itself submitted has finished.
    pub fn wait_idle(&self) -> Result<()> {
        self.0.settle().map_err(vk_error("vkDeviceWaitIdle"))
    }
}

/// The queue, held for one submission.
pub(super) struct QueueGuard<'a> {
    queue: MutexGuard<'a, vk::Queue>,
    host_lock: Option<&'a dyn QueueLock>,
}

impl std::ops::Deref for QueueGuard<'_> {
    type Target = vk::Queue;
    fn deref(&self) -> &vk::Queue {
        &self.queue
    }
}

impl Drop for QueueGuard<'_> {
    fn drop(&mut self) {
        if let Some(host_lock) = self.host_lock {
            host_lock.unlock();
        }
    }
}

impl Shared {
    /// Nobody else submits until the guard goes.
    pub(super) fn lock_queue(&self) -> QueueGuard<'_> {
        let queue = lock(&self.queue);
        let host_lock = self.host_lock.as_deref();
        if let Some(host_lock) = host_lock {
            host_lock.lock();
        }
        QueueGuard { queue, host_lock }
    }

    /// Number of the last submission that has finished.
    pub(super) fn finished(&self) -> ash::prelude::VkResult<u64> {
        // Some drivers that compute nothing leave it as it is.
        let mut finished = 0;
        let get = self.device.fp_v1_2().get_semaphore_counter_value;
        // SAFETY: the semaphore is live.
        unsafe { get(self.device.handle(), self.timeline, &mut finished) }.result_with_success(finished)
    }

    /// Waits for everything that the engine submitted; of its own device, for everything.
    pub(super) fn settle(&self) -> ash::prelude::VkResult<()> {
        if self.owned {
            let _queue = self.lock_queue();
            // SAFETY: the queue lock keeps others from submitting meanwhile.
            return unsafe { self.device.device_wait_idle() };
        }
        let (semaphores, values) = ([self.timeline], [self.submissions.load(Ordering::SeqCst)]);
        let wait = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        // SAFETY: the semaphore is live; the last submission signals this value.
        unsafe { self.device.wait_semaphores(&wait, u64::MAX) }
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        let _ = self.settle();
        // SAFETY: this is the last handle, so nothing made from the device is in use after the wait; a host has promised
        // that what it recorded has finished.
        unsafe {
            lock(&self.pipelines).destroy(&self.device);
            self.cache.save_and_destroy(&self.device);
            self.device.destroy_semaphore(self.timeline, None);
            drop(lock(&self.allocator).take());
            if !self.owned {
                return;
            }
            self.device.destroy_device(None);
            if let Some((loader, messenger)) = &self.debug {
                loader.destroy_debug_utils_messenger(*messenger, None);
            }
            self.instance.destroy_instance(None);
        }
    }
}

/// All Vulkan devices of this machine, usable or not, in the order of their index.
pub fn devices() -> Result<Vec<DeviceInfo>> {
    let options = GpuOptions { validation: false, ..GpuOptions::default() };
    let (_entry, instance, _, _) = create_instance(&options)?;
    let list = enumerate(&instance).map(|all| all.into_iter().map(|(_, info)| info).collect());
    // SAFETY: nothing made from it is left.
    unsafe { instance.destroy_instance(None) };
    list
}

fn enumerate(instance: &ash::Instance) -> Result<Vec<(vk::PhysicalDevice, DeviceInfo)>> {
    // SAFETY: plain queries on a live instance.
    let all = unsafe { instance.enumerate_physical_devices() }
        .map_err(|code| Error::NoDevice { reason: format!("vkEnumeratePhysicalDevices: {code:?}") })?;
    Ok(all
        .into_iter()
        .enumerate()
        .map(|(index, physical)| (physical, DeviceInfo::query(instance, physical, index)))
        .collect())
}

fn choose(candidates: &[(vk::PhysicalDevice, DeviceInfo)], options: &GpuOptions) -> Result<usize> {
    let lacks = |d: &DeviceInfo| -> Vec<String> {
        let extensions = options.device_extensions.iter().filter(|e| !d.capabilities.has_extension(e));
        let extensions = extensions.map(|e| e.to_string_lossy().into_owned());
        d.missing().into_iter().map(str::to_owned).chain(extensions).collect()
    };
    let refusals = |list: &[(vk::PhysicalDevice, DeviceInfo)]| {
        let lines: Vec<String> = list
            .iter()
            .map(|(_, d)| match lacks(d) {
                m if m.is_empty() => format!("[{}] {}", d.index, d.name),
                m => format!("[{}] {}: lacks {}", d.index, d.name, m.join(", ")),
            })
            .collect();
        if lines.is_empty() { "no driver found; run ci/setup".to_owned() } else { lines.join("; ") }
    };
    if let Some(text) = options.device.as_deref() {
        let found = match text.parse::<usize>() {
            Ok(index) => candidates.iter().position(|(_, d)| d.index == index),
            Err(_) => candidates.iter().position(|(_, d)| d.name.to_lowercase().contains(&text.to_lowercase())),
        };
        let index = found.ok_or_else(|| {
            Error::usage("device", text, format!("an index or part of a name of: {}", refusals(candidates)))
        })?;
        if !lacks(&candidates[index].1).is_empty() {
            return Err(Error::NoDevice { reason: refusals(&candidates[index..=index]) });
        }
        return Ok(index);
    }
    let usable = candidates.iter().enumerate().filter(|(_, (_, d))| lacks(d).is_empty());
    usable
        .min_by_key(|(i, (_, d))| (d.kind_rank(), *i))
        .map(|(i, _)| i)
        .ok_or_else(|| Error::NoDevice { reason: refusals(candidates) })
}

fn create_device(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    info: &DeviceInfo,
    wanted: &[CString],
    statistics: bool,
) -> Result<(ash::Device, u32)> {
    let capabilities: &Capabilities = &info.capabilities;
    let family = capabilities
        .compute_family
        .ok_or_else(|| Error::NoDevice { reason: format!("{}: {}", info.name, REQUIREMENTS[0].why) })?;
    let priorities = [1.0];
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&priorities)];
    let mut extensions = wanted.to_vec();
    let mut enable = |name: &CStr| {
        if capabilities.has_extension(name) && !extensions.iter().any(|e| e.as_c_str() == name) {
            extensions.push(name.to_owned());
        }
    };
    if capabilities.api_version < vk::API_VERSION_1_3 {
        enable(ash::khr::synchronization2::NAME);
        enable(ash::ext::subgroup_size_control::NAME);
    }
    enable(ash::khr::portability_subset::NAME);
    if statistics {
        enable(ash::khr::pipeline_executable_properties::NAME);
    }
    if capabilities.float_atomics {
        enable(ash::ext::shader_atomic_float::NAME);
    }
    match capabilities.reconvergence {
        Reconvergence::None => {}
        Reconvergence::SubgroupUniform => enable(ash::khr::shader_subgroup_uniform_control_flow::NAME),
        Reconvergence::Maximal => enable(ash::khr::shader_maximal_reconvergence::NAME),
    }
    let names: Vec<_> = extensions.iter().map(|e| e.as_ptr()).collect();
    let mut sync2 = vk::PhysicalDeviceSynchronization2Features::default().synchronization2(true);
    let mut subgroup = vk::PhysicalDeviceSubgroupSizeControlFeatures::default()
        .subgroup_size_control(true)
        .compute_full_subgroups(true);
    let mut timeline = vk::PhysicalDeviceTimelineSemaphoreFeatures::default().timeline_semaphore(true);
    let mut atomic_float =
        vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT::default().shader_buffer_float32_atomic_add(true);
    let mut create = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_extension_names(&names)
        .push_next(&mut sync2)
        .push_next(&mut subgroup)
        .push_next(&mut timeline);
    let mut executable_info =
        vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
    if statistics {
        create = create.push_next(&mut executable_info);
    }
    if capabilities.float_atomics {
        create = create.push_next(&mut atomic_float);
    }
    let mut uniform = vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default()
        .shader_subgroup_uniform_control_flow(true);
    let mut maximal =
        vk::PhysicalDeviceShaderMaximalReconvergenceFeaturesKHR::default().shader_maximal_reconvergence(true);
    create = match capabilities.reconvergence {
        Reconvergence::None => create,
        Reconvergence::SubgroupUniform => create.push_next(&mut uniform),
        Reconvergence::Maximal => create.push_next(&mut maximal),
    };
    // SAFETY: every feature and extension named was reported by the device.
    let device = unsafe { instance.create_device(physical, &create, None) }.map_err(vk_error("vkCreateDevice"))?;
    Ok((device, family))
}

/// The file of compiled pipelines in the user's cache folder.
pub(crate) fn cache_path(info: &DeviceInfo) -> Option<PathBuf> {
    Some(cache_folder()?.join(format!("pipelines-{}.bin", info.capabilities.cache_uuid)))
}
