//! SP-GS: superpoints, their table, association, networks F and G.
//!
//! `deform.pth` is the list of network F's weights and the superpoints': `A` `[N,M]`, `p2sp` `[N]`, `sp_xyz` `[M,3]`,
//! `sp_delta_r` `[T,M,3]` or `[T,M,4]`, `sp_delta_t` `[T,M,3]`, `train_times` `[T]`.

use std::path::Path;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::file::torch::Weights;
use crate::reference::Offset;
use crate::reference::tabulate::{PlacedGaussian, TableTimes, tabulate};
use crate::scene::network::{DeformSize, NONRIGID_HEADS, NONRIGID_LAYERS, NONRIGID_WIDTH};
use crate::scene::{
    Association, DeformNetwork, Deformation, Gaussians, Linear, Motion, NonrigidNetwork, Scene, SuperpointDeformation,
    Superpoints,
};

/// Neighbours that the released code gives each Gaussian.
const NEIGHBORS: usize = 5;

/// Adds the motion of `weights` to a scene at rest.
pub(super) fn apply(scene: &mut Scene, weights: &Weights<'_>, path: &Path, warnings: &mut Vec<String>) -> Result<()> {
    let n = scene.gaussians.len();
    let (position, shape) = weights.floats("1.sp_xyz", &[None, Some(3)])?;
    let position = triples(&position);
    let m = shape[0];
    let (of_gaussian, _) = weights.floats("1.p2sp", &[Some(n)])?;
    let of_gaussian: Vec<u32> = of_gaussian.iter().map(|&j| if j >= 0.0 { j as u32 } else { u32::MAX }).collect();
    if let Some(i) = of_gaussian.iter().position(|&j| j as usize >= m) {
        let found = format!("{} at element {i}", of_gaussian[i]);
        return Err(Error::corrupt(path, "tensor `1.p2sp`", found, format!("0 to {}", m.saturating_sub(1))));
    }
    let (times, shape) = weights.floats("1.train_times", &[None])?;
    let t = shape[0];
    let (translation, _) = weights.floats("1.sp_delta_t", &[Some(t), Some(m), Some(3)])?;
    let (rotation, shape) = weights.floats("1.sp_delta_r", &[Some(t), Some(m), None])?;
    match shape[2] {
        3 => {
            let motion = Motion { times, rotation: triples(&rotation), translation: triples(&translation) };
            let association = association(weights, &scene.gaussians, &position, path)?;
            // Untrained superpoints have an empty or all-zero table; network F then gives the motion.
            let is_filled = motion.times.windows(2).all(|w| w[0] < w[1]) && !motion.times.is_empty();
            if !is_filled {
                warnings.push(format!("{}: its table of poses is empty: network F gives the motion", path.display()));
            }
            scene.deformation = Deformation::from(SuperpointDeformation {
                blend: None,
                superpoints: Superpoints { of_gaussian, position },
                table: is_filled.then_some(motion),
                network: Some(network(weights, path)?),
                association,
                nonrigid: None,
            });
            Ok(())
        }
        4 => {
            warnings.push(format!(
                "{}: quaternions are added here (SP-GS before 2025), which is no rigid motion of superpoints: each Gaussian gets its own poses",
                path.display()
            ));
            let added = Added { of_gaussian, superpoints: m, times: &times, rotation, translation };
            let mut place = |g: &Gaussians, time: f64| Ok(added.place(g, time));
            let at = TableTimes::At(&times);
            let made = tabulate(&mut scene.gaussians, &mut place, at, &path.display().to_string())?;
            scene.deformation = SuperpointDeformation::of_table(made.superpoints, made.motion).into();
            Ok(())
        }
        other => Err(Error::corrupt(path, "tensor `1.sp_delta_r`", format!("{other} values per pose"), "3 or 4")),
    }
}

/// Translation of the centre, quaternion added to the unit quaternion: μ + Δt, norm(norm(q) + Δq).
struct Added<'a> {
    of_gaussian: Vec<u32>,
    superpoints: usize,
    times: &'a [f32],
    rotation: Vec<f32>,
    translation: Vec<f32>,
}

