//! How much device memory the engine may take: at most 80 % of the largest device-local heap, and no more than the driver
//! says is free (`VK_EXT_memory_budget`), which other programs take from as well.

use ash::vk;
use serde::Serialize;

/// The largest device-local heap.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Heap {
    /// Its size, bytes.
    pub bytes: u64,
    /// What this process could still take from it without failing or slowing others down, bytes; `None`: the driver does
    /// not tell.
    pub free: Option<u64>,
}

impl Heap {
    /// Asks the device; `tells`: it has `VK_EXT_memory_budget`.
    pub(super) fn query(instance: &ash::Instance, physical: vk::PhysicalDevice, tells: bool) -> Self {
        let mut budget = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
        let mut properties = vk::PhysicalDeviceMemoryProperties2::default();
        if tells {
            properties = properties.push_next(&mut budget);
        }
        // SAFETY: plain query; the device has the extension whose structure is chained.
        unsafe { instance.get_physical_device_memory_properties2(physical, &mut properties) };
        let memory = properties.memory_properties;
        let heaps = memory.memory_heaps.iter().take(memory.memory_heap_count as usize).enumerate();
        let local = heaps.filter(|(_, h)| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
        // The first of equals.
        let Some((index, heap)) = local.rev().max_by_key(|(_, h)| h.size) else { return Self::default() };
        let free = budget.heap_budget[index].saturating_sub(budget.heap_usage[index]);
        Self { bytes: heap.size, free: tells.then_some(free) }
    }

    /// Bytes that the engine may hold when it holds `used` already.
    pub fn budget(&self, used: u64) -> u64 {
        let share = self.bytes / 5 * 4;
        self.free.map_or(share, |free| share.min(used.saturating_add(free)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIB: u64 = 1 << 30;

    #[test]
    fn the_smaller_of_the_share_and_what_is_free() {
        let heap = |free| Heap { bytes: 10 * GIB, free };
        assert_eq!(heap(None).budget(3 * GIB), 8 * GIB);
        assert_eq!(heap(Some(10 * GIB)).budget(0), 8 * GIB);
        assert_eq!(heap(Some(2 * GIB)).budget(0), 2 * GIB);
        // What the engine holds already counts as its own.
        assert_eq!(heap(Some(2 * GIB)).budget(3 * GIB), 5 * GIB);
        assert_eq!(heap(Some(6 * GIB)).budget(3 * GIB), 8 * GIB);
        // Others took what was free: what the engine has it keeps, no more.
        assert_eq!(heap(Some(0)).budget(3 * GIB), 3 * GIB);
        assert_eq!(heap(Some(u64::MAX)).budget(u64::MAX), 8 * GIB);
        assert_eq!(Heap::default().budget(0), 0);
    }
}
