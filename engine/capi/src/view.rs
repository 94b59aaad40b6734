//! Views.
#![allow(non_camel_case_types, reason = "the names of the header")]

use std::ffi::c_void;

use engine::gpu::HostCommandBuffer;
use engine::render::{PixelFormat, Target, View, ViewOptions};
use engine::{Error, Result};

use crate::gpu::spgs_gpu;
use crate::scene::spgs_scene;
use crate::status::{guard, null, object, object_mut, options, quietly, store};
use crate::types::{spgs_camera, spgs_finished, spgs_statistics, spgs_target, spgs_view_options};

/// See `spgs.h`.
#[derive(Debug)]
pub struct spgs_view(View);

fn view_options(given: &spgs_view_options) -> Result<ViewOptions> {
    let format = match given.format {
        0 => PixelFormat::Rgba8,
        1 => PixelFormat::Bgra8,
        2 => PixelFormat::Rgba16F,
        3 => PixelFormat::Rgba32F,
        other => return Err(Error::usage("spgs_view_options.format", other.to_string(), "0 to 3")),
    };
    let default = ViewOptions::default();
    Ok(ViewOptions {
        background: given.background,
        near: if given.near_plane == 0.0 { default.near } else { given.near_plane },
        format,
        storage: given.storage != 0,
        depth: given.depth != 0,
        in_flight: if given.in_flight == 0 { default.in_flight } else { given.in_flight },
        max_instances: (given.max_instances > 0).then_some(given.max_instances),
        profile: false,
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_view_create(
    gpu: *const spgs_gpu,
    scene: *const spgs_scene,
    given: *const spgs_view_options,
    view: *mut *mut spgs_view,
) -> i32 {
    guard(|| {
        if view.is_null() {
            return Err(null("view"));
        }
        // SAFETY: promised by the caller.
        unsafe {
            let (gpu, scene) = (object(gpu, "gpu")?, object(scene, "scene")?);
            let options = view_options(&options(given, "spgs_view_options")?)?;
            store(view, Box::into_raw(Box::new(spgs_view(View::new(&gpu.0, &scene.handle, &options)?))));
        }
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_view_warm_up(
    view: *mut spgs_view,
    camera: *const spgs_camera,
    time: f64,
    statistics: *mut spgs_statistics,
) -> i32 {
    guard(|| {
        // SAFETY: promised by the caller.
        unsafe {
            let (view, camera) = (object_mut(view, "view")?, object(camera, "camera")?);
            store(statistics, view.0.warm_up(&camera.camera()?, time)?.into());
        }
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_view_record(
    view: *mut spgs_view,
    command_buffer: *mut c_void,
    camera: *const spgs_camera,
    time: f64,
    target: *const spgs_target,
    finished: *mut spgs_finished,
) -> i32 {
    guard(|| {
        if command_buffer.is_null() {
            return Err(null("command_buffer"));
        }
        // SAFETY: promised by the caller.
        unsafe {
            let (view, camera) = (object_mut(view, "view")?, object(camera, "camera")?);
            let target = object(target, "target")?;
            target.color.check("target.color")?;
            let depth = target.depth.as_ref();
            depth.map_or(Ok(()), |d| d.check("target.depth"))?;
            let depth = depth.map(|d| d.host_image());
            let target = Target { color: target.color.host_image(), depth };
            let commands = HostCommandBuffer::from_raw(command_buffer as u64);
            let recorded = view.0.record(&commands, &camera.camera()?, time, &target)?;
            store(finished, recorded.finished.into());
        }
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_view_all_finished(view: *mut spgs_view, finished: *mut spgs_finished) -> i32 {
    guard(|| {
        // SAFETY: promised by the caller.
        unsafe {
            let latest = object_mut(view, "view")?.0.all_finished()?;
            store(finished, latest.into());
        }
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_view_set_scene(view: *mut spgs_view, scene: *const spgs_scene) -> i32 {
    guard(|| {
        // SAFETY: promised by the caller.
        unsafe { object_mut(view, "view")?.0.set_scene(&object(scene, "scene")?.handle) }
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_view_destroy(view: *mut spgs_view) {
    if !view.is_null() {
        // SAFETY: made by Box::into_raw, destroyed once.
        quietly(|| drop(unsafe { Box::from_raw(view) }));
    }
}
