//! Surfaces: what a window is for Vulkan. Opening a device that can present to one.

use std::ffi::CStr;
use std::sync::Arc;

use ash::vk;
use raw_window_handle::{HandleError, HasDisplayHandle, HasWindowHandle};

use super::device::{Gpu, devices};
use super::options::GpuOptions;
use crate::error::{Error, Result};

/// A window and its display connection. Implemented for every window type with raw handles.
pub trait WindowHandle: HasDisplayHandle + HasWindowHandle + Send + Sync {}

impl<T: HasDisplayHandle + HasWindowHandle + Send + Sync> WindowHandle for T {}

/// A window's surface. Keeps window and device alive.
pub struct Surface {
    pub(super) raw: vk::SurfaceKHR,
    pub(super) loader: ash::khr::surface::Instance,
    pub(super) gpu: Gpu,
    _window: Arc<dyn WindowHandle>,
}

impl std::fmt::Debug for Surface {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Surface").field("gpu", &self.gpu).finish_non_exhaustive()
    }
}

impl Gpu {
    /// Opens a device that can show pictures in `window`: the one that [`Gpu::new`] would open, or, when it cannot and
    /// `options` name none, the first that can.
    ///
    /// # Errors
    /// `NoDevice` when the window system has no Vulkan surfaces or no device presents to this one; as [`Gpu::new`].
    pub fn with_window(options: &GpuOptions, window: &Arc<dyn WindowHandle>) -> Result<(Self, Surface)> {
        let display = window.display_handle().map_err(no_handle)?.as_raw();
        let names = ash_window::enumerate_required_extensions(display).map_err(|code| Error::NoDevice {
            reason: format!("no Vulkan surfaces on this kind of display: {code:?}"),
        })?;
        let mut options = options.clone();
        // SAFETY: the crate returns pointers to NUL-terminated strings that live forever.
        options.instance_extensions.extend(names.iter().map(|n| unsafe { CStr::from_ptr(*n) }.to_owned()));
        options.device_extensions.push(ash::khr::swapchain::NAME.to_owned());
        options.draws = true;
        let first = Self::new(&options).and_then(|gpu| Surface::new(&gpu, window));
        if first.is_ok() || options.device.is_some() {
            return first.map(|surface| (surface.gpu.clone(), surface));
        }
        for info in devices()? {
            options.device = Some(info.index.to_string());
            if let Ok(surface) = Self::new(&options).and_then(|gpu| Surface::new(&gpu, window)) {
                return Ok((surface.gpu.clone(), surface));
            }
        }
        first.map(|surface| (surface.gpu.clone(), surface))
    }
}

impl Surface {
    fn new(gpu: &Gpu, window: &Arc<dyn WindowHandle>) -> Result<Self> {
        let display = window.display_handle().map_err(no_handle)?.as_raw();
        let handle = window.window_handle().map_err(no_handle)?.as_raw();
        let shared = &gpu.0;
        // SAFETY: the handles are of a live window, which the surface keeps until it is gone.
        let raw = unsafe { ash_window::create_surface(&shared.entry, &shared.instance, display, handle, None) }
            .map_err(|code| Error::NoDevice { reason: format!("no Vulkan surface for the window: {code:?}") })?;
        let loader = ash::khr::surface::Instance::new(&shared.entry, &shared.instance);
        let surface = Self { raw, loader, gpu: gpu.clone(), _window: Arc::clone(window) };
        if surface.is_supported() {
            return Ok(surface);
        }
        Err(Error::NoDevice { reason: format!("{} cannot show images in a window here", gpu.info().name) })
    }

    /// Whether the device's queue draws, computes and presents.
    fn is_supported(&self) -> bool {
        let shared = &self.gpu.0;
        let (physical, family) = (shared.physical, shared.family);
        // SAFETY: plain queries of live handles.
        let (families, presents) = unsafe {
            (
                shared.instance.get_physical_device_queue_family_properties(physical),
                self.loader.get_physical_device_surface_support(physical, family, self.raw),
            )
        };
        let flags = families.get(family as usize).map_or(vk::QueueFlags::empty(), |f| f.queue_flags);
        flags.contains(vk::QueueFlags::COMPUTE | vk::QueueFlags::GRAPHICS) && presents.unwrap_or(false)
    }
}

impl Drop for Surface {
    fn drop(&mut self) {
        // SAFETY: a swapchain owns its surface and destroys itself first.
        unsafe { self.loader.destroy_surface(self.raw, None) };
    }
}

fn no_handle(error: HandleError) -> Error {
    Error::NoDevice { reason: format!("the window has no handle: {error}") }
}
