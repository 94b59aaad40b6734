//! `superpoint_sum`: deterministic sums over each superpoint's pairs, which are sorted by (superpoint, slot, Gaussian).

use super::PAIR_SHIFT;
use crate::gpu::kernel::{Access, Binding, Element, Kernel, Tolerance, TwinCall};
use crate::render::twin;
use crate::train::status;
use crate::train::step::Step;

crate::gpu_struct! {
    /// Push constants of `superpoint_sum`.
    pub struct SuperpointSumPush {
        /// K: the slot of pairs with the Gaussian's own superpoint.
        pub neighbors: u32,
        /// Pairs: N·(K + 1).
        pub pairs: u32,
        /// Group of `status` for contributions that are not finite; they are left out.
        pub status_group: u32,
    }
}

/// Planes of a sum buffer `float[22][M]`: Σa, Σa·mean (3), Σa·pair_data (9), Σ own_data (9).
pub const SUM_PLANES: usize = 22;
/// First plane of Σa·pair_data.
pub const FIRST_PAIR_VALUE: usize = 4;
/// First plane of Σ own_data.
pub const FIRST_OWN_VALUE: usize = 13;

/// Sums per superpoint. Dispatch M workgroups.
pub static SUPERPOINT_SUM: Kernel = Kernel {
    name: "superpoint_sum",
    doc: "sums over each superpoint's Gaussians, weighted by the association and unweighted, in a fixed order",
    local_size: 256,
    spec: &["SUBGROUP_SIZE", "MOMENTS", "PAIR_PLANES", "OWN_FIRST", "OWN_PLANES"],
    push: SuperpointSumPush::FIELDS,
    bindings: &[
        Binding::of_struct("step", Access::Read, Step::FIELDS),
        Binding::new("pair_key", Access::Read, Element::U32),
        Binding::new("pair_value", Access::Read, Element::U32),
        Binding::new("weight", Access::Read, Element::F32),
        Binding::new("mean", Access::Read, Element::F32),
        Binding::new("pair_data", Access::Read, Element::F32),
        Binding::new("own_data", Access::Read, Element::F32),
        Binding::new("superpoint_sum", Access::Write, Element::F32),
        Binding::new("status", Access::Atomic, Element::U32),
    ],
    twin: superpoint_sum_twin,
    tolerance: Tolerance { absolute: 1e-6, relative: 1e-4, flips: 0.0 },
    bytes: |w| (4 + 4 * (1 + 3 + 9)) * w.get("gaussians") * w.get("neighbors"),
    spirv: include_bytes!("../../../../spirv_cache/superpoint_sum.spv"),
};

fn superpoint_sum_twin(call: &mut TwinCall<'_>) {
    let push: SuperpointSumPush = twin::push(call);
    let [moments, pair_planes, own_first, own_planes] = [1, 2, 3, 4].map(|id| twin::spec(call, id) as usize);
    let [step, key, value, weight, mean, pair_data, own_data, sums, words] = call.buffers else { return };
    let step: Step = twin::struct_at(step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    let mut total = vec![[0.0_f64; SUM_PLANES]; m];
    for p in 0..push.pairs as usize {
        let (slot, i) = ((value[p] >> PAIR_SHIFT) as usize, (value[p] & ((1 << PAIR_SHIFT) - 1)) as usize);
        let mut addend = [0.0_f32; SUM_PLANES];
        if slot == push.neighbors as usize {
            for c in 0..own_planes {
                addend[FIRST_OWN_VALUE + c] = twin::f32_at(own_data, (own_first + c) * n + i);
            }
        } else if moments != 0 || pair_planes != 0 {
            let a = twin::f32_at(weight, slot * n + i);
            if moments != 0 {
                addend[0] = a;
                (0..3).for_each(|c| addend[1 + c] = a * twin::f32_at(mean, c * n + i));
            }
            (0..pair_planes).for_each(|c| addend[FIRST_PAIR_VALUE + c] = a * twin::f32_at(pair_data, c * n + i));
        }
        if addend.iter().all(|v| v.is_finite()) {
            total[key[p] as usize].iter_mut().zip(addend).for_each(|(t, v)| *t += f64::from(v));
        } else {
            status::report(words, push.status_group as usize, i as u32);
        }
    }
    for (j, values) in total.iter().enumerate() {
        for (v, x) in values.iter().enumerate() {
            twin::set_f32(sums, v * m + j, *x as f32);
        }
    }
}
