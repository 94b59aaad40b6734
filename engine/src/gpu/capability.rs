//! What a device offers, and the one table of what the engine requires or uses when present.

use std::ffi::CStr;

use ash::vk;
use serde::Serialize;

use super::budget::Heap;
use super::queue_family::{self, QueueFamily};
use super::reconvergence::Reconvergence;

/// Features and limits that the engine looks at.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Capabilities {
    /// Packed `VkPhysicalDeviceProperties::apiVersion`.
    #[serde(skip)]
    pub api_version: u32,
    /// Queue family that the engine works on, as [`queue_family::choose`] has it.
    pub compute_family: Option<u32>,
    /// All queue families.
    pub queue_families: Vec<QueueFamily>,
    /// The driver's usual subgroup size; kernels may be given another one ([`super::subgroup_size`]).
    pub subgroup_size: u32,
    /// Smallest subgroup size the driver may choose.
    pub min_subgroup_size: u32,
    /// Largest subgroup size the driver may choose.
    pub max_subgroup_size: u32,
    /// Subgroups of a workgroup whose subgroup size is pinned.
    pub max_workgroup_subgroups: u32,
    /// Basic, vote, arithmetic, ballot and shuffle operations in compute shaders.
    pub subgroup_operations: bool,
    /// The size can be pinned and full subgroups required.
    pub subgroup_size_control: bool,
    /// `synchronization2`.
    pub synchronization2: bool,
    /// Timeline semaphores.
    pub timeline_semaphore: bool,
    /// `shaderBufferFloat32AtomicAdd`.
    pub float_atomics: bool,
    /// What the device promises about lanes that parted; asked for, not relied on.
    pub reconvergence: Reconvergence,
    /// Bytes a storage buffer binding may cover.
    pub max_storage_buffer_range: u64,
    /// Bytes of one allocation.
    pub max_allocation_bytes: u64,
    /// Storage buffers visible to one shader stage.
    pub max_storage_buffers: u32,
    /// Bindings of a kernel that are read as texels ([`super::texels`]): none but with Mesa's software driver.
    pub texel_reads: u32,
    /// Bytes of push constants.
    pub max_push_constants: u32,
    /// Bytes of shared memory.
    pub max_shared_bytes: u32,
    /// Invocations of a workgroup.
    pub max_workgroup_size: u32,
    /// Workgroups in x.
    pub max_groups_x: u32,
    /// Workgroups in y.
    pub max_groups_y: u32,
    /// The largest device-local heap, when the device was looked at.
    pub device_heap: Heap,
    /// The host can write memory that lies on the device; else what it writes for each frame is copied there.
    pub device_upload: bool,
    /// Nanoseconds per timestamp tick; 0 when the queue has no timestamps.
    pub timestamp_ns: f64,
    /// Lowest bits of a timestamp that count.
    pub timestamp_bits: u32,
    /// Device extensions.
    #[serde(skip)]
    pub extensions: Vec<String>,
    /// Hexadecimal pipeline cache identity of driver and device.
    pub cache_uuid: String,
}

impl Capabilities {
    /// Whether the device has an extension.
    pub fn has_extension(&self, name: &CStr) -> bool {
        self.extensions.iter().any(|e| e.as_bytes() == name.to_bytes())
    }

    /// Takes this queue family, with its timestamps.
    pub(super) fn work_on(&mut self, family: Option<u32>) {
        self.compute_family = family;
        self.timestamp_bits = family.and_then(|f| self.queue_families.get(f as usize)).map_or(0, |f| f.timestamp_bits);
        if self.timestamp_bits == 0 {
            self.timestamp_ns = 0.0;
        }
    }
}

/// What memory must be that lies on the device and that the host writes.
const DEVICE_UPLOAD: vk::MemoryPropertyFlags = vk::MemoryPropertyFlags::from_raw(
    vk::MemoryPropertyFlags::DEVICE_LOCAL.as_raw()
        | vk::MemoryPropertyFlags::HOST_VISIBLE.as_raw()
        | vk::MemoryPropertyFlags::HOST_COHERENT.as_raw(),
);

/// Storage buffers of the kernel with the most of them, among those that render, and among those that train.
pub const STORAGE_BUFFERS: u32 = 21;
/// See [`STORAGE_BUFFERS`].
pub const TRAINING_STORAGE_BUFFERS: u32 = 29;

