//! What everything else rests on: copies, subgroups, atomics, the radix sort.

use super::subgroup_order;
use crate::error::{Error, Result};
use crate::gpu::kernel::Kernel;
use crate::gpu::proof::{KernelCase, POISON};
use crate::gpu::{Gpu, Memory};
use crate::render::radix_sort::{SortPlan, rank_by_ballot};
use crate::render::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers};
use crate::render::sort_scatter::{SORT_SCATTER, SortScatterBuffers};
use crate::render::sort_spine::{SORT_SPINE, SPINE_GROUPS, SortSpineBuffers};
use crate::scene::synthetic::Random;

/// Keys of the sort: two partitions, the second one hardly begun.
const KEYS: u32 = 4096 + 257;
const KEY_BITS: u32 = 32;
/// Word of the counters that holds the number of keys.
const COUNT_WORD: u32 = 2;
/// Words of the copy.
const COPIED: usize = 64;

/// Tests copies, then the kernel of subgroups and atomics, then every pass of a sort.
pub(super) fn test(gpu: &Gpu) -> Result<()> {
    copy(gpu)?;
    let cases = [vec![subgroup_order::case()], sort_cases(gpu, false)?, sort_cases(gpu, true)?].concat();
    for case in cases {
        if let Some(mismatch) = case.run(gpu)?.mismatch() {
            return Err(mismatch.into_error());
        }
    }
    Ok(())
}

/// A pattern to the device and back.
fn copy(gpu: &Gpu) -> Result<()> {
    let pattern: Vec<u32> = (0..COPIED as u32).map(|i| i.wrapping_mul(2_654_435_761) ^ POISON).collect();
    let bytes: &[u8] = bytemuck::cast_slice(&pattern);
    let [from, device, to] = [Memory::Upload, Memory::Device, Memory::Readback]
        .map(|memory| gpu.buffer("self-test copy", bytes.len() as u64, memory));
    let (from, device, to) = (from?, device?, to?);
    from.write(0, bytes)?;
    to.write_readback(0, &vec![0; bytes.len()])?;
    let mut r = gpu.recorder("self-test copy");
    r.copy(&from, &device)?;
    r.copy(&device, &to)?;
    r.host_read(&to);
    gpu.run(r)?;
    if !gpu.counts_submissions()? {
        return Err(wrong_copy("it computes nothing: a submission that was waited for has not ended"));
    }
    let mut copied = vec![0_u32; COPIED];
    to.read(0, bytemuck::cast_slice_mut(&mut copied))?;
    check_copy(&copied, &pattern)
}

/// A driver that does nothing fails here, before any kernel is blamed.
fn check_copy(found: &[u32], expected: &[u32]) -> Result<()> {
    let wrong = found.iter().zip(expected).filter(|(f, e)| f != e).count();
    let Some(first) = found.iter().zip(expected).position(|(f, e)| f != e) else { return Ok(()) };
    let why = if found.iter().all(|word| *word == 0) {
        "it computes nothing: a copy was never made, and no error was reported".to_owned()
    } else {
        format!(
            "differs in {wrong} of {} words, first [{first}]: found {:#x}, expected {:#x}",
            found.len(),
            found[first],
            expected[first]
        )
    };
    Err(wrong_copy(why))
}

fn wrong_copy(why: impl Into<String>) -> Error {
    Error::Kernel { kernel: "vkCmdCopyBuffer".into(), why: why.into() }
}

/// The passes of a sort of random keys with values, each fed by the twins of those before it, so that they are independent.
fn sort_cases(gpu: &Gpu, prescanned: bool) -> Result<Vec<KernelCase>> {
    let mut random = Random::new(7);
    // Few bits in the middle: many equal digits, whose order must be kept.
    let mut keys: Vec<u32> = (0..KEYS).map(|_| random.bits() as u32 & 0xff03_0fff).collect();
    let mut values: Vec<u32> = (0..KEYS).map(|i| i.wrapping_mul(3) + 1).collect();
    let mut plan = SortPlan::new(KEYS, KEY_BITS)?;
    plan.prescanned = prescanned;
    let rows = plan.histogram_rows() as usize * 256;
    let counters = vec![0, 0, KEYS, 0, 0, 0, 0, 0];
    let mut cases = Vec::new();
    let lanes = |kernel: &Kernel| gpu.subgroup_size_of(kernel);
    let push = plan.histogram_push(0, COUNT_WORD);
    let buffers = SortHistogramBuffers { counters: counters.clone(), keys: keys.clone(), histogram: vec![0; rows] };
    cases.push(KernelCase::new(&SORT_HISTOGRAM, (), push, buffers.clone(), plan.partitions));
    let mut histogram = SORT_HISTOGRAM.run_twin(lanes(&SORT_HISTOGRAM), (), push, buffers, plan.partitions).histogram;
    for pass in 0..plan.digits.len() {
        if prescanned {
            let push = plan.spine_push(COUNT_WORD);
            let buffers = SortSpineBuffers { counters: counters.clone(), histogram };
            cases.push(KernelCase::new(&SORT_SPINE, (), push, buffers.clone(), SPINE_GROUPS));
            histogram = SORT_SPINE.run_twin(lanes(&SORT_SPINE), (), push, buffers, SPINE_GROUPS).histogram;
        }
        let constants = plan.scatter_constants(pass, true, rank_by_ballot(lanes(&SORT_SCATTER)));
        let push = plan.scatter_push(pass, COUNT_WORD);
        let out = vec![0; KEYS as usize];
        let buffers = SortScatterBuffers {
            counters: counters.clone(),
            histogram,
            keys_in: keys,
            values_in: Some(values),
            keys_out: out.clone(),
            values_out: Some(out),
            next_histogram: Some(vec![0; rows]),
        };
        cases.push(KernelCase::new(&SORT_SCATTER, constants, push, buffers.clone(), plan.partitions));
        let after = SORT_SCATTER.run_twin(lanes(&SORT_SCATTER), constants, push, buffers, plan.partitions);
        histogram = after.next_histogram.unwrap_or_default();
        values = after.values_out.unwrap_or_default();
        keys = after.keys_out;
    }
    Ok(cases)
}
