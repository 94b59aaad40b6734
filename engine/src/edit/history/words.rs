//! Words that are kept.

use std::ops::{Deref, DerefMut};

use memmap2::MmapMut;

/// From so many bytes on, words have pages of their own.
const MANY: usize = 1 << 22;

/// 32-bit words. Many lie in large pages, where the system has these: to get a hundred megabytes of small ones takes longer than
/// to fill them.
#[derive(Debug)]
pub(super) enum Words {
    Few(Vec<u32>),
    Many(MmapMut),
}

impl Words {
    /// So many zeros.
    pub(super) fn zeros(count: usize) -> Self {
        let bytes = count * size_of::<u32>();
        let mapped = if bytes < MANY { None } else { MmapMut::map_anon(bytes).ok() };
        let Some(mapped) = mapped else { return Self::Few(vec![0; count]) };
        #[cfg(target_os = "linux")]
        if let Err(error) = mapped.advise(memmap2::Advice::HugePage) {
            log::debug!("no large pages: {error}");
        }
        Self::Many(mapped)
    }
}

impl Default for Words {
    fn default() -> Self {
        Self::Few(Vec::new())
    }
}

impl From<Vec<u32>> for Words {
    fn from(words: Vec<u32>) -> Self {
        Self::Few(words)
    }
}

impl Deref for Words {
    type Target = [u32];

    fn deref(&self) -> &[u32] {
        match self {
            Self::Few(words) => words,
            Self::Many(bytes) => bytemuck::cast_slice(bytes),
        }
    }
}

impl DerefMut for Words {
    fn deref_mut(&mut self) -> &mut [u32] {
        match self {
            Self::Few(words) => words,
            Self::Many(bytes) => bytemuck::cast_slice_mut(bytes),
        }
    }
}
