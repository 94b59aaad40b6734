//! Stable radix sort of u32 keys with optional u32 values, least significant digit first.
//!
//! Reduce-then-scan without a scan dispatch: each pass has one histogram row (256 counts) per partition of 4,096 keys, or of
//! fewer in a small sort ([`rounds_of`]); `sort_scatter` sums the rows of the earlier partitions itself and, while it scatters,
//! counts the digits of the next pass. Past [`SPINE_PARTITIONS`] partitions `sort_spine` scans the rows first. No workgroup waits for another, and
//! the result does not depend on the subgroup size.

mod device_sort;
mod record;

pub use device_sort::DeviceSort;
pub(crate) use record::{SortSlices, record};

use super::limits::{SORT_DIGITS, SORT_ROUNDS, SORT_THREADS};
use super::sort_histogram::SortHistogramPush;
use super::sort_scatter::{NOT_PRESCANNED, SortScatterConstants, SortScatterPush};
use super::sort_spine::SortSpinePush;
use crate::error::{Error, Result};
use crate::gpu::Gpu;

/// Above this many partitions `sort_spine` scans the histogram before each `sort_scatter`.
pub const SPINE_PARTITIONS: u32 = 128;

/// Whether keys are ranked within a subgroup by a ballot per digit bit, which works at every size, or by comparing with
/// each lane, which works up to 16 lanes and is faster on a CPU device, where a ballot is a loop over lanes.
pub fn rank_by_ballot(subgroup_size: u32) -> bool {
    subgroup_size > 16
}

/// Fewest keys per thread of a partition.
const FEWEST_ROUNDS: u32 = 4;

/// Keys per thread of `sort_scatter` for sorts of up to `capacity` keys: the smallest partitions that need no spine. A pass takes at
/// least as long as one of its workgroups, and a GPU has a processor for each; a CPU device has few and gains nothing.
pub fn rounds_of(capacity: u32, is_cpu: bool) -> u32 {
    let fits = |rounds: &u32| capacity.div_ceil(rounds * SORT_THREADS) <= SPINE_PARTITIONS;
    let small = (0..).map(|i| FEWEST_ROUNDS << i).take_while(|rounds| !is_cpu && *rounds < SORT_ROUNDS).find(fits);
    small.unwrap_or(SORT_ROUNDS)
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
    /// Keys per thread of a partition.
    pub rounds: u32,
    /// `sort_spine` runs before each `sort_scatter`.
    pub prescanned: bool,
    /// `sort_histogram` counts the digits of every pass, not of the first alone: `sort_scatter` would count those of the next by an
    /// atomic per key.
    pub counted_apart: bool,
    /// `sort_scatter` orders a partition in shared memory and writes it in runs: a GPU's memory takes 32 bytes and more at once.
    pub staged: bool,
}

impl SortPlan {
    /// The fewest passes of at most 8 bits, as even as possible (wider first), in the largest partitions.
    ///
    /// # Errors
    /// `Usage` when `key_bits` is not 1..=32, `Limit` past 2^31 keys.
    pub fn new(capacity: u32, key_bits: u32) -> Result<Self> {
        Self::with_rounds(capacity, key_bits, SORT_ROUNDS)
    }

    /// The same in partitions that suit a device ([`rounds_of`]).
    ///
    /// # Errors
    /// As [`SortPlan::new`].
    pub fn for_device(gpu: &Gpu, capacity: u32, key_bits: u32) -> Result<Self> {
        let is_cpu = gpu.info().is_cpu();
        let plan = Self::with_rounds(capacity, key_bits, rounds_of(capacity, is_cpu))?;
        // Reading the keys once more takes a GPU a tenth of so many atomics.
        let large = plan.prescanned && !is_cpu;
        Ok(Self { counted_apart: large, staged: large, ..plan })
    }

    /// The same with `rounds` keys per thread of a partition: a power of two, at most 16.
    ///
    /// # Errors
    /// As [`SortPlan::new`].
    pub fn with_rounds(capacity: u32, key_bits: u32, rounds: u32) -> Result<Self> {
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
        let partitions = capacity.div_ceil(rounds * SORT_THREADS).max(1);
        let prescanned = partitions > SPINE_PARTITIONS;
        Ok(Self { capacity, digits, partitions, rounds, prescanned, counted_apart: false, staged: false })
    }

    /// log2 of the keys of a partition.
    pub fn partition_shift(&self) -> u32 {
        (self.rounds * SORT_THREADS).ilog2()
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

    /// Specialisation constants of pass `pass` of `sort_scatter`. `by_ballot`: see [`rank_by_ballot`].
    pub fn scatter_constants(&self, pass: usize, has_values: bool, by_ballot: bool) -> SortScatterConstants {
        SortScatterConstants {
            has_values: has_values.into(),
            has_next: (!self.counted_apart && pass + 1 < self.digits.len()).into(),
            rank_by_ballot: by_ballot.into(),
            rounds: self.rounds,
            staged: self.staged.into(),
        }
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

    /// Push constants of `sort_histogram` for pass `pass`.
    pub fn histogram_push(&self, pass: usize, count_word: u32) -> SortHistogramPush {
        let Digit { shift, bits } = self.digits[pass];
        SortHistogramPush { shift, digit_bits: bits, count_word, partition_shift: self.partition_shift() }
    }

    /// Push constants of `sort_spine`.
    pub fn spine_push(&self, count_word: u32) -> SortSpinePush {
        SortSpinePush { count_word, totals_row: self.partitions, partition_shift: self.partition_shift() }
    }
}
