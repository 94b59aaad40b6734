//! Choosing a Vulkan device, what is required of it, and the [`Gpu`] handle that everything else is made from.

use std::ffi::{CStr, CString};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ash::vk;
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};

use super::capability::{Capabilities, DeviceInfo, REQUIREMENTS};
use super::messenger::{Messages, Messenger, create_messenger};
use super::pipeline::{PipelineCacheFile, Pipelines};
use super::surface::{Screen, destroy_surface, present_family};
use crate::error::{Error, Result};

/// How to make a [`Gpu`]. The defaults come from the environment: `SPGS_DEVICE`, `SPGS_VALIDATION=1`,
/// `SPGS_BREADCRUMBS=0|1`, `SPGS_TIMEOUT_S`.
#[derive(Debug, Clone)]
pub struct GpuOptions {
    /// Index in `spgs devices`, or part of the device's name. `None`: discrete before integrated before virtual before CPU.
    pub device: Option<String>,
    /// Enable the Khronos validation layer with synchronisation validation; its messages are collected.
    pub validation: bool,
    /// With `validation`: GPU-assisted checks (reads and writes past the end of a buffer) instead of synchronisation
    /// validation. `SPGS_GPU_ASSISTED=1`.
    pub gpu_assisted: bool,
    /// Note each operation in host-visible memory, so that a lost device names its last kernel.
    pub breadcrumbs: bool,
    /// Bytes of device memory the engine may allocate; `None`: 80 % of the largest device-local heap.
    pub byte_budget: Option<u64>,
    /// Keep compiled pipelines in the user's cache folder.
    pub pipeline_cache: bool,
    /// Seconds before a wait for the device gives up.
    pub timeout_s: f64,
}

impl Default for GpuOptions {
    fn default() -> Self {
        let flag = |name: &str, default: bool| std::env::var(name).map_or(default, |v| v != "0" && !v.is_empty());
        let timeout = std::env::var("SPGS_TIMEOUT_S").ok().and_then(|v| v.parse().ok());
        Self {
            device: std::env::var("SPGS_DEVICE").ok().filter(|v| !v.is_empty()),
            validation: flag("SPGS_VALIDATION", false),
            gpu_assisted: flag("SPGS_GPU_ASSISTED", false),
            breadcrumbs: flag("SPGS_BREADCRUMBS", true),
            byte_budget: None,
            pipeline_cache: true,
            timeout_s: timeout.unwrap_or(60.0),
        }
    }
}

/// A Vulkan device with one compute queue. Cheap to clone; everything made from it keeps it alive.
#[derive(Clone)]
pub struct Gpu(pub(super) Arc<Shared>);

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
    pub(super) queue: Mutex<vk::Queue>,
    pub(super) lost: AtomicBool,
    /// Test seam: device loss is reported at the n-th submission from now (0 = never).
    pub(super) lose_at: AtomicU64,
    pub(super) family: u32,
    pub(super) sync2: Sync2,
    pub(super) device: ash::Device,
    debug: Option<Messenger>,
    pub(super) physical: vk::PhysicalDevice,
    pub(super) instance: ash::Instance,
    pub(super) entry: ash::Entry,
}

/// Byte accounting of all allocations of a device.
#[derive(Debug, Default)]
pub(super) struct MemoryBudget {
    pub(super) budget: AtomicU64,
    pub(super) used: AtomicU64,
    pub(super) objects: AtomicU64,
    /// Test seam: the n-th allocation from now fails (0 = never).
    pub(super) fail_at: AtomicU64,
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
    /// Opens a device.
    pub fn new(options: &GpuOptions) -> Result<Self> {
        Self::new_for(options, &Screen::NONE).map(|(gpu, _)| gpu)
    }

