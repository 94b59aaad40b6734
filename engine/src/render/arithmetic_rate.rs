//! The device's f32 rate, measured: the other half of a roofline beside the copy bandwidth.

use std::time::Duration;

use super::device_time::best_us;
use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Gpu, Groups, Memory};

crate::gpu_struct! {
    /// Push constants of `arithmetic_rate`.
    pub struct ArithmeticRatePush {
        /// Invocations that write their sum.
        pub count: u32,
        /// Rounds of 16 multiply-adds each, at most 4096.
        pub rounds: u32,
    }
}

/// Invocations per workgroup of `arithmetic_rate`.
pub const ARITHMETIC_RATE_THREADS: u32 = 256;
/// Most rounds of `arithmetic_rate`.
const MAX_ROUNDS: u32 = 4096;
/// Floating-point operations of a round: 16 multiplications and 16 additions.
const ROUND_FLOPS: f64 = 32.0;

crate::gpu_buffers! {
    /// Buffers of [`ARITHMETIC_RATE`].
    pub struct ArithmeticRateBuffers {
        /// `[count]`
        sums: Write F32,
    }
}

crate::kernel! {
    /// Four chains of vectors through multiply-adds. Dispatch ceil(count / 256) workgroups.
    pub static ARITHMETIC_RATE: ArithmeticRate = {
        name: "arithmetic_rate",
        doc: "multiply-adds in registers: measures the device's f32 rate for the roofline",
        local_size: ARITHMETIC_RATE_THREADS,
        constants: (),
        push: ArithmeticRatePush,
        buffers: ArithmeticRateBuffers,
        twin: arithmetic_rate_twin,
        tolerance: Tolerance { absolute: 0.0, relative: 1e-5, flips: 0.0 },
        bytes: |w| 4 * w.get("invocations"),
    }
}

fn arithmetic_rate_twin(call: Call<'_, ArithmeticRate>) {
    let invocations = (call.group_count() * ARITHMETIC_RATE_THREADS).min(call.push.count);
    let Call { push, buffers: ArithmeticRateBuffers { sums }, .. } = call;
    for i in 0..invocations {
        let component = |part: f32| {
            let seed = (i & 255) as f32 / 256.0 + part;
            let chain = |offset: f32, factor: f32, term: f32| {
                (0..push.rounds.min(MAX_ROUNDS)).fold(seed + offset, |a, _| a * factor + term)
            };
            let [a, b] = [(0.0, 0.25), (1.0, 0.5)].map(|(offset, term)| chain(offset, 0.968_75, term));
            let [c, d] = [(2.0, 0.25), (3.0, 0.5)].map(|(offset, term)| chain(offset, 0.937_5, term));
            (a + b) + (c + d)
        };
        let [x, y, z, w] = [0.0, 0.125, 0.25, 0.375].map(component);
        sums[i as usize] = ((x + y) + (z + w)).to_bits();
    }
}

/// A dispatch of this length is long enough to be timed, microseconds.
const LONG_ENOUGH_US: f64 = 10_000.0;
/// Workgroups of the first try and of the last.
const GROUPS: std::ops::RangeInclusive<u32> = 64..=1 << 18;
/// Runs of each size, of which the best counts.
const RUNS: usize = 3;

/// Best rate of f32 multiply-adds, GFLOP/s (a multiply-add is two).
///
/// # Errors
/// `OutOfMemory`, `DeviceLost`.
pub fn arithmetic_rate(gpu: &Gpu) -> Result<f64> {
    let (mut groups, mut best) = (*GROUPS.start(), 0.0_f64);
    loop {
        let us = timed(gpu, groups)?;
        let invocations = f64::from(groups) * f64::from(ARITHMETIC_RATE_THREADS);
        best = best.max(invocations * f64::from(MAX_ROUNDS) * ROUND_FLOPS / us.max(1e-3) / 1e3);
        if us > LONG_ENOUGH_US || groups >= *GROUPS.end() {
            return Ok(best);
        }
        groups *= 4;
    }
}

/// Device time of a dispatch, or the host's where there are no timestamps, microseconds.
fn timed(gpu: &Gpu, groups: u32) -> Result<f64> {
    let count = groups * ARITHMETIC_RATE_THREADS;
    let sums = gpu.buffer("sums", 4 * u64::from(count), Memory::Device)?;
    let push = ArithmeticRatePush { count, rounds: MAX_ROUNDS };
    let mut r = gpu.recorder("arithmetic rate").with_timestamps(true);
    let groups = Groups::Direct(groups.into());
    r.dispatch(&ARITHMETIC_RATE, (), push, ArithmeticRateBuffers { sums: sums.whole() }, groups)?;
    best_us(gpu, r.finish()?, RUNS, Duration::ZERO)
}
