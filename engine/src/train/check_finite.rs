//! Kernel `check_finite`: whether arrays on the device are finite.

use crate::error::{Error, Result};
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Kernel, Tolerance};
use crate::gpu::{Gpu, Groups, Memory, SLICE_ALIGNMENT, Slice};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&CHECK_FINITE.kernel];

/// Floats per workgroup of `check_finite`.
pub const CHECK_FINITE_FLOATS: u32 = 1024;

crate::gpu_struct! {
    /// Push constants of `check_finite`.
    pub struct CheckFinitePush {
        /// Floats to look at.
        pub count: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`CHECK_FINITE`].
    pub struct CheckFiniteBuffers {
        /// Bits of `count` floats.
        values: Read U32,
        /// How many are not finite, and the first; (0, 0xffffffff) before.
        found: Atomic U32,
    }
}

crate::kernel! {
    /// Dispatch ceil(count / 1024) workgroups.
    pub static CHECK_FINITE: CheckFinite = {
        name: "check_finite",
        doc: "counts the floats that are not finite and finds the first",
        local_size: 256,
        constants: (),
        push: CheckFinitePush,
        buffers: CheckFiniteBuffers,
        twin: check_finite_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 4 * w.get("weights"),
    }
}

fn check_finite_twin(call: Call<'_, CheckFinite>) {
    let Call { push, buffers: b, .. } = call;
    for i in 0..push.count {
        if !f32::from_bits(b.values[i as usize]).is_finite() {
            b.found[0] += 1;
            b.found[1] = b.found[1].min(i);
        }
    }
}

/// Looks for numbers that are not finite in the first `words` floats of each named slice; waits for the device. The first
/// such slice in the list becomes [`Error::NonFinite`] with its first bad index.
pub fn check_finite(gpu: &Gpu, buffers: &[(&str, Slice, u32)]) -> Result<()> {
    if buffers.is_empty() {
        return Ok(());
    }
    let found = gpu.buffer("found", SLICE_ALIGNMENT * buffers.len() as u64, Memory::Device)?;
    let mut r = gpu.recorder("check finite");
    for (i, (_, buffer, words)) in buffers.iter().enumerate().filter(|(_, b)| b.2 > 0) {
        let start = i as u64 * SLICE_ALIGNMENT;
        r.fill(found.slice(start, 4), 0)?;
        r.fill(found.slice(start + 4, 4), u32::MAX)?;
        let values = buffer.buffer.slice(buffer.start, 4 * u64::from(*words));
        let buffers = CheckFiniteBuffers { values, found: found.slice(start, 8) };
        let push = CheckFinitePush { count: *words };
        let groups = Groups::Direct(words.div_ceil(CHECK_FINITE_FLOATS).into());
        r.dispatch(&CHECK_FINITE, (), push, buffers, groups)?;
    }
    if r.is_empty() {
        return Ok(());
    }
    gpu.run(r)?;
    let bytes = gpu.download(Slice::from(&found))?;
    for (place, (name, buffer, _)) in bytes.chunks_exact(SLICE_ALIGNMENT as usize).zip(buffers).filter(|(_, b)| b.2 > 0)
    {
        let [count, index]: [u32; 2] = bytemuck::pod_read_unaligned(&place[..8]);
        if count > 0 {
            // Any start can be copied from, but only aligned ones bound.
            let at = buffer.buffer.slice(buffer.start + 4 * u64::from(index), 4);
            let value: f32 = bytemuck::pod_read_unaligned(&gpu.download(at)?);
            let what = format!("{name} ({count} not finite)");
            return Err(Error::NonFinite { what, index: index as usize, value: value.to_string() });
        }
    }
    Ok(())
}
