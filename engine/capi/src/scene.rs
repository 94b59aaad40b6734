//! Scenes.
#![allow(non_camel_case_types, reason = "the names of the header")]

use std::ffi::c_char;
use std::path::{Path, PathBuf};

use engine::gpu::Gpu;
use engine::render::{Loading, Quality, SceneHandle, SceneOptions};
use engine::scene::synthetic::demo_scene;
use engine::scene::{MotionSource, Scene};
use engine::{Error, Result};

use crate::gpu::spgs_gpu;
use crate::status::{NOT_READY, OK, guard, null, object, options, quietly, store, text};
use crate::types::{spgs_scene_info, spgs_scene_options};

/// See `spgs.h`.
#[derive(Debug)]
pub struct spgs_scene(pub(crate) SceneHandle);

/// See `spgs.h`.
#[derive(Debug)]
pub struct spgs_loading(Loading);

/// # Safety
/// As [`options`].
unsafe fn scene_options(given: *const spgs_scene_options) -> Result<SceneOptions> {
    // SAFETY: promised by the caller.
    let given = unsafe { options(given, "spgs_scene_options")? };
    let unknown =
        |what: &str, value: u32| Error::usage(format!("spgs_scene_options.{what}"), value.to_string(), "0 to 2");
    let motion = match given.motion {
        0 => MotionSource::Auto,
        1 => MotionSource::Table,
        2 => MotionSource::Network,
        other => return Err(unknown("motion", other)),
    };
    let quality = match given.quality {
        0 => Quality::EXACT,
        1 => Quality::named("high")?,
        2 => Quality::named("fast")?,
        other => return Err(unknown("quality", other)),
    };
    Ok(SceneOptions { motion, quality })
}

fn read(path: &Path) -> Result<Scene> {
    Ok(engine::file::load(path)?.scene)
}

fn upload(gpu: &Gpu, scene: &Scene, options: &SceneOptions, out: *mut *mut spgs_scene) -> Result<()> {
    let handle = SceneHandle::upload(gpu, scene, options)?;
    // SAFETY: checked for null by the caller, valid as spgs.h demands.
    unsafe { store(out, Box::into_raw(Box::new(spgs_scene(handle)))) };
    Ok(())
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
        upload(&gpu.0, &read(Path::new(path))?, &options, scene)
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
        upload(&gpu.0, &demo_scene(), &options, scene)
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
        let path = PathBuf::from(path);
        let made = SceneHandle::load(&gpu.0, move || read(&path), &options);
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
        unsafe { store(scene, Box::into_raw(Box::new(spgs_scene(handle)))) };
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
        let scene = &unsafe { object(scene, "scene")? }.0;
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
pub unsafe extern "C" fn spgs_scene_destroy(scene: *mut spgs_scene) {
    if !scene.is_null() {
        // SAFETY: made by Box::into_raw, destroyed once.
        quietly(|| drop(unsafe { Box::from_raw(scene) }));
    }
}
