//! Kernel `subgroup_order`: what the other kernels take for granted of a device.

use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::gpu::proof::KernelCase;
use crate::render::twin;

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

/// Size and order of subgroups, their operations, a scan over the workgroup, atomics of many workgroups on the same words.
/// `probe uint[10][invocations]`, `tally uint[35]`. Dispatch invocations / 256 workgroups.
pub static SUBGROUP_ORDER: Kernel = Kernel {
    name: "subgroup_order",
    doc: "self-test: order and size of subgroups, their operations, atomics of many workgroups on the same words",
    local_size: THREADS,
    spec: &["SUBGROUP_SIZE"],
    push: SubgroupOrderPush::FIELDS,
    bindings: &[
        Binding::new("probe", Access::Write, Element::U32),
        Binding::new("tally", Access::Atomic, Element::U32),
    ],
    twin: subgroup_order_twin,
    tolerance: Tolerance::EXACT,
    bytes: |w| w.get("invocations") * 4 * PLANES as u64,
    spirv: include_bytes!("../../../spirv_cache/subgroup_order.spv"),
};

/// Value of an invocation: 12 bits.
fn value(i: usize) -> u32 {
    (i as u32).wrapping_mul(2_654_435_761) >> 20
}

fn subgroup_order_twin(call: &mut TwinCall<'_>) {
    let push: SubgroupOrderPush = twin::push(call);
    let size = twin::spec(call, 0) as usize;
    let (n, threads) = (push.invocations as usize, THREADS as usize);
    let [probe, tally] = call.buffers else { return };
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
    KernelCase {
        kernel: &SUBGROUP_ORDER,
        spec: Vec::new(),
        push: bytemuck::bytes_of(&SubgroupOrderPush { invocations }).to_vec(),
        buffers: vec![vec![0; PLANES * invocations as usize], vec![0; TALLY_WORDS]],
        groups: GROUPS,
    }
}