impl Added<'_> {
    /// Only asked for at the table's own times.
    fn place(&self, g: &Gaussians, time: f64) -> Vec<PlacedGaussian> {
        let k = self.times.iter().position(|&t| f64::from(t) == time).unwrap_or(0);
        let placed = |i: usize| {
            let pose = k * self.superpoints + self.of_gaussian[i] as usize;
            let offset = Offset {
                mean: std::array::from_fn(|a| self.translation[3 * pose + a].into()),
                rotation: std::array::from_fn(|c| self.rotation[4 * pose + c].into()),
                scale: [0.0; 3],
            };
            PlacedGaussian::shifted(g, i, &offset)
        };
        (0..g.len()).into_par_iter().map(placed).collect()
    }
}

/// The logits of the nearest superpoints, which are all that the method reads of `A`.
fn association(
    weights: &Weights<'_>,
    g: &Gaussians,
    position: &[[f32; 3]],
    path: &Path,
) -> Result<Option<Association>> {
    if !weights.has("1.A") {
        return Ok(None);
    }
    let (n, m) = (g.len(), position.len());
    let (dense, _) = weights.floats("1.A", &[Some(n), Some(m)])?;
    let k = NEIGHBORS.min(m);
    if k == 0 {
        return Err(Error::corrupt(path, "tensor `1.sp_xyz`", "no superpoint", "at least one"));
    }
    let nearest = |i: usize| {
        let squared = |j: usize| (0..3).map(|a| (g.mean[i][a] - position[j][a]).powi(2)).sum::<f32>();
        let mut order: Vec<(f32, u32)> = (0..m).map(|j| (squared(j), j as u32)).collect();
        order.select_nth_unstable_by(k - 1, |a, b| a.0.total_cmp(&b.0));
        order.truncate(k);
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        order.into_iter().map(|(_, j)| j).collect::<Vec<u32>>()
    };
    let neighbor: Vec<u32> = (0..n).into_par_iter().flat_map_iter(nearest).collect();
    let logit = neighbor.iter().enumerate().map(|(e, &j)| dense[e / k * m + j as usize]).collect();
    Ok(Some(Association { neighbors: k, neighbor, logit }))
}

/// Network F.
fn network(weights: &Weights<'_>, path: &Path) -> Result<DeformNetwork> {
    let layer = |name: String, inputs: usize, outputs: usize| linear(weights, &name, inputs, outputs, path);
    let size = DeformSize::PAPER;
    Ok(DeformNetwork {
        linear: (0..size.layers)
            .map(|i| layer(format!("0.linear.{i}"), size.layer_inputs(i), size.width))
            .collect::<Result<_>>()?,
        translation: layer("0.gaussian_warp".into(), size.width, 3)?,
        rotation: layer("0.gaussian_rotation".into(), size.width, 3)?,
    })
}

/// Network G.
pub(super) fn nonrigid(weights: &Weights<'_>, path: &Path) -> Result<NonrigidNetwork> {
    let layer = |name: &str, inputs: usize, outputs: usize| linear(weights, name, inputs, outputs, path);
    let [translation, rotation, scaling] = NONRIGID_HEADS;
    Ok(NonrigidNetwork {
        linear: (0..NONRIGID_LAYERS)
            .map(|i| layer(&format!("linear.{i}"), NonrigidNetwork::layer_inputs(i), NONRIGID_WIDTH))
            .collect::<Result<_>>()?,
        translation: layer("gaussian_warp", NONRIGID_WIDTH, translation)?,
        rotation: layer("gaussian_rotation", NONRIGID_WIDTH, rotation)?,
        scaling: layer("gaussian_scaling", NONRIGID_WIDTH, scaling)?,
    })
}

/// A layer of the expected shape.
pub(super) fn linear(weights: &Weights<'_>, name: &str, inputs: usize, outputs: usize, path: &Path) -> Result<Linear> {
    let (weight, _) = weights.floats(&format!("{name}.weight"), &[Some(outputs), Some(inputs)])?;
    let (bias, _) = weights.floats(&format!("{name}.bias"), &[Some(outputs)])?;
    if weight.iter().chain(&bias).any(|v| !v.is_finite()) {
        return Err(Error::corrupt(path, format!("tensor `{name}`"), "a number that is not finite", "finite numbers"));
    }
    Ok(Linear { inputs, outputs, weight, bias })
}

fn triples(values: &[f32]) -> Vec<[f32; 3]> {
    values.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect()
}