    /// Opens a device that can present to `screen`; with it comes the surface that `screen` made.
    pub(super) fn new_for(options: &GpuOptions, screen: &Screen<'_>) -> Result<(Self, vk::SurfaceKHR)> {
        let (entry, instance, debug, messages) = create_instance(options, screen.extensions)?;
        let surface = (screen.make)(&entry, &instance);
        let result = surface.and_then(|surface| {
            let opened = Self::open(entry.clone(), &instance, debug.clone(), messages, options, surface);
            if opened.is_err() {
                destroy_surface(&entry, &instance, surface);
            }
            Ok((opened?, surface))
        });
        if result.is_err() {
            if let Some((loader, messenger)) = debug {
                // SAFETY: made from this instance, not used afterwards.
                unsafe { loader.destroy_debug_utils_messenger(messenger, None) };
            }
            // SAFETY: `open` destroys what it made from the instance before it fails.
            unsafe { instance.destroy_instance(None) };
        }
        result
    }

    fn open(
        entry: ash::Entry,
        instance: &ash::Instance,
        debug: Option<Messenger>,
        messages: Messages,
        options: &GpuOptions,
        surface: vk::SurfaceKHR,
    ) -> Result<Self> {
        let mut candidates = enumerate(instance)?;
        let presents = |(physical, info): &(vk::PhysicalDevice, DeviceInfo)| {
            surface == vk::SurfaceKHR::null() || present_family(&entry, instance, *physical, info, surface).is_some()
        };
        if options.device.is_none() && candidates.iter().any(presents) {
            candidates.retain(presents);
        }
        let index = choose(&candidates, options.device.as_deref())?;
        let (physical, info) = candidates[index].clone();
        let family = if surface == vk::SurfaceKHR::null() {
            let reason = || format!("{}: {}", info.name, REQUIREMENTS[0].why);
            info.capabilities.compute_family.ok_or_else(|| Error::NoDevice { reason: reason() })?
        } else {
            let reason = || format!("{} cannot show pictures in a window here", info.name);
            present_family(&entry, instance, physical, &info, surface)
                .ok_or_else(|| Error::NoDevice { reason: reason() })?
        };
        let device = create_device(instance, physical, &info, family, surface != vk::SurfaceKHR::null())?;
        // SAFETY: the queue was requested at device creation.
        let queue = unsafe { device.get_device_queue(family, 0) };
        let sync2 = if info.capabilities.api_version >= vk::API_VERSION_1_3 {
            Sync2::Core
        } else {
            Sync2::Extension(ash::khr::synchronization2::Device::new(instance, &device))
        };
        let made = Self::device_objects(instance, &device, physical, &info, options);
        let (timeline, allocator, cache) = match made {
            Ok(made) => made,
            Err(error) => {
                // SAFETY: nothing made from the device is left.
                unsafe { device.destroy_device(None) };
                return Err(error);
            }
        };
        let budget = options.byte_budget.unwrap_or(info.capabilities.device_heap_bytes / 5 * 4);
        let memory = MemoryBudget { budget: AtomicU64::new(budget), ..MemoryBudget::default() };
        Ok(Self(Arc::new(Shared {
            info,
            options: options.clone(),
            messages,
            pipelines: Mutex::new(Pipelines::default()),
            cache,
            allocator: Mutex::new(Some(allocator)),
            memory,
            timeline,
            submissions: AtomicU64::new(0),
            queue: Mutex::new(queue),
            lost: AtomicBool::new(false),
            lose_at: AtomicU64::new(0),
            family,
            sync2,
            device,
            debug,
            physical,
            instance: instance.clone(),
            entry,
        })))
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

    /// The subgroup size that kernels are specialised for.
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

    /// Blocks until the device is idle.
    pub fn wait_idle(&self) -> Result<()> {
        let _queue = lock(&self.0.queue);
        // SAFETY: the queue lock keeps others from submitting meanwhile.
        unsafe { self.0.device.device_wait_idle() }.map_err(vk_error("vkDeviceWaitIdle"))
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // SAFETY: this is the last handle, so nothing made from the device is in use after the wait.
        unsafe {
            let _ = self.device.device_wait_idle();
            lock(&self.pipelines).destroy(&self.device);
            self.cache.save_and_destroy(&self.device);
            self.device.destroy_semaphore(self.timeline, None);
            drop(lock(&self.allocator).take());
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
    let (_entry, instance, _, _) = create_instance(&options, &[])?;
    let list = enumerate(&instance).map(|all| all.into_iter().map(|(_, info)| info).collect());
    // SAFETY: nothing made from it is left.
    unsafe { instance.destroy_instance(None) };
    list
}

fn create_instance(
    options: &GpuOptions,
    window_extensions: &[&'static CStr],
) -> Result<(ash::Entry, ash::Instance, Option<Messenger>, Messages)> {
    // SAFETY: loading the system's Vulkan loader runs its initialisers, which are trusted.
    let entry = unsafe { ash::Entry::load() }.map_err(|e| Error::NoDevice {
        reason: format!("the Vulkan loader (libvulkan.so.1) cannot be loaded: {e}; run ci/setup"),
    })?;
    let no_instance = |code: vk::Result| Error::NoDevice { reason: format!("vkCreateInstance: {code:?}") };
    // SAFETY: plain queries.
    let version = unsafe { entry.try_enumerate_instance_version() }.map_err(no_instance)?;
    let version = version.unwrap_or(vk::API_VERSION_1_0);
    if version < vk::API_VERSION_1_2 {
        return Err(Error::NoDevice {
            reason: format!("the Vulkan loader is {}, expected 1.2 or later", show_version(version)),
        });
    }
    let app = vk::ApplicationInfo::default()
        .application_name(c"spgs")
        .engine_name(c"spgs")
        .api_version(version.min(vk::API_VERSION_1_3));
    let mut layers = Vec::new();
    let mut extensions = Vec::new();
    let validation_layer = c"VK_LAYER_KHRONOS_validation";
    if options.validation {
        // SAFETY: plain query.
        let available = unsafe { entry.enumerate_instance_layer_properties() }.map_err(no_instance)?;
        if !available.iter().any(|l| l.layer_name_as_c_str() == Ok(validation_layer)) {
            let reason =
                "validation was asked for, but VK_LAYER_KHRONOS_validation is not installed; run ci/setup --tests";
            return Err(Error::NoDevice { reason: reason.into() });
        }
        layers.push(validation_layer.as_ptr());
        extensions.push(ash::ext::debug_utils::NAME.as_ptr());
        extensions.push(ash::ext::validation_features::NAME.as_ptr());
    }
    // SAFETY: plain query.
    let available = unsafe { entry.enumerate_instance_extension_properties(None) }.map_err(no_instance)?;
    for name in window_extensions {
        if !available.iter().any(|e| e.extension_name_as_c_str() == Ok(name)) {
            let reason = format!("the Vulkan loader lacks {}, which windows of this kind need", name.to_string_lossy());
            return Err(Error::NoDevice { reason });
        }
        extensions.push(name.as_ptr());
    }
    let mut flags = vk::InstanceCreateFlags::empty();
    if available.iter().any(|e| e.extension_name_as_c_str() == Ok(ash::khr::portability_enumeration::NAME)) {
        extensions.push(ash::khr::portability_enumeration::NAME.as_ptr());
        flags |= vk::InstanceCreateFlags::ENUMERATE_PORTABILITY_KHR;
    }
    let enabled: &[vk::ValidationFeatureEnableEXT] = if options.gpu_assisted {
        &[
            vk::ValidationFeatureEnableEXT::GPU_ASSISTED,
            vk::ValidationFeatureEnableEXT::GPU_ASSISTED_RESERVE_BINDING_SLOT,
        ]
    } else {
        &[vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION]
    };
    let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(enabled);
    let mut create = vk::InstanceCreateInfo::default()
        .flags(flags)
        .application_info(&app)
        .enabled_layer_names(&layers)
        .enabled_extension_names(&extensions);
    if options.validation {
        create = create.push_next(&mut features);
    }
    // SAFETY: the create info and what it points to live until the call returns.
    let instance = unsafe { entry.create_instance(&create, None) }.map_err(no_instance)?;
    let messages = Arc::new(Mutex::new(Vec::new()));
    let debug = if options.validation { Some(create_messenger(&entry, &instance, &messages)?) } else { None };
    Ok((entry, instance, debug, messages))
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

fn choose(candidates: &[(vk::PhysicalDevice, DeviceInfo)], wanted: Option<&str>) -> Result<usize> {
    let refusals = |list: &[(vk::PhysicalDevice, DeviceInfo)]| {
        let lines: Vec<String> = list
            .iter()
            .map(|(_, d)| match d.missing() {
                m if m.is_empty() => format!("[{}] {}", d.index, d.name),
                m => format!("[{}] {}: lacks {}", d.index, d.name, m.join(", ")),
            })
            .collect();
        if lines.is_empty() { "no driver found; run ci/setup".to_owned() } else { lines.join("; ") }
    };
    if let Some(text) = wanted {
        let found = match text.parse::<usize>() {
            Ok(index) => (index < candidates.len()).then_some(index),
            Err(_) => candidates.iter().position(|(_, d)| d.name.to_lowercase().contains(&text.to_lowercase())),
        };
        let index = found.ok_or_else(|| {
            Error::usage("--device", text, format!("an index or part of a name of: {}", refusals(candidates)))
        })?;
        if !candidates[index].1.missing().is_empty() {
            return Err(Error::NoDevice { reason: refusals(&candidates[index..=index]) });
        }
        return Ok(index);
    }
    let usable = candidates.iter().enumerate().filter(|(_, (_, d))| d.missing().is_empty());
    usable
        .min_by_key(|(i, (_, d))| (d.kind_rank(), *i))
        .map(|(i, _)| i)
        .ok_or_else(|| Error::NoDevice { reason: refusals(candidates) })
}

fn create_device(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    info: &DeviceInfo,
    family: u32,
    presents: bool,
) -> Result<ash::Device> {
    let capabilities: &Capabilities = &info.capabilities;
    let priorities = [1.0];
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&priorities)];
    let mut extensions: Vec<CString> = Vec::new();
    let mut enable = |name: &CStr| {
        if capabilities.has_extension(name) {
            extensions.push(name.to_owned());
        }
    };
    if capabilities.api_version < vk::API_VERSION_1_3 {
        enable(ash::khr::synchronization2::NAME);
        enable(ash::ext::subgroup_size_control::NAME);
    }
    enable(ash::khr::portability_subset::NAME);
    if presents {
        enable(ash::khr::swapchain::NAME);
    }
    if capabilities.float_atomics {
        enable(ash::ext::shader_atomic_float::NAME);
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
    if capabilities.float_atomics {
        create = create.push_next(&mut atomic_float);
    }
    // SAFETY: every feature and extension named was reported by the device.
    unsafe { instance.create_device(physical, &create, None) }.map_err(vk_error("vkCreateDevice"))
}

fn cache_path(info: &DeviceInfo) -> Option<PathBuf> {
    let base = std::env::var_os("XDG_CACHE_HOME")
        .map(PathBuf::from)
        .or_else(|| std::env::var_os("HOME").map(|h| PathBuf::from(h).join(".cache")))?;
    Some(base.join("spgs").join(format!("pipelines-{}.bin", info.capabilities.cache_uuid)))
}

/// `1.3.230` from a packed version.
pub(super) fn show_version(version: u32) -> String {
    let (major, minor) = (vk::api_version_major(version), vk::api_version_minor(version));
    format!("{major}.{minor}.{}", vk::api_version_patch(version))
}
