//! Lists of texts that stay where C was told they are.

use std::ffi::{CString, c_char};

use engine::Result;

use crate::status::{null, store};

/// Texts, and what C sees of them.
#[derive(Debug, Default)]
pub(crate) struct Texts {
    pointers: Vec<*const c_char>,
    /// What the pointers lead to: the heap, which does not move with this.
    _texts: Vec<CString>,
}

// SAFETY: the texts belong to this object and are never written.
unsafe impl Send for Texts {}
// SAFETY: as above.
unsafe impl Sync for Texts {}

impl Texts {
    /// An interior NUL would end a text for C.
    pub(crate) fn new<T: Into<Vec<u8>>>(texts: impl IntoIterator<Item = T>) -> Self {
        let without_nul = |text: T| {
            let bytes = text.into().into_iter().map(|b| if b == 0 { b'?' } else { b }).collect::<Vec<u8>>();
            CString::new(bytes).unwrap_or_default()
        };
        let texts: Vec<CString> = texts.into_iter().map(without_nul).collect();
        Self { pointers: texts.iter().map(|t| t.as_ptr()).collect(), _texts: texts }
    }

    /// # Safety
    /// The pointers are null or valid for writing.
    pub(crate) unsafe fn give(&self, texts: *mut *const *const c_char, count: *mut u32, what: &str) -> Result<()> {
        if texts.is_null() || count.is_null() {
            return Err(null(what));
        }
        // SAFETY: promised by the caller.
        unsafe {
            store(texts, self.pointers.as_ptr());
            store(count, self.pointers.len() as u32);
        }
        Ok(())
    }
}
