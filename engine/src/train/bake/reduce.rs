//! What is left of the superpoints: those that move something.

use glam::{DQuat, DVec3};

use super::promote;
use crate::reference::{aligned_sum, exp, exp_quaternion};
use crate::scene::{Blend, Gaussians, Motion, SuperpointDeformation, Superpoints};

/// Which superpoints stay, and which Gaussians rest.
pub(super) struct Left {
    /// `[M]` whether a Gaussian that does not rest moves with it.
    pub(super) stays: Vec<bool>,
    /// `[M]` new indices: those that stay keep their order, all others become the one after them.
    pub(super) index: Vec<u32>,
    /// `[N]` whether none of its superpoints is moving.
    rests: Vec<bool>,
}

impl Left {
    /// `moving`: `[M]` superpoints that move something.
    pub(super) fn new(superpoints: &Superpoints, blend: Option<&Blend>, moving: &[bool], gaussians: usize) -> Self {
        let mut stays = moving.to_vec();
        let rests: Vec<bool> = (0..gaussians).map(|i| superpoints.slots(blend, i).all(|(j, _)| !moving[j])).collect();
        for i in (0..gaussians).filter(|&i| !rests[i]) {
            superpoints.slots(blend, i).for_each(|(j, _)| stays[j] = true);
        }
        Self { index: new_indices(&stays), stays, rests }
    }

    /// Whether the superpoint that does not move is needed.
    fn has_still(&self) -> bool {
        self.stays.iter().any(|stays| !stays) || self.rests.iter().any(|rests| *rests)
    }

    /// The index of the one that does not move.
    fn still(&self) -> u32 {
        self.stays.iter().filter(|stays| **stays).count() as u32
    }

    /// Applies the first candidate's poses to the Gaussians that rest.
    pub(super) fn apply_constant_pose(
        &self,
        g: &mut Gaussians,
        superpoints: &Superpoints,
        blend: Option<&Blend>,
        motion: &Motion,
    ) {
        let pose = |j: usize| (promote(motion.rotation[j]), promote(motion.translation[j]));
        for i in (0..g.len()).filter(|&i| self.rests[i]) {
            let slots = || superpoints.slots(blend, i).map(|(j, w)| (w, pose(j)));
            if slots().all(|(_, (r, t))| r == DVec3::ZERO && t == DVec3::ZERO) {
                continue;
            }
            let mean = promote(g.mean[i]);
            let moved: DVec3 = slots().map(|(w, (r, t))| w * (exp(r) * mean + t)).sum();
            g.mean[i] = moved.as_vec3().to_array();
            let [w, x, y, z] = g.rotation[i].map(f64::from);
            let q = turn(slots().map(|(w, (r, _))| (w, r)).collect()) * DQuat::from_xyzw(x, y, z, w);
            g.rotation[i] = [q.w as f32, q.x as f32, q.y as f32, q.z as f32];
        }
    }

    /// The superpoints that are left, with a table of the candidates `keys`. A blend stays where a Gaussian needs it.
    pub(super) fn deformation(
        &self,
        superpoints: &Superpoints,
        blend: Option<&Blend>,
        motion: &Motion,
        keys: &[usize],
    ) -> SuperpointDeformation {
        let mut left = SuperpointDeformation::of_table(self.superpoints(superpoints), self.motion(motion, keys));
        if let Some(blend) = blend.map(|blend| self.blend(blend)) {
            left.superpoints.of_gaussian = blend.of_gaussian();
            left.blend = (blend.soft_count() > 0).then_some(blend);
        }
        left
    }

    fn motion(&self, motion: &Motion, keys: &[usize]) -> Motion {
        let count = self.stays.len();
        let pick = |table: &[[f32; 3]]| -> Vec<[f32; 3]> {
            let row = |k: &usize| {
                let staying = self.stays.iter().enumerate().filter(|(_, stays)| **stays);
                let mut row: Vec<[f32; 3]> = staying.map(|(j, _)| table[*k * count + j]).collect();
                row.extend(self.has_still().then_some([0.0; 3]));
                row
            };
            keys.iter().flat_map(row).collect()
        };
        let times = keys.iter().map(|&k| motion.times[k]).collect();
        Motion { times, rotation: pick(&motion.rotation), translation: pick(&motion.translation) }
    }

    fn superpoints(&self, superpoints: &Superpoints) -> Superpoints {
        let all = || superpoints.position.iter().zip(&self.stays);
        let mut position: Vec<[f32; 3]> = all().filter(|(_, stays)| **stays).map(|(p, _)| *p).collect();
        if self.has_still() {
            let still: Vec<DVec3> = all().filter(|(_, stays)| !**stays).map(|(p, _)| promote(*p)).collect();
            let centre = still.iter().sum::<DVec3>() / still.len().max(1) as f64;
            position.push(centre.as_vec3().to_array());
        }
        let own = |(i, &j): (usize, &u32)| if self.rests[i] { self.still() } else { self.index[j as usize] };
        Superpoints { of_gaussian: superpoints.of_gaussian.iter().enumerate().map(own).collect(), position }
    }

    /// A Gaussian that rests has all its weight on the superpoint that does not move.
    fn blend(&self, blend: &Blend) -> Blend {
        let mut left = blend.clone();
        let rows = left.index.chunks_exact_mut(blend.neighbors).zip(left.weight.chunks_exact_mut(blend.neighbors));
        for ((index, weight), &rests) in rows.zip(&self.rests) {
            if rests {
                index.fill(self.still());
                weight.fill(0.0);
                weight[0] = 1.0;
            } else {
                index.iter_mut().for_each(|j| *j = self.index[*j as usize]);
            }
        }
        left
    }
}

/// The quaternion that slots of weights and so(3) vectors share.
fn turn(slots: Vec<(f64, DVec3)>) -> DQuat {
    match slots[..] {
        [(_, r)] => DQuat::from_mat3(&exp(r)),
        _ => {
            let slots: Vec<(f64, DQuat)> = slots.into_iter().map(|(w, r)| (w, exp_quaternion(r))).collect();
            aligned_sum(&slots).normalize()
        }
    }
}

fn new_indices(stays: &[bool]) -> Vec<u32> {
    let rest = stays.iter().filter(|m| **m).count() as u32;
    let mut next = 0;
    let index = |m: &bool| {
        if *m {
            next += 1;
            next - 1
        } else {
            rest
        }
    };
    stays.iter().map(index).collect()
}
