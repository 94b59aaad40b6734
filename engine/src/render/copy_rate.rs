//! The rate at which the device copies memory, measured: by its copy command and by a kernel, since either may be far the faster.

use std::time::Duration;

use super::device_time::best_us;
use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::{Buffer, Commands, Gpu, Groups, Memory};

crate::gpu_struct! {
    /// Push constants of `copy_rate`.
    pub struct CopyRatePush {
        /// Vectors of four words to copy.
        pub count: u32,
    }
}

/// Invocations per workgroup of `copy_rate`.
const THREADS: u32 = 256;
/// Vectors that a workgroup of `copy_rate` copies.
pub const COPY_RATE_OF_GROUP: u32 = 4 * THREADS;
/// Bytes of such a vector.
const VECTOR_BYTES: u64 = 16;

crate::gpu_buffers! {
    /// Buffers of [`COPY_RATE`].
    pub struct CopyRateBuffers {
        /// `[count][4]`
        source: Read U32,
        /// `[count][4]`
        destination: Write U32,
    }
}

crate::kernel! {
    /// A plain copy. Dispatch ceil(count / [`COPY_RATE_OF_GROUP`]) workgroups.
    pub static COPY_RATE: CopyRate = {
        name: "copy_rate",
        doc: "copies vectors of four words: measures the rate of the device's memory",
        local_size: THREADS,
        constants: (),
        push: CopyRatePush,
        buffers: CopyRateBuffers,
        twin: copy_rate_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 2 * VECTOR_BYTES * w.get("count"),
    }
}

fn copy_rate_twin(call: Call<'_, CopyRate>) {
    let words = 4 * (call.group_count() * COPY_RATE_OF_GROUP).min(call.push.count) as usize;
    let CopyRateBuffers { source, destination } = call.buffers;
    destination[..words].copy_from_slice(&source[..words]);
}

/// Bytes of each of the two buffers: on a GPU far more than its caches hold.
const GPU_BYTES: u64 = 256 << 20;
/// The same on a CPU device.
const CPU_BYTES: u64 = 128 << 20;
/// Copies of each kind, of which the best counts; as many more as it takes for the clocks to be up.
const RUNS: usize = 8;
const AT_LEAST: Duration = Duration::from_millis(100);

/// Best rate of a copy within the device's memory, bytes read plus bytes written, GB/s.
///
/// # Errors
/// `OutOfMemory`, `DeviceLost`.
pub fn copy_rate(gpu: &Gpu) -> Result<f64> {
    let c = &gpu.info().capabilities;
    let wanted = if gpu.info().is_cpu() { CPU_BYTES } else { GPU_BYTES };
    let bytes = wanted.min(c.max_allocation_bytes).min(c.max_storage_buffer_range) / VECTOR_BYTES * VECTOR_BYTES;
    let source = gpu.buffer("copy source", bytes, Memory::Device)?;
    let destination = gpu.buffer("copy destination", bytes, Memory::Device)?;
    let mut best = f64::INFINITY;
    for by_kernel in [false, true] {
        best = best.min(best_us(gpu, record(gpu, &source, &destination, by_kernel)?, RUNS, AT_LEAST)?);
    }
    Ok(2.0 * bytes as f64 / best / 1e3)
}

/// The copy comes last.
fn record(gpu: &Gpu, source: &Buffer, destination: &Buffer, by_kernel: bool) -> Result<Commands> {
    let mut r = gpu.recorder("copy").with_timestamps(true);
    r.fill(source, 0)?;
    if by_kernel {
        let count = u32::try_from(source.bytes() / VECTOR_BYTES).unwrap_or(u32::MAX);
        let buffers = CopyRateBuffers { source: source.whole(), destination: destination.whole() };
        let groups = Groups::Direct(count.div_ceil(COPY_RATE_OF_GROUP).into());
        r.dispatch(&COPY_RATE, (), CopyRatePush { count }, buffers, groups)?;
    } else {
        r.copy(source, destination)?;
    }
    r.finish()
}