/// One line of the table of requirements.
#[derive(Debug, Clone, Copy)]
pub struct Requirement {
    /// Name, as in the Vulkan specification.
    pub name: &'static str,
    /// Whether the engine refuses a device without it (otherwise it is used when present).
    pub required: bool,
    /// What needs it.
    pub why: &'static str,
    /// The test.
    pub met: fn(&Capabilities) -> bool,
}

/// Required and optional features, the single list that device choice, `spgs devices` and the docs use.
pub const REQUIREMENTS: &[Requirement] = &[
    Requirement {
        name: "compute queue",
        required: true,
        why: "all kernels are compute shaders",
        met: |c| c.compute_family.is_some(),
    },
    Requirement {
        name: "Vulkan 1.2",
        required: true,
        why: "SPIR-V 1.5 and timeline semaphores",
        met: |c| c.api_version >= vk::API_VERSION_1_2,
    },
    Requirement {
        name: "timelineSemaphore",
        required: true,
        why: "several frames in flight",
        met: |c| c.timeline_semaphore,
    },
    Requirement { name: "synchronization2", required: true, why: "explicit barriers", met: |c| c.synchronization2 },
    Requirement {
        name: "subgroup basic+vote+arithmetic+ballot+shuffle",
        required: true,
        why: "radix sort and blend",
        met: |c| c.subgroup_operations,
    },
    Requirement {
        name: "subgroup size 4..128",
        required: true,
        why: "kernels are specialised for it",
        met: |c| c.subgroup_size.is_power_of_two() && (4..=128).contains(&c.subgroup_size),
    },
    Requirement {
        name: "subgroupSizeControl+computeFullSubgroups",
        required: true,
        why: "ranking by lane needs full subgroups of a known size",
        met: |c| c.subgroup_size_control,
    },
    Requirement {
        name: "maxStorageBufferRange >= 128 MiB",
        required: true,
        why: "Gaussian arrays",
        met: |c| c.max_storage_buffer_range >= 1 << 27,
    },
    Requirement {
        name: "29 storage buffers per stage",
        required: false,
        why: "training: one kernel updates all parameters of a Gaussian",
        met: |c| c.max_storage_buffers >= TRAINING_STORAGE_BUFFERS,
    },
    Requirement {
        name: "21 storage buffers per stage",
        required: true,
        why: "deform_project",
        met: |c| c.max_storage_buffers >= STORAGE_BUFFERS,
    },
    Requirement {
        name: "128 bytes of push constants",
        required: true,
        why: "kernel parameters",
        met: |c| c.max_push_constants >= 128,
    },
    Requirement {
        name: "32 KiB shared memory",
        required: true,
        why: "radix sort",
        met: |c| c.max_shared_bytes >= 32768,
    },
    Requirement {
        name: "256 invocations",
        required: true,
        why: "workgroup size",
        met: |c| c.max_workgroup_size >= 256,
    },
    Requirement {
        name: "shaderBufferFloat32AtomicAdd",
        required: false,
        why: "gradients added without compare-and-swap",
        met: |c| c.float_atomics,
    },
    Requirement {
        name: "shaderMaximalReconvergence or shaderSubgroupUniformControlFlow",
        required: false,
        why: "lanes meet again where the source says; nothing relies on it",
        met: |c| c.reconvergence != Reconvergence::None,
    },
    Requirement { name: "timestamps", required: false, why: "per-kernel times", met: |c| c.timestamp_ns > 0.0 },
];

/// What a device is and can do.
#[derive(Debug, Clone, Default, Serialize)]
pub struct DeviceInfo {
    /// Index for `--device`.
    pub index: usize,
    /// Device name.
    pub name: String,
    /// `VkPhysicalDeviceProperties::vendorID`.
    pub vendor: u32,
    /// `discrete`, `integrated`, `virtual`, `cpu` or `other`.
    pub kind: &'static str,
    /// Driver name and version text.
    pub driver: String,
    /// Vulkan version, `1.3.230`.
    pub vulkan: String,
    /// Features and limits.
    pub capabilities: Capabilities,
}

