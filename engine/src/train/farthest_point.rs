//! Kernel `farthest_point`: farthest-point sampling of superpoint centres from the Gaussians' canonical means.
//!
//! One dispatch per centre: each workgroup reduces the candidates that the previous round left (one per 1,024 points), so
//! no other dispatch and no read-back is needed between rounds. The point farthest from all chosen ones is next; ties go
//! to the lowest index; a chosen point is not chosen again while another is left; points that are not finite come last.

use crate::error::Result;
use crate::gpu::interface::Call;
use crate::gpu::kernel::{Kernel, Tolerance};
use crate::gpu::{Buffer, Gpu, Groups, Memory, Recorder, Slice};
use crate::render::twin::{f32_at, set_f32};

/// Kernels of this module.
pub static KERNELS: &[&Kernel] = &[&FARTHEST_POINT.kernel];

/// Points per workgroup of `farthest_point`.
pub const FARTHEST_POINTS: u32 = 1024;

crate::gpu_struct! {
    /// Push constants of `farthest_point`.
    pub struct FarthestPointPush {
        /// Number of points.
        pub points: u32,
        /// Which point is chosen now, from 0.
        pub round: u32,
        /// Pairs (distance, index) in `candidates_in`.
        pub candidates: u32,
    }
}

crate::gpu_buffers! {
    /// Buffers of [`FARTHEST_POINT`].
    pub struct FarthestPointBuffers {
        /// `float[3][points]`.
        mean: Read F32,
        /// Pairs (bits of the distance, index); before round 0 the first point.
        candidates_in: Read U32,
        /// `float[points]`: squared distance to the nearest chosen point, -1 for one that is not to be chosen; before round 0
        /// f32::MAX.
        distance_to: Update F32,
        /// The farthest point of each workgroup, as `candidates_in`.
        candidates_out: Write U32,
        /// `uint[rounds]`: the point of each round.
        chosen: Write U32,
        /// `float[rounds][3]`.
        superpoint_position: Write F32,
    }
}

crate::kernel! {
    /// One round. Dispatch ceil(points / 1024) workgroups.
    pub static FARTHEST_POINT: FarthestPointRound = {
        name: "farthest_point",
        doc: "one round of farthest-point sampling: the farthest candidate becomes a superpoint centre, distances shrink",
        local_size: 256,
        constants: (),
        push: FarthestPointPush,
        buffers: FarthestPointBuffers,
        twin: farthest_point_twin,
        tolerance: Tolerance::EXACT,
        bytes: |w| 20 * w.get("gaussians"),
    }
}

/// The better of two candidates: larger distance, then lower index.
fn farther(a: (f32, u32), b: (f32, u32)) -> (f32, u32) {
    if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a }
}

fn farthest_point_twin(call: Call<'_, FarthestPointRound>) {
    let groups = call.group_count();
    let Call { push, buffers: b, .. } = call;
    let n = push.points as usize;
    let none = (-2.0, u32::MAX);
    let point = |i: usize| [0, 1, 2].map(|c| f32_at(b.mean, c * n + i));
    let best = (0..push.candidates as usize)
        .map(|c| (f32_at(b.candidates_in, 2 * c), b.candidates_in[2 * c + 1]))
        .fold(none, farther);
    let center = (best.1 as usize).min(n - 1);
    let p = point(center);
    for group in 0..groups as usize {
        let first = group * FARTHEST_POINTS as usize;
        if first >= n {
            continue;
        }
        let mut far = none;
        for i in first..n.min(first + FARTHEST_POINTS as usize) {
            let q = point(i);
            let d = [0, 1, 2].map(|c| q[c] - p[c]);
            let step_to = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            let old = f32_at(b.distance_to, i);
            let now = if step_to.is_finite() { old.min(step_to) } else { old };
            let usable = q.iter().all(|x| x.is_finite());
            let now = if i == center || !usable { -1.0 } else { now };
            set_f32(b.distance_to, i, now);
            far = farther(far, (now, i as u32));
        }
        set_f32(b.candidates_out, 2 * group, far.0);
        b.candidates_out[2 * group + 1] = far.1;
    }
    b.chosen[push.round as usize] = center as u32;
    for (c, x) in p.into_iter().enumerate() {
        set_f32(b.superpoint_position, 3 * push.round as usize + c, if x.is_finite() { x } else { 0.0 });
    }
}

/// Work buffers of one sampling; dropped after it.
#[derive(Debug)]
pub struct FarthestPoint {
    distance_to: Buffer,
    candidates: [Buffer; 2],
    points: u32,
}

impl FarthestPoint {
    /// Buffers for `points` > 0 points; sampling starts from point `seed` mod `points`.
    pub fn new(gpu: &Gpu, points: u32, seed: u64) -> Result<Self> {
        let groups = u64::from(points.div_ceil(FARTHEST_POINTS));
        let first = (seed % u64::from(points.max(1))) as u32;
        let candidates = [0, 1].map(|_| gpu.buffer("farthest candidates", 8 * groups, Memory::Device));
        let [a, b] = candidates;
        let (a, b) = (a?, b?);
        gpu.upload(&a, bytemuck::cast_slice(&[f32::INFINITY.to_bits(), first]))?;
        let distance_to = gpu.buffer("farthest distance", 4 * u64::from(points), Memory::Device)?;
        Ok(Self { distance_to, candidates: [a, b], points })
    }

    /// Records the choice of `count` centres (≤ points): `chosen` `uint[count]` gets their indices,
    /// `superpoint_position` `float[count][3]` their places.
    pub fn record(&self, r: &mut Recorder, mean: &Slice, count: u32, chosen: &Slice, position: &Slice) -> Result<()> {
        r.fill(&self.distance_to, f32::MAX.to_bits())?;
        let groups = self.points.div_ceil(FARTHEST_POINTS);
        for round in 0..count {
            let push =
                FarthestPointPush { points: self.points, round, candidates: if round == 0 { 1 } else { groups } };
            let (from, to) = (round as usize % 2, (round as usize + 1) % 2);
            let buffers = FarthestPointBuffers {
                mean: mean.clone(),
                candidates_in: self.candidates[from].whole(),
                distance_to: self.distance_to.whole(),
                candidates_out: self.candidates[to].whole(),
                chosen: chosen.clone(),
                superpoint_position: position.clone(),
            };
            r.dispatch(&FARTHEST_POINT, (), push, buffers, Groups::Direct(groups.into()))?;
        }
        Ok(())
    }
}
