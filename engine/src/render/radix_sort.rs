//! Stable radix sort of u32 keys with optional u32 values, least significant digit first.
//!
//! Reduce-then-scan without a scan dispatch: each pass has one histogram row (256 counts) per partition of 4,096 keys;
//! `sort_scatter` sums the rows of the earlier partitions itself and, while it scatters, counts the digits of the next
//! pass. Past [`SPINE_PARTITIONS`] partitions `sort_spine` scans the rows first. No workgroup waits for another, and
//! the result does not depend on the subgroup size.

use super::limits::*;
use super::twin;
use crate::error::{Error, Result};
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};

/// Above this many partitions `sort_spine` scans the histogram before each `sort_scatter`.
pub const SPINE_PARTITIONS: u32 = 128;
/// `totals_row` of a histogram that `sort_spine` has not scanned.
pub const NOT_PRESCANNED: u32 = u32::MAX;
/// Workgroups of `sort_spine`: 8 digits each.
pub const SPINE_GROUPS: u32 = 32;

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

crate::gpu_struct! {
    /// Push constants of `sort_histogram`.
    pub struct SortHistogramPush {
        /// First bit of the digit.
        pub shift: u32,
        /// Its width, 1..=8.
        pub digit_bits: u32,
        /// `counters[count_word]` is the number of keys.
        pub count_word: u32,
    }
}

crate::gpu_struct! {
    /// Push constants of `sort_spine`.
    pub struct SortSpinePush {
        /// `counters[count_word]` is the number of keys.
        pub count_word: u32,
        /// Row that receives the digit totals; past the last partition's.
        pub totals_row: u32,
    }
}

/// One pass. Dispatch ceil(keys / 4096) workgroups; `next_histogram` must be zero.
pub static SORT_SCATTER: Kernel = Kernel {
    name: "sort_scatter",
    doc: "one stable pass of the radix sort: ranks 4,096 keys by one digit, moves them, counts the next digit",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "HAS_VALUES", "HAS_NEXT", "RANK_BY_BALLOT"],
    push: SortScatterPush::FIELDS,
    bindings: &[
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("histogram", Access::Read, Element::U32),
        Binding::new("keys_in", Access::Read, Element::U32),
        Binding::new("values_in", Access::Read, Element::U32),
        Binding::new("keys_out", Access::Write, Element::U32),
        Binding::new("values_out", Access::Write, Element::U32),
        Binding::new("next_histogram", Access::Atomic, Element::U32),
    ],
    twin: sort_scatter_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 16 * w.get("keys"),
    spirv: include_bytes!("../../../spirv_cache/sort_scatter.spv"),
};

/// Digit counts of keys nobody counted while writing them. Dispatch ceil(keys / 4096) workgroups.
pub static SORT_HISTOGRAM: Kernel = Kernel {
    name: "sort_histogram",
    doc: "counts one digit for each partition of 4,096 keys",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: SortHistogramPush::FIELDS,
    bindings: &[
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("keys", Access::Read, Element::U32),
        Binding::new("histogram", Access::Write, Element::U32),
    ],
    twin: sort_histogram_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| 4 * w.get("keys"),
    spirv: include_bytes!("../../../spirv_cache/sort_histogram.spv"),
};

/// Scan over partitions, in place. Dispatch [`SPINE_GROUPS`] workgroups.
pub static SORT_SPINE: Kernel = Kernel {
    name: "sort_spine",
    doc: "turns histogram rows into exclusive prefixes over partitions, in place, and writes the digit totals",
    local_size: 256,
    spec: &["SUBGROUP_SIZE"],
    push: SortSpinePush::FIELDS,
    bindings: &[
        Binding::new("counters", Access::Read, Element::U32),
        Binding::new("histogram", Access::Update, Element::U32),
    ],
    twin: sort_spine_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| w.get("keys") / 4,
    spirv: include_bytes!("../../../spirv_cache/sort_spine.spv"),
};

const DIGITS: usize = SORT_DIGITS as usize;

