//! Kernel `superpoint_sum`: deterministic sums over each superpoint's pairs, which are sorted by (superpoint, slot, Gaussian).

use super::PAIR_SHIFT;
use crate::gpu::interface::Call;
use crate::gpu::kernel::Tolerance;
use crate::render::twin;
use crate::train::status;
use crate::train::step::Step;

crate::gpu_struct! {
    /// Push constants of [`SUPERPOINT_SUM`].
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

/// Threads per workgroup.
const THREADS: u32 = 256;
/// Pairs per superpoint, on average, up to which a subgroup sums them: 16 rounds of 32 lanes, without barriers.
const FEW_PAIRS: u32 = 512;

/// Whether a subgroup sums a superpoint, or a workgroup does.
pub fn by_subgroup(pairs: u32, superpoints: u32) -> bool {
    pairs / FEW_PAIRS < superpoints
}

/// Workgroups for `superpoints`.
pub fn groups(by_subgroup: bool, subgroup_size: u32, superpoints: u32) -> u32 {
    if by_subgroup { superpoints.div_ceil(THREADS / subgroup_size) } else { superpoints }
}

crate::gpu_constants! {
    /// Specialisation constants of [`SUPERPOINT_SUM`].
    pub struct SuperpointSumConstants {
        /// 1: Σa and Σa·mean.
        moments,
        /// Values of a row of `pair_data`: 9, or 0.
        pair_values,
        /// First value of `own_data`.
        own_first,
        /// Its values, at most 9.
        own_values,
        /// 1: a subgroup sums a superpoint, else a workgroup ([`by_subgroup`]).
        by_subgroup,
        /// With soft superpoints, how many planes of `own_data` each slot has: then every pair has its own. Else 0.
        slot_planes,
        /// Values of a row of `own_data`; 0: it is planes.
        own_row,
        /// Where each superpoint's pairs start: 0: looked for; 1: looked for, and stored; 2: as stored by a dispatch before.
        ranges,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`SUPERPOINT_SUM`].
    pub struct SuperpointSumBuffers {
        /// Counts.
        step: Read Struct(Step),
        /// `[pairs]` superpoints, sorted.
        pair_key: Read U32,
        /// `[pairs]` slot and Gaussian.
        pair_value: Read U32,
        /// `[K][N]`.
        weight: Read F32,
        /// `[3][N]`.
        mean: Read F32,
        /// `[N][pair_values]`, summed with weight a; absent without values.
        pair_data: optional Read F32,
        /// `[own_first + own_values][N]` or `[N][own_row]`, summed over a superpoint's own Gaussians, or `[K][slot_planes][N]`
        /// over all pairs; absent without values.
        own_data: optional Read F32,
        /// `[22][M]` ([`SUM_PLANES`]).
        superpoint_sum: Write F32,
        status: Atomic U32,
        /// `[3][M]`: the first pair, the first with the Gaussian's own superpoint, one beyond the last; absent without `ranges`.
        superpoint_range: optional Update U32,
    }
}

crate::kernel! {
    /// Sums per superpoint. Dispatch [`groups`] workgroups.
    pub static SUPERPOINT_SUM: SuperpointSum = {
        name: "superpoint_sum",
        doc: "sums over each superpoint's Gaussians, weighted by the association and unweighted, in a fixed order",
        local_size: THREADS,
        constants: SuperpointSumConstants,
        push: SuperpointSumPush,
        buffers: SuperpointSumBuffers,
        twin: superpoint_sum_twin,
        tolerance: Tolerance { absolute: 1e-6, relative: 1e-4, flips: 0.0 },
        bytes: |w| (4 + 4 * (1 + 3 + 9)) * w.get("gaussians") * w.get("neighbors"),
    }
}

fn superpoint_sum_twin(call: Call<'_, SuperpointSum>) {
    let Call { constants, push, buffers: b, .. } = call;
    let SuperpointSumConstants { moments, .. } = constants;
    let [pair_values, own_first, own_values] =
        [constants.pair_values, constants.own_first, constants.own_values].map(|c| c as usize);
    let [slot_planes, own_row] = [constants.slot_planes, constants.own_row].map(|c| c as usize);
    let pair_data = b.pair_data.as_deref().unwrap_or_default();
    let own_data = b.own_data.as_deref().unwrap_or_default();
    let step: Step = twin::struct_at(b.step, 0);
    let (n, m) = (step.gaussians as usize, step.superpoints as usize);
    let mut total = vec![[0.0_f64; SUM_PLANES]; m];
    for p in 0..push.pairs as usize {
        let (slot, i) =
            ((b.pair_value[p] >> PAIR_SHIFT) as usize, (b.pair_value[p] & ((1 << PAIR_SHIFT) - 1)) as usize);
        let mut addend = [0.0_f32; SUM_PLANES];
        let own_slot = slot == push.neighbors as usize;
        if own_slot != (slot_planes != 0) {
            for c in 0..own_values {
                let value = own_first + slot * slot_planes + c;
                let at = if own_row != 0 { own_row * i + value } else { value * n + i };
                addend[FIRST_OWN_VALUE + c] = twin::f32_at(own_data, at);
            }
        }
        if !own_slot && (moments != 0 || pair_values != 0) {
            let a = twin::f32_at(b.weight, slot * n + i);
            if moments != 0 {
                addend[0] = a;
                (0..3).for_each(|c| addend[1 + c] = a * twin::f32_at(b.mean, c * n + i));
            }
            (0..pair_values)
                .for_each(|c| addend[FIRST_PAIR_VALUE + c] = a * twin::f32_at(pair_data, pair_values * i + c));
        }
        if addend.iter().all(|v| v.is_finite()) {
            total[b.pair_key[p] as usize].iter_mut().zip(addend).for_each(|(t, v)| *t += f64::from(v));
        } else {
            status::report(b.status, push.status_group as usize, i as u32);
        }
    }
    if let Some(range) = b.superpoint_range.filter(|_| constants.ranges == 1) {
        for j in 0..m {
            for (row, (superpoint, slot)) in [(j, 0), (j, push.neighbors), (j + 1, 0)].into_iter().enumerate() {
                let before = |p: &usize| (b.pair_key[*p], b.pair_value[*p] >> PAIR_SHIFT) < (superpoint as u32, slot);
                range[row * m + j] = (0..push.pairs as usize).filter(before).count() as u32;
            }
        }
    }
    for (j, values) in total.iter().enumerate() {
        for (v, x) in values.iter().enumerate() {
            twin::set_f32(b.superpoint_sum, v * m + j, *x as f32);
        }
    }
}
