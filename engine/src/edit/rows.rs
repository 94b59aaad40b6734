//! Gaussians with all that belongs to them, taken by index.

use bytemuck::Pod;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::scene::{Association, Blend, Deformation, Scene, SuperpointDeformation, Superpoints};

/// Makes the scene one of the Gaussians at `indices`, in this order; one may be there several times. Superpoints, poses and
/// networks stay. With a deformation field each may be there once, and in its old order.
///
/// # Errors
/// [`Error::Usage`] for copies of Gaussians that a deformation field moves.
pub(crate) fn take(scene: &mut Scene, indices: &[usize]) -> Result<()> {
    let n = scene.gaussians.len();
    match &mut scene.deformation {
        Deformation::None | Deformation::Nonrigid(_) => {}
        Deformation::Superpoints(s) => take_superpoints(s, indices),
        Deformation::Field(_) if indices.windows(2).all(|w| w[0] < w[1]) => {
            let mut keep = vec![false; n];
            indices.iter().for_each(|&i| keep[i] = true);
            scene.deformation.retain(&keep);
        }
        Deformation::Field(_) => return Err(is_field("copies of Gaussians")),
    }
    scene.gaussians = scene.gaussians.selected(indices);
    let rows = scene.extra.iter_mut().filter(|(name, t)| name.starts_with("gaussians.") && t.shape.first() == Some(&n));
    for (_, tensor) in rows {
        let width: usize = tensor.shape[1..].iter().product();
        tensor.data = pick(&tensor.data, width, indices);
        tensor.shape[0] = indices.len();
    }
    Ok(())
}

/// The Gaussians at `indices` as a scene of their own, moved as before. Only for scenes without a deformation field.
pub(crate) fn part(scene: &Scene, indices: &[usize]) -> Scene {
    let mut deformation = scene.deformation.clone();
    if let Deformation::Superpoints(s) = &mut deformation {
        take_superpoints(s, indices);
    }
    Scene { gaussians: scene.gaussians.selected(indices), deformation, ..Scene::default() }
}

/// What says that a deformation field cannot follow.
pub(crate) fn is_field(found: &str) -> Error {
    let expected = "a key-time table: `spgs convert --bake` makes one";
    Error::usage("edit", format!("{found} in a model that a deformation field moves"), expected)
}

fn take_superpoints(s: &mut SuperpointDeformation, indices: &[usize]) {
    s.superpoints = Superpoints {
        of_gaussian: pick(&s.superpoints.of_gaussian, 1, indices),
        position: std::mem::take(&mut s.superpoints.position),
    };
    s.blend = s.blend.as_ref().map(|b| Blend {
        neighbors: b.neighbors,
        index: pick(&b.index, b.neighbors, indices),
        weight: pick(&b.weight, b.neighbors, indices),
    });
    s.association = s.association.as_ref().map(|a| Association {
        neighbors: a.neighbors,
        neighbor: pick(&a.neighbor, a.neighbors, indices),
        logit: pick(&a.logit, a.neighbors, indices),
    });
}

/// The rows of `width` values at `indices`.
pub(super) fn pick<T: Pod + Send + Sync>(values: &[T], width: usize, indices: &[usize]) -> Vec<T> {
    let mut picked = vec![T::zeroed(); indices.len() * width];
    let rows = picked.par_chunks_exact_mut(width.max(1)).zip(indices);
    rows.with_min_len(1024).for_each(|(row, &i)| row.copy_from_slice(&values[i * width..(i + 1) * width]));
    picked
}
