//! Surfaces: what a window is for Vulkan. Opening a device that can present to one.

use std::ffi::CStr;
#[cfg(feature = "window")]
use std::sync::Arc;

use ash::vk;

use super::capability::DeviceInfo;
#[cfg(feature = "window")]
use super::device::{Gpu, GpuOptions};
#[cfg(feature = "window")]
use crate::error::Error;
use crate::error::Result;

/// Makes a surface from a new instance.
type MakeSurface<'a> = dyn Fn(&ash::Entry, &ash::Instance) -> Result<vk::SurfaceKHR> + 'a;

/// Where pictures go: instance extensions that are needed for it, and how its surface is made.
pub(super) struct Screen<'a> {
    pub(super) extensions: &'a [&'static CStr],
    pub(super) make: &'a MakeSurface<'a>,
}

impl Screen<'static> {
    /// Nowhere: the surface is null.
    pub(super) const NONE: Self = Self { extensions: &[], make: &|_, _| Ok(vk::SurfaceKHR::null()) };
}

/// Destroys a surface that nothing uses; a null one is ignored.
pub(super) fn destroy_surface(entry: &ash::Entry, instance: &ash::Instance, surface: vk::SurfaceKHR) {
    if surface != vk::SurfaceKHR::null() {
        // SAFETY: made from this instance; the caller has nothing left that was made from it.
        unsafe { ash::khr::surface::Instance::new(entry, instance).destroy_surface(surface, None) };
    }
}

/// A queue family of the device that computes, draws and presents to `surface`.
pub(super) fn present_family(
    entry: &ash::Entry,
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    info: &DeviceInfo,
    surface: vk::SurfaceKHR,
) -> Option<u32> {
    if !info.capabilities.has_extension(ash::khr::swapchain::NAME) {
        return None;
    }
    let loader = ash::khr::surface::Instance::new(entry, instance);
    // SAFETY: plain query.
    let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
    let presents = |index: u32| {
        // SAFETY: plain query of a live surface.
        unsafe { loader.get_physical_device_surface_support(physical, index, surface) }.unwrap_or(false)
    };
    let wanted = vk::QueueFlags::COMPUTE | vk::QueueFlags::GRAPHICS;
    (0..).zip(&families).find(|(i, f)| f.queue_flags.contains(wanted) && presents(*i)).map(|(i, _)| i)
}

/// A window and its display connection. Implemented for every window type with raw handles.
#[cfg(feature = "window")]
pub trait WindowHandle:
    raw_window_handle::HasDisplayHandle + raw_window_handle::HasWindowHandle + Send + Sync
{
}

#[cfg(feature = "window")]
impl<T: raw_window_handle::HasDisplayHandle + raw_window_handle::HasWindowHandle + Send + Sync> WindowHandle for T {}

/// A window's surface. Keeps window and device alive.
#[cfg(feature = "window")]
pub struct Surface {
    pub(super) raw: vk::SurfaceKHR,
    pub(super) loader: ash::khr::surface::Instance,
    pub(super) gpu: Gpu,
    _window: Arc<dyn WindowHandle>,
}

#[cfg(feature = "window")]
impl std::fmt::Debug for Surface {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Surface").field("gpu", &self.gpu).finish_non_exhaustive()
    }
}

#[cfg(feature = "window")]
impl Gpu {
    /// Opens a device that can show pictures in `window`. Without `--device` only such devices are looked at.
    ///
    /// # Errors
    /// `NoDevice` when the window system has no Vulkan surfaces or no device presents to this one.
    pub fn with_window(options: &GpuOptions, window: &Arc<dyn WindowHandle>) -> Result<(Self, Surface)> {
        let no_handle =
            |e: raw_window_handle::HandleError| Error::NoDevice { reason: format!("the window has no handle: {e}") };
        let display = window.display_handle().map_err(no_handle)?.as_raw();
        let handle = window.window_handle().map_err(no_handle)?.as_raw();
        let names = ash_window::enumerate_required_extensions(display).map_err(|code| Error::NoDevice {
            reason: format!("no Vulkan surfaces on this kind of display: {code:?}"),
        })?;
        // SAFETY: the crate returns pointers to NUL-terminated strings that live forever.
        let extensions: Vec<&'static CStr> = names.iter().map(|n| unsafe { CStr::from_ptr(*n) }).collect();
        let make = |entry: &ash::Entry, instance: &ash::Instance| {
            // SAFETY: the handles are of a live window, which `Surface` keeps until the surface is gone.
            unsafe { ash_window::create_surface(entry, instance, display, handle, None) }
                .map_err(|code| Error::NoDevice { reason: format!("no Vulkan surface for the window: {code:?}") })
        };
        let (gpu, raw) = Self::new_for(options, &Screen { extensions: &extensions, make: &make })?;
        let loader = ash::khr::surface::Instance::new(&gpu.0.entry, &gpu.0.instance);
        let surface = Surface { raw, loader, gpu: gpu.clone(), _window: Arc::clone(window) };
        Ok((gpu, surface))
    }
}

#[cfg(feature = "window")]
impl Drop for Surface {
    fn drop(&mut self) {
        // SAFETY: the swapchain, which owns the surface, destroys itself first.
        unsafe { self.loader.destroy_surface(self.raw, None) };
    }
}
