//! The Vulkan instance: loader, layers, extensions, the validation layer's messages.

use std::ffi::CStr;
use std::sync::{Arc, Mutex};

use ash::vk;

use super::capability::show_version;
use super::device::{lock, vk_error};
use super::options::GpuOptions;
use crate::error::{Error, Result};

pub(super) type Messenger = (ash::ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT);
pub(super) type Messages = Arc<Mutex<Vec<String>>>;

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";
/// The first headers that know `VK_KHR_shader_maximal_reconvergence`.
const KNOWS_RECONVERGENCE: u32 = vk::make_api_version(0, 1, 3, 276);

/// Whether the validation layer is older than what the engine asks of newer drivers: it takes that for a mistake.
pub(super) fn validation_layer_is_old(entry: &ash::Entry) -> bool {
    // SAFETY: plain enumeration.
    let available = unsafe { entry.enumerate_instance_layer_properties() }.unwrap_or_default();
    let layer = available.iter().find(|l| l.layer_name_as_c_str() == Ok(VALIDATION_LAYER));
    layer.is_some_and(|l| l.spec_version < KNOWS_RECONVERGENCE)
}

pub(super) fn create_instance(
    options: &GpuOptions,
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
    let mut extensions: Vec<_> = options.instance_extensions.iter().map(|e| e.as_ptr()).collect();
    if options.validation {
        // SAFETY: plain query.
        let available = unsafe { entry.enumerate_instance_layer_properties() }.map_err(no_instance)?;
        if !available.iter().any(|l| l.layer_name_as_c_str() == Ok(VALIDATION_LAYER)) {
            let reason =
                "validation was asked for, but VK_LAYER_KHRONOS_validation is not installed; run ci/setup --tests";
            return Err(Error::NoDevice { reason: reason.into() });
        }
        layers.push(VALIDATION_LAYER.as_ptr());
        extensions.push(ash::ext::debug_utils::NAME.as_ptr());
        extensions.push(ash::ext::validation_features::NAME.as_ptr());
    }
    // SAFETY: plain query.
    let available = unsafe { entry.enumerate_instance_extension_properties(None) }.map_err(no_instance)?;
    let has = |name: &CStr| available.iter().any(|e| e.extension_name_as_c_str() == Ok(name));
    if let Some(lacking) = options.instance_extensions.iter().find(|e| !has(e)) {
        let reason = format!("the Vulkan loader lacks the instance extension {}", lacking.to_string_lossy());
        return Err(Error::NoDevice { reason });
    }
    let mut flags = vk::InstanceCreateFlags::empty();
    if has(ash::khr::portability_enumeration::NAME) {
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

fn create_messenger(entry: &ash::Entry, instance: &ash::Instance, messages: &Messages) -> Result<Messenger> {
    let loader = ash::ext::debug_utils::Instance::new(entry, instance);
    let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(vk::DebugUtilsMessageSeverityFlagsEXT::ERROR | vk::DebugUtilsMessageSeverityFlagsEXT::WARNING)
        .message_type(
            vk::DebugUtilsMessageTypeFlagsEXT::GENERAL
                | vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION
                | vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE,
        )
        .pfn_user_callback(Some(on_message))
        .user_data(Arc::as_ptr(messages).cast_mut().cast());
    // SAFETY: `messages` is kept by `Shared`, which destroys the messenger before it drops the list.
    let messenger = unsafe { loader.create_debug_utils_messenger(&create, None) };
    Ok((loader, messenger.map_err(vk_error("vkCreateDebugUtilsMessengerEXT"))?))
}

// SAFETY contract: called by the validation layer with a valid callback data pointer and our list as user data.
unsafe extern "system" fn on_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut std::ffi::c_void,
) -> vk::Bool32 {
    if data.is_null() || user.is_null() {
        return vk::FALSE;
    }
    // SAFETY: see the contract above; the text is a NUL-terminated string when present.
    let (text, list) = unsafe {
        let text = if (*data).p_message.is_null() {
            String::new()
        } else {
            CStr::from_ptr((*data).p_message).to_string_lossy().into_owned()
        };
        (text, &*user.cast::<Mutex<Vec<String>>>())
    };
    log::warn!("validation: {text}");
    lock(list).push(text);
    vk::FALSE
}
