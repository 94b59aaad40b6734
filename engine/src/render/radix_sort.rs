//! Stable radix sort of u32 keys with optional u32 values, least significant digit first.
//!
//! Reduce-then-scan without a scan dispatch: each pass has one histogram row (256 counts) per partition of 4,096 keys;
//! `sort_scatter` sums the rows of the earlier partitions itself and, while it scatters, counts the digits of the next
//! pass. Past [`SPINE_PARTITIONS`] partitions `sort_spine` scans the rows first. No workgroup waits for another, and
//! the result does not depend on the subgroup size.

mod device_sort;
mod record;

pub use device_sort::DeviceSort;
pub(crate) use record::{SortSlices, record};

use super::limits::{SORT_DIGITS, SORT_PARTITION};
use super::sort_histogram::SortHistogramPush;
use super::sort_scatter::{NOT_PRESCANNED, SortScatterConstants, SortScatterPush};
use super::sort_spine::SortSpinePush;
use crate::error::{Error, Result};

/// Above this many partitions `sort_spine` scans the histogram before each `sort_scatter`.
pub const SPINE_PARTITIONS: u32 = 128;

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

    /// Specialisation constants of pass `pass` of `sort_scatter`. `by_ballot`: see [`rank_by_ballot`].
    pub fn scatter_constants(&self, pass: usize, has_values: bool, by_ballot: bool) -> SortScatterConstants {
        SortScatterConstants {
            has_values: has_values.into(),
            has_next: (pass + 1 < self.digits.len()).into(),
            rank_by_ballot: by_ballot.into(),
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

    /// Push constants of `sort_histogram` for the first pass.
    pub fn histogram_push(&self, count_word: u32) -> SortHistogramPush {
        SortHistogramPush { shift: self.digits[0].shift, digit_bits: self.digits[0].bits, count_word }
    }

    /// Push constants of `sort_spine`.
    pub fn spine_push(&self, count_word: u32) -> SortSpinePush {
        SortSpinePush { count_word, totals_row: self.partitions }
    }
}
