//! Times of operations, from the timestamps of a queue.

/// Device time of one operation.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Timing {
    /// Label of the operation.
    pub label: String,
    /// Microseconds.
    pub us: f64,
}

/// Ticks from `from` to `to`, of which only the lowest `valid_bits` count: the rest may hold anything, and the counter begins
/// anew behind them. Exact when less than one turn of the counter lies between (36 bits at 1 ns: 68 s).
pub(super) fn ticks_between(from: u64, to: u64, valid_bits: u32) -> u64 {
    let mask = 1_u64.checked_shl(valid_bits).map_or(u64::MAX, |bit| bit - 1);
    to.wrapping_sub(from) & mask
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_valid_bits_count_and_the_counter_may_begin_anew() {
        for bits in [32, 36, 48, 63, 64] {
            let turn = 1_u128 << bits;
            let noise = if bits < 64 { 0xdead_beef_0bad_cafe_u64 << bits } else { 0 };
            for (from, ticks) in
                [(0, 0), (5, 7), ((turn - 1) as u64, 1), ((turn - 10) as u64, 1000), (3, (turn - 4) as u64)]
            {
                let to = ((u128::from(from) + u128::from(ticks)) % turn) as u64;
                assert_eq!(ticks_between(from, to, bits), ticks, "{bits} bits, from {from}");
                assert_eq!(ticks_between(from | noise, to, bits), ticks, "{bits} bits, noise above the first");
                assert_eq!(ticks_between(from, to | noise, bits), ticks, "{bits} bits, noise above the second");
            }
        }
    }
}
