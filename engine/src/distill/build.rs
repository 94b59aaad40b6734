//! The student as a scene.

use glam::{DMat3, DQuat, DVec3};

use super::divide::at_rest_place;
use super::parts::Parts;
use super::sample::{Order, Samples};
use super::soft::Soft;
use super::table::Table;
use super::tracks::{Rest, Tracks};
use crate::scene::{Blend, Deformation, Gaussians, Scene, SuperpointDeformation, Superpoints};

/// A student that lacks key times.
#[derive(Debug)]
pub(super) struct Student {
    gaussians: Gaussians,
    superpoints: Superpoints,
    /// Where Gaussians move with several.
    blend: Option<Blend>,
    /// Whether there is a superpoint that rests, the last.
    has_still: bool,
    metadata: std::collections::BTreeMap<String, String>,
}

impl Student {
    pub(super) fn new(
        teacher: &Scene,
        kept: &[usize],
        samples: &Samples,
        tracks: &Tracks,
        parts: &Parts,
        rests: &[usize],
        soft: &[Soft],
    ) -> Self {
        let mut gaussians = teacher.gaussians.selected(kept);
        let still = parts.0.len() as u32;
        let mut superpoints = Superpoints { of_gaussian: vec![still; gaussians.len()], position: Vec::new() };
        let mut put = |i: usize, rest: &Rest| {
            gaussians.mean[i] = rest.center.as_vec3().to_array();
            gaussians.rotation[i] = rotation(rest.axes, samples.order[i]);
            gaussians.log_scale[i] = samples.sizes.mean(i);
        };
        for (j, part) in parts.0.iter().enumerate() {
            part.members.iter().zip(&part.rest).for_each(|(&i, rest)| put(i, rest));
            part.members.iter().for_each(|&i| superpoints.of_gaussian[i] = j as u32);
            superpoints.position.push(mean(part.rest.iter()));
        }
        let places: Vec<Rest> = rests.iter().map(|&i| at_rest_place(tracks, i)).collect();
        rests.iter().zip(&places).for_each(|(&i, rest)| put(i, rest));
        soft.iter().for_each(|soft| put(soft.track, &soft.rest));
        let has_still = !rests.is_empty();
        superpoints.position.extend(has_still.then(|| mean(places.iter())));
        let blend = (!soft.is_empty()).then(|| blend(&superpoints.of_gaussian, soft));
        if let Some(blend) = &blend {
            superpoints.of_gaussian = blend.of_gaussian();
        }
        Self { gaussians, superpoints, blend, has_still, metadata: teacher.metadata.clone() }
    }

    /// With poses at these of the table's times.
    pub(super) fn scene(&self, table: &Table, keys: &[usize]) -> Scene {
        let moves = self.superpoints.position.len() > usize::from(self.has_still);
        let deformation = if moves {
            let table = table.motion(keys, self.has_still);
            let blend = self.blend.clone();
            SuperpointDeformation { blend, ..SuperpointDeformation::of_table(self.superpoints.clone(), table) }.into()
        } else {
            Deformation::None
        };
        let metadata = self.metadata.clone();
        Scene { gaussians: self.gaussians.clone(), deformation, metadata, ..Scene::default() }
    }
}

/// Each Gaussian with its own superpoint, but for those that move with several; weights as bytes.
fn blend(of_gaussian: &[u32], soft: &[Soft]) -> Blend {
    let neighbors = soft.iter().map(|soft| soft.slots.len()).max().unwrap_or(1);
    let row = |j: &u32| std::iter::repeat_n(*j, neighbors);
    let mut blend = Blend {
        neighbors,
        index: of_gaussian.iter().flat_map(row).collect(),
        weight: vec![0.0; neighbors * of_gaussian.len()],
    };
    blend.weight.iter_mut().step_by(neighbors).for_each(|w| *w = 1.0);
    for Soft { track, slots, .. } in soft {
        let first = track * neighbors;
        for (k, &(j, w)) in slots.iter().enumerate() {
            (blend.index[first + k], blend.weight[first + k]) = (j as u32, w as f32);
        }
    }
    blend.quantized()
}

fn mean<'a>(rests: impl ExactSizeIterator<Item = &'a Rest>) -> [f32; 3] {
    let count = rests.len().max(1) as f64;
    (rests.map(|rest| rest.center).sum::<DVec3>() / count).as_vec3().to_array()
}

/// The quaternion w,x,y,z whose rotation has these directions for the two longest axes.
fn rotation(axes: [DVec3; 2], order: Order) -> [f32; 4] {
    let x = axes[0].normalize_or(DVec3::X);
    let y = (axes[1] - x * x.dot(axes[1])).normalize_or(x.any_orthonormal_vector());
    let [a, b, c] = order.map(usize::from);
    // An odd order of the axes mirrors them.
    let is_even = (a + 1) % 3 == b;
    let mut columns = [DVec3::ZERO; 3];
    (columns[a], columns[b], columns[c]) = (x, y, if is_even { x.cross(y) } else { y.cross(x) });
    let q = DQuat::from_mat3(&DMat3::from_cols(columns[0], columns[1], columns[2])).normalize();
    [q.w, q.x, q.y, q.z].map(|v| v as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{exp, rotation_of_quaternion};

    #[test]
    fn rotations_are_those_of_their_axes_in_any_order() {
        let turn = exp(DVec3::new(0.4, -2.0, 1.1));
        for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]] {
            let axes = [0, 1].map(|k: usize| 0.1 * turn.col(usize::from(order[k])));
            let found = rotation_of_quaternion(rotation(axes, order).map(f64::from));
            assert!(found.abs_diff_eq(turn, 1e-6), "{order:?}");
        }
    }
}
