//! Gaussians with all that belongs to them, taken by index.

use bytemuck::Pod;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::scene::gaussians::repeat_chunks;
use crate::scene::{Association, Blend, Deformation, Gaussians, Scene, SuperpointDeformation, Superpoints};

/// Adds copies of the Gaussians at `indices` after all others, with all that belongs to them, in this order. Superpoints, poses
/// and networks stay.
///
/// # Errors
/// [`Error::Usage`] for Gaussians that a deformation field moves.
pub(crate) fn repeat(scene: &mut Scene, indices: &[usize]) -> Result<()> {
    match &mut scene.deformation {
        Deformation::None | Deformation::Nonrigid(_) => {}
        Deformation::Superpoints(s) => repeat_superpoints(s, indices),
        Deformation::Field(_) => return Err(is_field("copies of Gaussians")),
    }
    for tensor in scene.extra_of_gaussians() {
        let width = tensor.shape[1..].iter().product();
        repeat_chunks(&mut tensor.data, width, indices);
        tensor.shape[0] += indices.len();
    }
    scene.gaussians.repeat(indices);
    Ok(())
}

/// The Gaussians at `indices` as a scene of their own, moved as before, without colours. Only for scenes without a deformation
/// field.
pub(crate) fn part(scene: &Scene, indices: &[usize]) -> Scene {
    let mut deformation = scene.deformation.clone();
    if let Deformation::Superpoints(s) = &mut deformation {
        take_superpoints(s, indices);
    }
    let g = &scene.gaussians;
    let gaussians = Gaussians {
        mean: pick(&g.mean, 1, indices),
        log_scale: pick(&g.log_scale, 1, indices),
        rotation: pick(&g.rotation, 1, indices),
        opacity_logit: pick(&g.opacity_logit, 1, indices),
        sh_degree: 0,
        sh: vec![0.0; 3 * indices.len()],
        optional: g.optional.selected(indices),
        antialiased: g.antialiased,
    };
    Scene { gaussians, deformation, ..Scene::default() }
}

/// What says that a deformation field cannot follow.
pub(crate) fn is_field(found: &str) -> Error {
    let expected = "a key-time table: `spgs convert --bake` makes one";
    Error::usage("edit", format!("{found} in a model that a deformation field moves"), expected)
}

fn repeat_superpoints(s: &mut SuperpointDeformation, indices: &[usize]) {
    repeat_chunks(&mut s.superpoints.of_gaussian, 1, indices);
    if let Some(b) = &mut s.blend {
        repeat_chunks(&mut b.index, b.neighbors, indices);
        repeat_chunks(&mut b.weight, b.neighbors, indices);
    }
    if let Some(a) = &mut s.association {
        repeat_chunks(&mut a.neighbor, a.neighbors, indices);
        repeat_chunks(&mut a.logit, a.neighbors, indices);
    }
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
    pick_into(&mut picked, values, width, indices);
    picked
}

/// The same into `picked`, which has room for them.
pub(super) fn pick_into<T: Pod + Send + Sync>(picked: &mut [T], values: &[T], width: usize, indices: &[usize]) {
    let rows = picked.par_chunks_exact_mut(width.max(1)).zip(indices);
    rows.with_min_len(1024).for_each(|(row, &i)| row.copy_from_slice(&values[i * width..(i + 1) * width]));
}
