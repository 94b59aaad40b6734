//! Kernel `sort_spine`: scans the histogram of a [radix sort](super::radix_sort) with many partitions.

use super::limits::SORT_DIGITS;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

/// Workgroups of `sort_spine`: 8 digits each.
pub const SPINE_GROUPS: u32 = 32;

crate::gpu_struct! {
    /// Push constants of `sort_spine`.
    pub struct SortSpinePush {
        /// `counters[count_word]` is the number of keys.
        pub count_word: u32,
        /// Row that receives the digit totals; past the last partition's.
        pub totals_row: u32,
        /// log2 of the keys of a partition.
        pub partition_shift: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SORT_SPINE`].
    pub struct SortSpineBuffers {
        /// The number of keys is word `count_word`.
        counters: Read U32,
        /// `[partition][256]` digit counts, then exclusive prefixes over partitions; one more row of totals.
        histogram: Update U32,
    }
}

crate::kernel! {
    /// Scan over partitions, in place. Dispatch [`SPINE_GROUPS`] workgroups.
    pub static SORT_SPINE: SortSpine = {
        name: "sort_spine",
        doc: "turns histogram rows into exclusive prefixes over partitions, in place, and writes the digit totals",
        local_size: 256,
        constants: (),
        push: SortSpinePush,
        buffers: SortSpineBuffers,
        twin: sort_spine_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| w.get("keys") / 4,
    }
}

fn sort_spine_twin(call: Call<'_, SortSpine>) {
    let digits = (call.group_count() * 8).min(SORT_DIGITS) as usize;
    let Call { push, buffers: b, .. } = call;
    let row = SORT_DIGITS as usize;
    let partitions = b.counters[push.count_word as usize].div_ceil(1 << push.partition_shift) as usize;
    for d in 0..digits {
        let mut before = 0;
        for p in 0..partitions {
            before += std::mem::replace(&mut b.histogram[p * row + d], before);
        }
        b.histogram[push.totals_row as usize * row + d] = before;
    }
}
