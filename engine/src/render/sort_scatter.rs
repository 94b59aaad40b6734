//! Kernel `sort_scatter`: one pass of the [radix sort](super::radix_sort).

use super::limits::{SORT_DIGITS, SORT_THREADS};
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;

/// `totals_row` of a histogram that `sort_spine` has not scanned.
pub const NOT_PRESCANNED: u32 = u32::MAX;

crate::gpu_struct! {
    /// Push constants of `sort_scatter`.
    pub struct SortScatterPush {
        /// First bit of this pass's digit.
        pub shift: u32,
        /// Its width, 1..=8.
        pub digit_bits: u32,
        /// `counters[count_word]` is the number of keys.
        pub count_word: u32,
        /// First bit of the next pass's digit.
        pub next_shift: u32,
        /// Its width.
        pub next_digit_bits: u32,
        /// Row of the digit totals in a histogram that `sort_spine` has scanned, else [`NOT_PRESCANNED`].
        pub totals_row: u32,
    }
}

crate::gpu_constants! {
    /// Specialisation constants of [`SORT_SCATTER`].
    pub struct SortScatterConstants {
        /// 1: values move with the keys.
        has_values,
        /// 1: the digits of the next pass are counted.
        has_next,
        /// 1: ranks within a subgroup by ballots, else by comparing with each lane ([`super::radix_sort::rank_by_ballot`]).
        rank_by_ballot,
        /// Keys per thread of a partition: a power of two, at most [`SORT_ROUNDS`](super::limits::SORT_ROUNDS).
        rounds,
        /// 1: a partition is put in order in shared memory first, so that it is written in runs.
        staged,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SORT_SCATTER`].
    pub struct SortScatterBuffers {
        /// The number of keys is word `count_word`.
        counters: Read U32,
        /// `[partition][256]` digit counts, or what `sort_spine` made of them.
        histogram: Read U32,
        keys_in: Read U32,
        values_in: optional Read U32,
        keys_out: Write U32,
        values_out: optional Write U32,
        /// `[partition][256]` of the next pass; must be zero.
        next_histogram: optional Atomic U32,
    }
}

crate::kernel! {
    /// One pass. Dispatch a workgroup per partition.
    pub static SORT_SCATTER: SortScatter = {
        name: "sort_scatter",
        doc: "one stable pass of the radix sort: ranks a partition's keys by one digit, moves them, counts the next digit",
        local_size: 256,
        constants: SortScatterConstants,
        push: SortScatterPush,
        buffers: SortScatterBuffers,
        twin: sort_scatter_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 16 * w.get("keys"),
    }
}

const DIGITS: usize = SORT_DIGITS as usize;

fn sort_scatter_twin(call: Call<'_, SortScatter>) {
    let groups = call.group_count();
    let Call { constants, push, buffers: mut b, .. } = call;
    let totals_row = (push.totals_row != NOT_PRESCANNED).then_some(push.totals_row);
    let count = b.counters[push.count_word as usize];
    let partition = constants.rounds * SORT_THREADS;
    let partitions = count.div_ceil(partition);
    let mask = (1u32 << push.digit_bits) - 1;
    let next_mask = (1u32 << push.next_digit_bits) - 1;
    for group in 0..groups.min(partitions) {
        let mut place = digit_base(b.histogram, group, partitions, totals_row);
        for i in group * partition..count.min((group + 1) * partition) {
            let key = b.keys_in[i as usize];
            let digit = (key >> push.shift & mask) as usize;
            let to = place[digit];
            place[digit] += 1;
            if to >= count {
                continue;
            }
            b.keys_out[to as usize] = key;
            if let (Some(values_in), Some(values_out)) = (&b.values_in, b.values_out.as_mut()) {
                values_out[to as usize] = values_in[i as usize];
            }
            if let Some(next_histogram) = b.next_histogram.as_mut().filter(|_| constants.has_next != 0) {
                let next = key >> push.next_shift & next_mask;
                next_histogram[(to / partition * SORT_DIGITS + next) as usize] += 1;
            }
        }
    }
}

/// First output position of each digit in one partition.
fn digit_base(histogram: &[u32], group: u32, partitions: u32, totals_row: Option<u32>) -> [u32; DIGITS] {
    let at = |row: u32, d: usize| histogram[row as usize * DIGITS + d];
    let mut smaller = 0;
    std::array::from_fn(|d| {
        let (before, all) = match totals_row {
            Some(row) => (at(group, d), at(row, d)),
            None => ((0..group).map(|p| at(p, d)).sum(), (0..partitions).map(|p| at(p, d)).sum::<u32>()),
        };
        let base = smaller + before;
        smaller += all;
        base
    })
}