fn sort_scatter_twin(call: &mut TwinCall<'_>) {
    let push: SortScatterPush = twin::push(call);
    let groups = twin::group_count(call);
    let [has_values, has_next] = [1, 2].map(|id| twin::spec(call, id) != 0);
    let totals_row = (push.totals_row != NOT_PRESCANNED).then_some(push.totals_row);
    let [counters, histogram, keys_in, values_in, keys_out, values_out, next_histogram] = call.buffers else { return };
    let count = counters[push.count_word as usize];
    let partitions = count.div_ceil(SORT_PARTITION);
    let mask = (1u32 << push.digit_bits) - 1;
    let next_mask = (1u32 << push.next_digit_bits) - 1;
    for group in 0..groups.min(partitions) {
        let mut place = digit_base(histogram, group, partitions, totals_row);
        for i in group * SORT_PARTITION..count.min((group + 1) * SORT_PARTITION) {
            let key = keys_in[i as usize];
            let digit = (key >> push.shift & mask) as usize;
            let to = place[digit];
            place[digit] += 1;
            if to >= count {
                continue;
            }
            keys_out[to as usize] = key;
            if has_values {
                values_out[to as usize] = values_in[i as usize];
            }
            if has_next {
                let next = key >> push.next_shift & next_mask;
                next_histogram[(to / SORT_PARTITION * SORT_DIGITS + next) as usize] += 1;
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

fn sort_histogram_twin(call: &mut TwinCall<'_>) {
    let push: SortHistogramPush = twin::push(call);
    let groups = twin::group_count(call);
    let [counters, keys, histogram] = call.buffers else { return };
    let count = counters[push.count_word as usize];
    let mask = (1u32 << push.digit_bits) - 1;
    for group in 0..groups.min(count.div_ceil(SORT_PARTITION)) {
        let row = &mut histogram[group as usize * DIGITS..][..DIGITS];
        row.fill(0);
        for i in group * SORT_PARTITION..count.min((group + 1) * SORT_PARTITION) {
            row[(keys[i as usize] >> push.shift & mask) as usize] += 1;
        }
    }
}

fn sort_spine_twin(call: &mut TwinCall<'_>) {
    let push: SortSpinePush = twin::push(call);
    let digits = (twin::group_count(call) * 8).min(SORT_DIGITS) as usize;
    let [counters, histogram] = call.buffers else { return };
    let partitions = counters[push.count_word as usize].div_ceil(SORT_PARTITION) as usize;
    for d in 0..digits {
        let mut before = 0;
        for p in 0..partitions {
            before += std::mem::replace(&mut histogram[p * DIGITS + d], before);
        }
        histogram[push.totals_row as usize * DIGITS + d] = before;
    }
}

/// Whether keys are ranked within a subgroup by a ballot per digit bit, which works at every size, or by comparing with
/// each lane, which works up to 16 lanes and is faster on a CPU device, where a ballot is a loop over lanes.
pub fn rank_by_ballot(subgroup_size: u32) -> bool {
    subgroup_size > 16
}

/// One digit of a [`SortPlan`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Digit {
    /// First bit.
    pub shift: u32,
    /// Width, 1..=8.
    pub bits: u32,
}

/// How to sort up to `capacity` keys of `key_bits` bits: digits, buffer sizes, and whether the spine runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SortPlan {
    /// Most keys.
    pub capacity: u32,
    /// One digit per pass, least significant first.
    pub digits: Vec<Digit>,
    /// Partitions of `capacity` keys.
    pub partitions: u32,
    /// `sort_spine` runs before each `sort_scatter`.
    pub prescanned: bool,
}

impl SortPlan {
    /// The fewest passes of at most 8 bits, as even as possible (wider first).
    ///
    /// # Errors
    /// `Usage` when `key_bits` is not 1..=32, `Limit` past 2^31 keys.
    pub fn new(capacity: u32, key_bits: u32) -> Result<Self> {
        if !(1..=32).contains(&key_bits) {
            return Err(Error::usage("key bits of a sort", key_bits.to_string(), "1..=32"));
        }
        if capacity > 1 << 31 {
            return Err(Error::Limit { what: "keys of a sort".into(), need: capacity.into(), have: 1 << 31 });
        }
        let passes = key_bits.div_ceil(8);
        let mut shift = 0;
        let digits = (0..passes)
            .map(|pass| {
                let bits = key_bits / passes + u32::from(pass < key_bits % passes);
                shift += bits;
                Digit { shift: shift - bits, bits }
            })
            .collect();
        let partitions = capacity.div_ceil(SORT_PARTITION).max(1);
        Ok(Self { capacity, digits, partitions, prescanned: partitions > SPINE_PARTITIONS })
    }

    /// Rows of one pass's histogram: a row per partition and, for the spine, one of totals.
    pub fn histogram_rows(&self) -> u32 {
        self.partitions + u32::from(self.prescanned)
    }

    /// Bytes of one pass's histogram.
    pub fn histogram_bytes(&self) -> u64 {
        u64::from(self.histogram_rows()) * u64::from(SORT_DIGITS) * 4
    }

    /// Which of the two key buffers (0 = a, 1 = b) holds the sorted keys when the input is in a.
    pub fn result_in(&self) -> usize {
        self.digits.len() % 2
    }

    /// Specialisation constants of pass `pass` of `sort_scatter`, after SUBGROUP_SIZE. `by_ballot`: see [`rank_by_ballot`].
    pub fn scatter_spec(&self, pass: usize, has_values: bool, by_ballot: bool) -> [u32; 3] {
        [has_values.into(), (pass + 1 < self.digits.len()).into(), by_ballot.into()]
    }

    /// Push constants of pass `pass` of `sort_scatter`.
    pub fn scatter_push(&self, pass: usize, count_word: u32) -> SortScatterPush {
        let digit = self.digits[pass];
        let next = self.digits.get(pass + 1).copied().unwrap_or(digit);
        SortScatterPush {
            shift: digit.shift,
            digit_bits: digit.bits,
            count_word,
            next_shift: next.shift,
            next_digit_bits: next.bits,
            totals_row: if self.prescanned { self.partitions } else { NOT_PRESCANNED },
        }
    }

    /// Push constants of `sort_histogram` for the first pass.
    pub fn histogram_push(&self, count_word: u32) -> SortHistogramPush {
        SortHistogramPush { shift: self.digits[0].shift, digit_bits: self.digits[0].bits, count_word }
    }

    /// Push constants of `sort_spine`.
    pub fn spine_push(&self, count_word: u32) -> SortSpinePush {
        SortSpinePush { count_word, totals_row: self.partitions }
    }
}
