//! Messages of the validation layer, collected in a list.

use std::ffi::CStr;
use std::sync::{Arc, Mutex};

use ash::vk;

use super::device::{lock, vk_error};
use crate::error::Result;

/// The extension's functions and its handle.
pub(super) type Messenger = (ash::ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT);
/// What the validation layer said.
pub(super) type Messages = Arc<Mutex<Vec<String>>>;

/// Makes the messenger that appends warnings and errors to `messages`.
pub(super) fn create_messenger(
    entry: &ash::Entry,
    instance: &ash::Instance,
    messages: &Messages,
) -> Result<Messenger> {
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
