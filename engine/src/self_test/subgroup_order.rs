//! Kernel `subgroup_order`: what the other kernels take for granted of a device.

use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::gpu::proof::KernelCase;

/// Threads of a workgroup.
const THREADS: u32 = 256;
/// Values of each invocation in `probe`.
const PLANES: usize = 10;
/// Words of `tally`: sum, maximum, bits, bins.
const TALLY_WORDS: usize = 3 + TALLY_BINS;
const TALLY_BINS: usize = 32;
/// Workgroups of the test: enough of them to contend for the same words.
const GROUPS: u32 = 24;

crate::gpu_struct! {
    /// Push constants of `subgroup_order`.
    pub struct SubgroupOrderPush {
        /// A multiple of 256; the length of one plane of `probe`.
        pub invocations: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SUBGROUP_ORDER`].
    pub struct SubgroupOrderBuffers {
        /// `[10][invocations]`
        probe: Write U32,
        /// `[35]`: sum, maximum, bits, 32 bins.
        tally: Atomic U32,
    }
}

crate::kernel! {
    /// Size and order of subgroups, their operations, a scan over the workgroup, atomics of many workgroups on the same words.
    /// Dispatch invocations / 256 workgroups.
    pub static SUBGROUP_ORDER: SubgroupOrder = {
        name: "subgroup_order",
        doc: "self-test: order and size of subgroups, their operations, atomics of many workgroups on the same words",
        local_size: THREADS,
        constants: (),
        push: SubgroupOrderPush,
        buffers: SubgroupOrderBuffers,
        twin: subgroup_order_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| w.get("invocations") * 4 * PLANES as u64,
    }
}

/// Value of an invocation: 12 bits.
fn value(i: usize) -> u32 {
    (i as u32).wrapping_mul(2_654_435_761) >> 20
}

fn subgroup_order_twin(call: Call<'_, SubgroupOrder>) {
    let size = call.subgroup_size as usize;
    let (n, threads) = (call.push.invocations as usize, THREADS as usize);
    let SubgroupOrderBuffers { probe, tally } = call.buffers;
    for i in 0..n {
        let (group, subgroup, lane) = (i / threads * threads, i / size * size, i % size);
        let lanes: Vec<u32> = (subgroup..subgroup + size).map(value).collect();
        let odd = |lanes: &[u32]| lanes.iter().filter(|v| *v & 1 != 0).count() as u32;
        let bounds = lanes.iter().fold([0, u32::MAX], |b, v| [b[0].max(*v), b[1].min(*v)]);
        let any = lanes.iter().any(|v| v & 63 == 0);
        let all = lanes.iter().all(|v| v & 63 != 63);
        let planes: [u32; PLANES] = [
            size as u32,
            (i % threads) as u32,
            (group..i).map(value).sum(),
            (group..group + threads).map(value).sum(),
            lanes[..=lane].iter().sum(),
            lanes.iter().sum(),
            bounds[0] << 16 | bounds[1],
            odd(&lanes[..lane]) << 16 | odd(&lanes),
            lanes[lane ^ 1] << 16 | lanes[size - 1 - lane],
            lanes[0] << 2 | u32::from(any) << 1 | u32::from(all),
        ];
        for (plane, word) in planes.into_iter().enumerate() {
            probe[plane * n + i] = word;
        }
        let v = value(i);
        tally[0] = tally[0].wrapping_add(v);
        tally[1] = tally[1].max(v);
        tally[2] |= 1 << (v & 31);
        tally[3 + v as usize % TALLY_BINS] += 1;
    }
}

/// The kernel on every invocation of a few workgroups.
pub(super) fn case() -> KernelCase {
    let invocations = GROUPS * THREADS;
    let buffers = SubgroupOrderBuffers { probe: vec![0; PLANES * invocations as usize], tally: vec![0; TALLY_WORDS] };
    KernelCase::new(&SUBGROUP_ORDER, (), SubgroupOrderPush { invocations }, buffers, GROUPS)
}
