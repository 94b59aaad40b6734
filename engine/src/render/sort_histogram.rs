//! Kernel `sort_histogram`: the first count of the [radix sort](super::radix_sort), of keys that nobody counted while writing
//! them.

use super::limits::SORT_DIGITS;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

crate::gpu_struct! {
    /// Push constants of `sort_histogram`.
    pub struct SortHistogramPush {
        /// First bit of the digit.
        pub shift: u32,
        /// Its width, 1..=8.
        pub digit_bits: u32,
        /// `counters[count_word]` is the number of keys.
        pub count_word: u32,
        /// log2 of the keys of a partition.
        pub partition_shift: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SORT_HISTOGRAM`].
    pub struct SortHistogramBuffers {
        /// The number of keys is word `count_word`.
        counters: Read U32,
        keys: Read U32,
        /// `[partition][256]` digit counts.
        histogram: Write U32,
    }
}

crate::kernel! {
    /// Dispatch a workgroup per partition.
    pub static SORT_HISTOGRAM: SortHistogram = {
        name: "sort_histogram",
        doc: "counts one digit for each partition of keys",
        local_size: 256,
        constants: (),
        push: SortHistogramPush,
        buffers: SortHistogramBuffers,
        twin: sort_histogram_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 4 * w.get("keys"),
    }
}

fn sort_histogram_twin(call: Call<'_, SortHistogram>) {
    let groups = call.group_count();
    let Call { push, buffers: b, .. } = call;
    let count = b.counters[push.count_word as usize];
    let mask = (1u32 << push.digit_bits) - 1;
    let partition = 1 << push.partition_shift;
    for group in 0..groups.min(count.div_ceil(partition)) {
        let row = &mut b.histogram[(group * SORT_DIGITS) as usize..][..SORT_DIGITS as usize];
        row.fill(0);
        for i in group * partition..count.min((group + 1) * partition) {
            row[(b.keys[i as usize] >> push.shift & mask) as usize] += 1;
        }
    }
}
