//! Scenes.
#![allow(non_camel_case_types, reason = "the names of the header")]

use std::ffi::c_char;
use std::path::Path;

use engine::render::{Loading, Quality, SceneHandle, SceneOptions};
use engine::scene::MotionSource;
use engine::scene::synthetic::demo_scene;
use engine::{Error, Result};

use crate::gpu::spgs_gpu;
use crate::status::{NOT_READY, OK, guard, null, object, options, quietly, store, text};
use crate::texts::Texts;
use crate::types::{spgs_scene_extent, spgs_scene_info, spgs_scene_options};

/// See `spgs.h`.
#[derive(Debug)]
pub struct spgs_scene {
    pub(crate) handle: SceneHandle,
    warnings: Texts,
}

impl spgs_scene {
    /// Gives the caller a scene of its own.
    ///
    /// # Safety
    /// The pointer is null or valid for writing.
    unsafe fn give(handle: SceneHandle, out: *mut *mut Self) {
        let warnings = Texts::new(handle.warnings().iter().map(String::as_str));
        // SAFETY: promised by the caller.
        unsafe { store(out, Box::into_raw(Box::new(Self { handle, warnings }))) };
    }
}

/// See `spgs.h`.
#[derive(Debug)]
pub struct spgs_loading(Loading);

/// # Safety
/// As [`options`].
unsafe fn scene_options(given: *const spgs_scene_options) -> Result<SceneOptions> {
    // SAFETY: promised by the caller.
    let given = unsafe { options(given, "spgs_scene_options")? };
    let unknown = |what: &str, value: u32, expected: &str| {
        Error::usage(format!("spgs_scene_options.{what}"), value.to_string(), expected)
    };
    let motion = match given.motion {
        0 => MotionSource::Auto,
        1 => MotionSource::Table,
        2 => MotionSource::Network,
        other => return Err(unknown("motion", other, "0 to 2")),
    };
    let quality = match given.quality {
        0 => Quality::EXACT,
        1 => Quality::named("high")?,
        other => return Err(unknown("quality", other, "0 or 1")),
    };
    Ok(SceneOptions { motion, quality })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_scene_load(
    gpu: *const spgs_gpu,
    path: *const c_char,
    options: *const spgs_scene_options,
    scene: *mut *mut spgs_scene,
) -> i32 {
    guard(|| {
        if scene.is_null() {
            return Err(null("scene"));
        }
        // SAFETY: promised by the caller.
        let (gpu, path, options) = unsafe { (object(gpu, "gpu")?, text(path, "path")?, scene_options(options)?) };
        let handle = SceneHandle::upload_loaded(&gpu.0, engine::file::load(Path::new(path))?, &options)?;
        // SAFETY: promised by the caller.
        unsafe { spgs_scene::give(handle, scene) };
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_scene_demo(
    gpu: *const spgs_gpu,
    options: *const spgs_scene_options,
    scene: *mut *mut spgs_scene,
) -> i32 {
    guard(|| {
        if scene.is_null() {
            return Err(null("scene"));
        }
        // SAFETY: promised by the caller.
        let (gpu, options) = unsafe { (object(gpu, "gpu")?, scene_options(options)?) };
        let handle = SceneHandle::upload(&gpu.0, &demo_scene(), &options)?;
        // SAFETY: promised by the caller.
        unsafe { spgs_scene::give(handle, scene) };
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_scene_load_async(
    gpu: *const spgs_gpu,
    path: *const c_char,
    options: *const spgs_scene_options,
    loading: *mut *mut spgs_loading,
) -> i32 {
    guard(|| {
        if loading.is_null() {
            return Err(null("loading"));
        }
        // SAFETY: promised by the caller.
        let (gpu, path, options) = unsafe { (object(gpu, "gpu")?, text(path, "path")?, scene_options(options)?) };
        let made = SceneHandle::load_file(&gpu.0, path, &options);
        // SAFETY: promised by the caller.
        unsafe { store(loading, Box::into_raw(Box::new(spgs_loading(made)))) };
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_loading_poll(loading: *const spgs_loading) -> i32 {
    let mut finished = false;
    let status = guard(|| {
        // SAFETY: promised by the caller.
        finished = unsafe { object(loading, "loading")? }.0.is_finished();
        Ok(())
    });
    if status == OK && !finished { NOT_READY } else { status }
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_loading_finish(loading: *mut spgs_loading, scene: *mut *mut spgs_scene) -> i32 {
    guard(|| {
        if loading.is_null() {
            return Err(null("loading"));
        }
        // SAFETY: made by Box::into_raw, given up here.
        let loading = unsafe { Box::from_raw(loading) };
        if scene.is_null() {
            return Err(null("scene"));
        }
        let handle = loading.0.finish()?;
        // SAFETY: promised by the caller.
        unsafe { spgs_scene::give(handle, scene) };
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_loading_cancel(loading: *mut spgs_loading) {
    if !loading.is_null() {
        // SAFETY: made by Box::into_raw, destroyed once.
        quietly(|| drop(unsafe { Box::from_raw(loading) }));
    }
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_scene_get_info(scene: *const spgs_scene, info: *mut spgs_scene_info) -> i32 {
    guard(|| {
        // SAFETY: promised by the caller.
        let scene = &unsafe { object(scene, "scene")? }.handle;
        if info.is_null() {
            return Err(null("info"));
        }
        let value = spgs_scene_info {
            gaussians: scene.gaussians().into(),
            rejected: scene.rejected().total() as u64,
            bytes: scene.bytes(),
        };
        // SAFETY: promised by the caller.
        unsafe { store(info, value) };
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_scene_get_extent(scene: *const spgs_scene, extent: *mut spgs_scene_extent) -> i32 {
    guard(|| {
        // SAFETY: promised by the caller.
        let scene = &unsafe { object(scene, "scene")? }.handle;
        if extent.is_null() {
            return Err(null("extent"));
        }
        let found = scene.extent();
        let value = spgs_scene_extent {
            first_time: found.times[0],
            last_time: found.times[1],
            center: found.center.to_array(),
            radius: found.radius,
            motion: match scene.motion() {
                None | Some(MotionSource::Auto) => 0,
                Some(MotionSource::Table) => 1,
                Some(MotionSource::Network) => 2,
            },
            one_after_another: scene.one_after_another().into(),
        };
        // SAFETY: promised by the caller.
        unsafe { store(extent, value) };
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_scene_warnings(
    scene: *const spgs_scene,
    warnings: *mut *const *const c_char,
    count: *mut u32,
) -> i32 {
    guard(|| {
        // SAFETY: promised by the caller.
        unsafe { object(scene, "scene")?.warnings.give(warnings, count, "warnings, count") }
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_scene_destroy(scene: *mut spgs_scene) {
    if !scene.is_null() {
        // SAFETY: made by Box::into_raw, destroyed once.
        quietly(|| drop(unsafe { Box::from_raw(scene) }));
    }
}
