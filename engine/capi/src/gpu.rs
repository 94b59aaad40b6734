//! Devices.
#![allow(non_camel_case_types, reason = "the names of the header")]

use std::ffi::{CStr, CString, c_char, c_void};
use std::sync::{Arc, OnceLock};

use engine::gpu::host::{GetInstanceProcAddr, host_requirements};
use engine::gpu::{Gpu, GpuOptions, HostDevice, QueueLock, SelfTest};
use engine::self_test::Suite;
use engine::{Error, Result};

use crate::status::{guard, null, object, options, quietly, store, text};
use crate::texts::Texts;
use crate::types::{LockFunction, spgs_gpu_options, spgs_handles, spgs_host};

/// See `spgs.h`.
#[derive(Debug)]
pub struct spgs_gpu(pub(crate) Gpu);

/// The host's lock as it came from C.
struct Lock {
    lock: LockFunction,
    unlock: LockFunction,
    user: *mut c_void,
}

// SAFETY: spgs.h demands that the functions may be called from any thread with this pointer.
unsafe impl Send for Lock {}
// SAFETY: as above.
unsafe impl Sync for Lock {}

impl QueueLock for Lock {
    fn lock(&self) {
        if let Some(lock) = self.lock {
            // SAFETY: the caller's function with the caller's pointer.
            unsafe { lock(self.user) };
        }
    }
    fn unlock(&self) {
        if let Some(unlock) = self.unlock {
            // SAFETY: as above.
            unsafe { unlock(self.user) };
        }
    }
}

/// The engine's error with the names of the header.
fn of_host(error: Error) -> Error {
    match error {
        Error::Usage { what, found, expected } => {
            Error::Usage { what: what.replace("HostDevice::", "spgs_host."), found, expected }
        }
        other => other,
    }
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_required_extensions(
    api_version: u32,
    names: *mut *const *const c_char,
    count: *mut u32,
) -> i32 {
    static LISTS: OnceLock<[Texts; 2]> = OnceLock::new();
    const VERSION_1_3: u32 = 1 << 22 | 3 << 12;
    guard(|| {
        let versions = [0, VERSION_1_3];
        let lists = LISTS.get_or_init(|| {
            versions.map(|v| Texts::new(host_requirements(v).extensions.into_iter().map(CStr::to_bytes)))
        });
        // SAFETY: promised by the caller.
        unsafe { lists[usize::from(api_version >= VERSION_1_3)].give(names, count, "names, count") }
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_required_features(names: *mut *const *const c_char, count: *mut u32) -> i32 {
    static LIST: OnceLock<Texts> = OnceLock::new();
    guard(|| {
        let list = LIST.get_or_init(|| Texts::new(host_requirements(0).features));
        // SAFETY: promised by the caller.
        unsafe { list.give(names, count, "names, count") }
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_gpu_from_host(host: *const spgs_host, gpu: *mut *mut spgs_gpu) -> i32 {
    guard(|| {
        if host.is_null() || gpu.is_null() {
            return Err(null("host, gpu"));
        }
        // SAFETY: promised by the caller.
        let host = unsafe { options(host, "spgs_host")? };
        let lock = Lock { lock: host.lock_queue, unlock: host.unlock_queue, user: host.lock_user };
        if lock.lock.is_some() != lock.unlock.is_some() {
            return Err(Error::usage("spgs_host", "one of lock_queue and unlock_queue", "both or none"));
        }
        let locked = lock.lock.is_some();
        let device = HostDevice {
            // SAFETY: spgs.h demands a PFN_vkGetInstanceProcAddr.
            get_instance_proc_addr: host.get_instance_proc_addr.map(|function| unsafe {
                std::mem::transmute::<unsafe extern "system" fn(), GetInstanceProcAddr>(function)
            }),
            api_version: host.api_version,
            instance: host.instance as u64,
            physical_device: host.physical_device as u64,
            device: host.device as u64,
            queue: host.queue as u64,
            queue_family: host.queue_family,
            queue_lock: locked.then(|| Arc::new(lock) as Arc<dyn QueueLock>),
        };
        // SAFETY: promised by the caller.
        unsafe {
            let made = Gpu::from_host(&device, &GpuOptions::default()).map_err(of_host)?;
            store(gpu, Box::into_raw(Box::new(spgs_gpu(made))));
        }
        Ok(())
    })
}

/// # Safety
/// The array has `count` NUL-terminated texts.
unsafe fn list(names: *const *const c_char, count: u32, what: &str) -> Result<Vec<CString>> {
    if count > 0 && names.is_null() {
        return Err(null(what));
    }
    // SAFETY: promised by the caller.
    (0..count as usize).map(|i| Ok(CString::new(unsafe { text(*names.add(i), what)? }).unwrap_or_default())).collect()
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_gpu_create(given: *const spgs_gpu_options, gpu: *mut *mut spgs_gpu) -> i32 {
    guard(|| {
        if gpu.is_null() {
            return Err(null("gpu"));
        }
        // Who uses the handles often draws.
        let mut wanted = GpuOptions { draws: true, ..GpuOptions::default() };
        // SAFETY: promised by the caller.
        unsafe {
            let given = options(given, "spgs_gpu_options")?;
            if !given.device_name.is_null() {
                wanted.device = Some(text(given.device_name, "device_name")?.to_owned());
            }
            wanted.validation |= given.validation != 0;
            if given.skip_self_test != 0 {
                wanted.self_test = SelfTest::Skip;
            }
            wanted.instance_extensions =
                list(given.instance_extensions, given.instance_extension_count, "instance_extensions")?;
            wanted.device_extensions =
                list(given.device_extensions, given.device_extension_count, "device_extensions")?;
            store(gpu, Box::into_raw(Box::new(spgs_gpu(Gpu::new(&wanted)?))));
        }
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_gpu_self_test(gpu: *const spgs_gpu) -> i32 {
    guard(|| {
        // SAFETY: promised by the caller.
        let gpu = unsafe { object(gpu, "gpu")? };
        let mut plays = Suite::ALL.into_iter().filter(|suite| !suite.trains());
        plays.try_for_each(|suite| gpu.0.self_test(suite).map(|_| ()))
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_gpu_handles(gpu: *const spgs_gpu, handles: *mut spgs_handles) -> i32 {
    guard(|| {
        // SAFETY: promised by the caller.
        let found = unsafe { object(gpu, "gpu")? }.0.handles();
        if handles.is_null() {
            return Err(null("handles"));
        }
        let value = spgs_handles {
            instance: found.instance as *mut c_void,
            physical_device: found.physical_device as *mut c_void,
            device: found.device as *mut c_void,
            queue_family: found.queue_family,
            reserved: 0,
        };
        // SAFETY: promised by the caller.
        unsafe { store(handles, value) };
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_gpu_with_queue(
    gpu: *const spgs_gpu,
    submit: Option<unsafe extern "C" fn(*mut c_void, *mut c_void)>,
    user: *mut c_void,
) -> i32 {
    guard(|| {
        let submit = submit.ok_or_else(|| null("submit"))?;
        // SAFETY: promised by the caller.
        unsafe { object(gpu, "gpu")?.0.with_queue(|queue| submit(queue as *mut c_void, user)) };
        Ok(())
    })
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spgs_gpu_destroy(gpu: *mut spgs_gpu) {
    if !gpu.is_null() {
        // SAFETY: made by Box::into_raw, destroyed once.
        quietly(|| drop(unsafe { Box::from_raw(gpu) }));
    }
}
