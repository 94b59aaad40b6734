//! Byte accounting: what is allocated, and what may be.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::budget::Heap;
use super::device::Gpu;
use crate::error::{Error, Result};

/// Byte accounting of all allocations of a device.
#[derive(Debug, Default)]
pub(super) struct MemoryBudget {
    pub(super) budget: AtomicU64,
    /// The budget follows what the device says is free; else somebody has set it.
    pub(super) follows: AtomicBool,
    pub(super) used: AtomicU64,
    pub(super) objects: AtomicU64,
    /// Test seam: the n-th allocation from now fails (0 = never).
    pub(super) fail_at: AtomicU64,
    /// Test seam: the host writes no memory of the device.
    pub(super) apart: AtomicBool,
}

impl MemoryBudget {
    /// Counts these bytes as used, when they fit.
    pub(super) fn take(&self, bytes: u64) -> bool {
        let budget = self.budget.load(Ordering::SeqCst);
        let fits = |used: u64| used.checked_add(bytes).filter(|total| *total <= budget);
        self.used.fetch_update(Ordering::SeqCst, Ordering::SeqCst, fits).is_ok()
    }

    pub(super) fn out_of_memory(&self, name: &str, need: u64) -> Error {
        let budget = self.budget.load(Ordering::SeqCst);
        let free = budget.saturating_sub(self.used.load(Ordering::SeqCst));
        Error::OutOfMemory { name: name.into(), need, free, budget }
    }
}

impl Gpu {
    /// Counts these bytes as used, or says what is free.
    pub(super) fn charge(&self, name: &str, bytes: u64) -> Result<()> {
        let account = &self.0.memory;
        let injected = account.fail_at.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1)) == Ok(1);
        // Others may have let go of memory since the device was asked last.
        if !injected && (account.take(bytes) || self.ask_budget() && account.take(bytes)) {
            return Ok(());
        }
        Err(account.out_of_memory(name, bytes))
    }

    /// Sets the budget to what the device says now; whether it tells.
    pub(super) fn ask_budget(&self) -> bool {
        let (shared, account) = (&self.0, &self.0.memory);
        let tells = shared.info.capabilities.device_heap.free.is_some() && account.follows.load(Ordering::SeqCst);
        if tells {
            let heap = Heap::query(&shared.instance, shared.physical, true);
            account.budget.store(heap.budget(account.used.load(Ordering::SeqCst)), Ordering::SeqCst);
        }
        tells
    }

    /// Bytes allocated now, and the budget.
    pub fn memory_used(&self) -> (u64, u64) {
        (self.0.memory.used.load(Ordering::SeqCst), self.0.memory.budget.load(Ordering::SeqCst))
    }

    /// Number of live buffers.
    pub fn buffer_count(&self) -> u64 {
        self.0.memory.objects.load(Ordering::SeqCst)
    }

    /// Changes the byte budget; what is allocated already stays.
    pub fn set_byte_budget(&self, bytes: u64) {
        self.0.memory.follows.store(false, Ordering::SeqCst);
        self.0.memory.budget.store(bytes, Ordering::SeqCst);
    }

    /// Test seam: from now on constants are made as on a device whose memory the host cannot write.
    pub fn inject_memory_apart(&self, apart: bool) {
        self.0.memory.apart.store(apart, Ordering::SeqCst);
    }

    /// Test seam: the n-th allocation from now fails with [`Error::OutOfMemory`] (0 = never).
    pub fn inject_allocation_failure(&self, allocation: u64) {
        self.0.memory.fail_at.store(allocation, Ordering::SeqCst);
    }
}