impl DeviceInfo {
    /// Names of the required features that the device lacks.
    pub fn missing(&self) -> Vec<&'static str> {
        REQUIREMENTS.iter().filter(|r| r.required && !(r.met)(&self.capabilities)).map(|r| r.name).collect()
    }

    /// Whether this is a software device.
    pub fn is_cpu(&self) -> bool {
        self.kind == "cpu"
    }

    /// Takes a queue family that draws, where there is one.
    pub(super) fn draw(&mut self) {
        let families = &self.capabilities.queue_families;
        let family = queue_family::choose(families, true).or(queue_family::choose(families, false));
        self.capabilities.work_on(family);
    }

    pub(super) fn kind_rank(&self) -> u32 {
        ["discrete", "integrated", "virtual", "other", "cpu"].iter().position(|k| *k == self.kind).unwrap_or(9) as u32
    }

    pub(super) fn query(instance: &ash::Instance, physical: vk::PhysicalDevice, index: usize) -> Self {
        Self::query_up_to(instance, physical, index, u32::MAX)
    }

    /// The same as far as an application sees it that asked for Vulkan `version` when it made the instance.
    pub(super) fn query_up_to(
        instance: &ash::Instance,
        physical: vk::PhysicalDevice,
        index: usize,
        version: u32,
    ) -> Self {
        // SAFETY: plain query.
        let mut base = unsafe { instance.get_physical_device_properties(physical) };
        base.api_version = base.api_version.min(version);
        let name = text(&base.device_name);
        let kind = match base.device_type {
            vk::PhysicalDeviceType::DISCRETE_GPU => "discrete",
            vk::PhysicalDeviceType::INTEGRATED_GPU => "integrated",
            vk::PhysicalDeviceType::VIRTUAL_GPU => "virtual",
            vk::PhysicalDeviceType::CPU => "cpu",
            _ => "other",
        };
        let mut info = Self {
            index,
            name,
            vendor: base.vendor_id,
            kind,
            driver: String::new(),
            vulkan: show_version(base.api_version),
            capabilities: Capabilities { api_version: base.api_version, ..Capabilities::default() },
        };
        if base.api_version >= vk::API_VERSION_1_2 {
            info.query_12(instance, physical);
        }
        info
    }

    /// The queries that need Vulkan 1.2; an older device keeps the defaults and is refused by the table.
    fn query_12(&mut self, instance: &ash::Instance, physical: vk::PhysicalDevice) {
        let c = &mut self.capabilities;
        let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
        let mut control = vk::PhysicalDeviceSubgroupSizeControlProperties::default();
        let mut driver = vk::PhysicalDeviceDriverProperties::default();
        let mut maintenance = vk::PhysicalDeviceMaintenance3Properties::default();
        // SAFETY: plain queries; structures unknown to a driver are left at their defaults.
        let extensions = unsafe { instance.enumerate_device_extension_properties(physical) }.unwrap_or_default();
        c.extensions = extensions.iter().map(|e| text(&e.extension_name)).collect();
        let size_control =
            c.api_version >= vk::API_VERSION_1_3 || c.has_extension(ash::ext::subgroup_size_control::NAME);
        let sync2_known = c.api_version >= vk::API_VERSION_1_3 || c.has_extension(ash::khr::synchronization2::NAME);
        let mut properties = vk::PhysicalDeviceProperties2::default()
            .push_next(&mut subgroup)
            .push_next(&mut driver)
            .push_next(&mut maintenance);
        if size_control {
            properties = properties.push_next(&mut control);
        }
        // SAFETY: as above.
        unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
        let limits = properties.properties.limits;
        let uuid = properties.properties.pipeline_cache_uuid;
        let mut sync2 = vk::PhysicalDeviceSynchronization2Features::default();
        let mut size_features = vk::PhysicalDeviceSubgroupSizeControlFeatures::default();
        let mut timeline = vk::PhysicalDeviceTimelineSemaphoreFeatures::default();
        let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut timeline);
        if size_control {
            features = features.push_next(&mut size_features);
        }
        if sync2_known {
            features = features.push_next(&mut sync2);
        }
        let mut atomic_float = vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT::default();
        if c.has_extension(ash::ext::shader_atomic_float::NAME) {
            features = features.push_next(&mut atomic_float);
        }
        let mut maximal = vk::PhysicalDeviceShaderMaximalReconvergenceFeaturesKHR::default();
        if c.has_extension(ash::khr::shader_maximal_reconvergence::NAME) {
            features = features.push_next(&mut maximal);
        }
        let mut uniform = vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default();
        if c.has_extension(ash::khr::shader_subgroup_uniform_control_flow::NAME) {
            features = features.push_next(&mut uniform);
        }
        // SAFETY: as above.
        unsafe { instance.get_physical_device_features2(physical, &mut features) };
        // SAFETY: as above.
        let memory = unsafe { instance.get_physical_device_memory_properties(physical) };
        // SAFETY: as above.
        let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };

        let needed = vk::SubgroupFeatureFlags::BASIC
            | vk::SubgroupFeatureFlags::VOTE
            | vk::SubgroupFeatureFlags::ARITHMETIC
            | vk::SubgroupFeatureFlags::BALLOT
            | vk::SubgroupFeatureFlags::SHUFFLE;
        c.subgroup_operations = subgroup.supported_stages.contains(vk::ShaderStageFlags::COMPUTE)
            && subgroup.supported_operations.contains(needed);
        c.subgroup_size = subgroup.subgroup_size;
        (c.min_subgroup_size, c.max_subgroup_size) = if size_control {
            (control.min_subgroup_size, control.max_subgroup_size)
        } else {
            (subgroup.subgroup_size, subgroup.subgroup_size)
        };
        c.max_workgroup_subgroups = control.max_compute_workgroup_subgroups;
        c.subgroup_size_control = size_features.subgroup_size_control != 0 && size_features.compute_full_subgroups != 0;
        // A size that varies must be pinned in the compute stage; without that right only a fixed size is usable.
        let pinnable = control.required_subgroup_size_stages.contains(vk::ShaderStageFlags::COMPUTE);
        if c.min_subgroup_size != c.max_subgroup_size && !pinnable {
            c.subgroup_size_control = false;
        }
        c.synchronization2 = sync2.synchronization2 != 0;
        c.timeline_semaphore = timeline.timeline_semaphore != 0;
        c.float_atomics = atomic_float.shader_buffer_float32_atomic_add != 0;
        c.reconvergence = match (maximal.shader_maximal_reconvergence, uniform.shader_subgroup_uniform_control_flow) {
            (0, 0) => Reconvergence::None,
            (0, _) => Reconvergence::SubgroupUniform,
            _ => Reconvergence::Maximal,
        };
        c.max_storage_buffer_range = u64::from(limits.max_storage_buffer_range);
        c.max_allocation_bytes = maintenance.max_memory_allocation_size;
        c.max_storage_buffers = limits.max_per_stage_descriptor_storage_buffers;
        if driver.driver_id == vk::DriverId::MESA_LLVMPIPE {
            c.texel_reads = limits.max_per_stage_descriptor_storage_images;
        }
        c.max_push_constants = limits.max_push_constants_size;
        c.max_shared_bytes = limits.max_compute_shared_memory_size;
        c.max_workgroup_size = limits.max_compute_work_group_invocations.min(limits.max_compute_work_group_size[0]);
        [c.max_groups_x, c.max_groups_y, _] = limits.max_compute_work_group_count;
        c.device_heap = Heap::query(instance, physical, c.has_extension(ash::ext::memory_budget::NAME));
        let types = &memory.memory_types[..memory.memory_type_count as usize];
        c.device_upload = types.iter().any(|t| t.property_flags.contains(DEVICE_UPLOAD));
        c.timestamp_ns = f64::from(limits.timestamp_period);
        c.queue_families = families.iter().map(QueueFamily::of).collect();
        c.work_on(queue_family::choose(&c.queue_families, false));
        c.cache_uuid = uuid.iter().map(|b| format!("{b:02x}")).collect();
        self.driver = format!("{} {}", text(&driver.driver_name), text(&driver.driver_info));
    }
}

fn text(chars: &[std::ffi::c_char]) -> String {
    let bytes: Vec<u8> = chars.iter().take_while(|c| **c != 0).map(|c| c.to_ne_bytes()[0]).collect();
    String::from_utf8_lossy(&bytes).into_owned()
}

/// `1.3.230` from a packed version.
pub(super) fn show_version(version: u32) -> String {
    let (major, minor) = (vk::api_version_major(version), vk::api_version_minor(version));
    format!("{major}.{minor}.{}", vk::api_version_patch(version))
}
