//! Errors as statuses, panics caught, the thread's last message.

use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

use engine::{Error, Result};

/// `SPGS_OK`.
pub(crate) const OK: i32 = 0;
/// `SPGS_PANIC`.
pub(crate) const PANIC: i32 = 7;
/// `SPGS_NOT_READY`.
pub(crate) const NOT_READY: i32 = 8;

thread_local! {
    static MESSAGE: RefCell<CString> = RefCell::default();
}

fn remember(text: String) {
    // An interior NUL would end the text for C.
    let text = CString::new(text.replace('\0', "?")).unwrap_or_default();
    let _ = MESSAGE.try_with(|message| message.replace(text));
}

/// Runs a call: its error becomes the status, its panic [`PANIC`].
pub(crate) fn guard(call: impl FnOnce() -> Result<()>) -> i32 {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(())) => OK,
        Ok(Err(error)) => {
            remember(error.to_string());
            error.exit_code().into()
        }
        Err(panic) => {
            let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
            let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
            remember(format!("a defect of the engine: {text}"));
            PANIC
        }
    }
}

/// Runs what cannot fail but might panic.
pub(crate) fn quietly(call: impl FnOnce()) {
    if catch_unwind(AssertUnwindSafe(call)).is_err() {
        remember("a defect of the engine, while something was destroyed".into());
    }
}

pub(crate) fn null(what: &str) -> Error {
    Error::usage(what, "null", "an object")
}

/// The object behind a pointer.
///
/// # Safety
/// Null or valid, and not written meanwhile.
pub(crate) unsafe fn object<'a, T>(pointer: *const T, what: &str) -> Result<&'a T> {
    // SAFETY: promised by the caller.
    unsafe { pointer.as_ref() }.ok_or_else(|| null(what))
}

/// The object behind a pointer, to be changed.
///
/// # Safety
/// Null or valid, and not used otherwise meanwhile.
pub(crate) unsafe fn object_mut<'a, T>(pointer: *mut T, what: &str) -> Result<&'a mut T> {
    // SAFETY: promised by the caller.
    unsafe { pointer.as_mut() }.ok_or_else(|| null(what))
}

/// Writes a result where the caller wants it.
///
/// # Safety
/// Null or valid for writing.
pub(crate) unsafe fn store<T>(pointer: *mut T, value: T) {
    if !pointer.is_null() {
        // SAFETY: promised by the caller; what was there is plain data or uninitialised.
        unsafe { pointer.write(value) };
    }
}

/// A text of the caller's.
///
/// # Safety
/// Null or NUL-terminated.
pub(crate) unsafe fn text<'a>(pointer: *const c_char, what: &str) -> Result<&'a str> {
    if pointer.is_null() {
        return Err(null(what));
    }
    // SAFETY: promised by the caller.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| Error::usage(what, text.to_string_lossy(), "UTF-8"))
}

/// The options of a caller that was compiled with an older or newer header: as many bytes as both know, the rest zero.
///
/// # Safety
/// Null, or the first word is the size of what the pointer leads to.
pub(crate) unsafe fn options<T: Copy + Default>(pointer: *const T, what: &str) -> Result<T> {
    let mut known = T::default();
    if pointer.is_null() {
        return Ok(known);
    }
    // SAFETY: every such structure begins with its size.
    let given = unsafe { pointer.cast::<u32>().read() } as usize;
    if given < size_of::<u32>() || given > 1 << 16 {
        return Err(Error::usage(format!("{what}.struct_size"), given.to_string(), format!("{}", size_of::<T>())));
    }
    // SAFETY: both are at least this long; T is plain data for which zero bytes are valid.
    unsafe {
        std::ptr::copy_nonoverlapping(pointer.cast::<u8>(), (&raw mut known).cast::<u8>(), given.min(size_of::<T>()));
    }
    Ok(known)
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub extern "C" fn spgs_message() -> *const c_char {
    MESSAGE.try_with(|message| message.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

/// See `spgs.h`.
#[unsafe(no_mangle)]
pub extern "C" fn spgs_version() -> u32 {
    let part = |text: &str| text.parse::<u32>().unwrap_or(0);
    part(env!("CARGO_PKG_VERSION_MAJOR")) << 16
        | part(env!("CARGO_PKG_VERSION_MINOR")) << 8
        | part(env!("CARGO_PKG_VERSION_PATCH"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::panic, reason = "tests")]
    use super::*;

    fn message() -> String {
        // SAFETY: never null, valid until the next call of this thread.
        unsafe { CStr::from_ptr(spgs_message()) }.to_string_lossy().into_owned()
    }

    #[test]
    fn a_panic_is_a_status_and_a_message() {
        assert_eq!(guard(|| panic!("a wheel came off")), PANIC);
        assert!(message().contains("a wheel came off"), "{}", message());
        assert_eq!(guard(|| Err(null("view"))), 2);
        assert_eq!(message(), "view: found null, expected an object");
        assert_eq!(guard(|| Ok(())), OK);
        quietly(|| panic!("another"));
        assert!(message().contains("destroyed"));
        // Another thread has its own, and none yet.
        assert_eq!(std::thread::spawn(message).join().ok(), Some(String::new()));
    }
}
