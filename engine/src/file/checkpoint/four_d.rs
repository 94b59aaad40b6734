//! 4D-GS (Wu et al. 2024): planes over pairs of x, y, z, t, whose product a small network turns into offsets.
//!
//! `deformation_net.grid.aabb` `[2,3]`; `grids.{s}.{p}` `[1,C,B,A]` for the pairs (x,y) (x,z) (x,t) (y,z) (y,t) (z,t);
//! features of all resolutions s one after another → `feature_out.0` → heads `ReLU, Linear, ReLU, Linear`, added to the
//! centre and, before activation, to scale and rotation. Offsets of opacity and colour (off by default in the released
//! configurations) are not taken.

use std::path::Path;

use rayon::prelude::*;

use super::mlp::{LANES, Row, dense, relu};
use super::per_gaussian::{Deformation, Placed};
use super::sp_gs::linear;
use crate::error::{Error, Result};
use crate::file::codec::unit;
use crate::file::torch::Weights;
use crate::scene::{Gaussians, Linear};

/// The pairs of coordinates of the six planes: column, row.
const PAIRS: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
/// Most resolutions.
const MAX_SCALES: usize = 8;
/// Prefix of the tensors' names.
const NET: &str = "deformation_net";

/// One plane.
struct Plane {
    /// `[channels, height, width]`.
    values: Vec<f32>,
    height: usize,
    width: usize,
}

/// Two layers, each after a ReLU.
struct Head([Linear; 2]);

/// The field.
pub(super) struct Field {
    /// The value of −1 and of 1 on each axis.
    ends: [[f32; 3]; 2],
    scales: Vec<[Plane; 6]>,
    channels: usize,
    feature: Linear,
    position: Head,
    scaling: Head,
    rotation: Head,
}

impl Head {
    fn read(weights: &Weights<'_>, name: &str, width: usize, outputs: usize, path: &Path) -> Result<Self> {
        let first = linear(weights, &format!("{NET}.{name}.1"), width, width, path)?;
        Ok(Self([first, linear(weights, &format!("{NET}.{name}.3"), width, outputs, path)?]))
    }

    fn apply(&self, hidden: &[Row]) -> Vec<Row> {
        dense(&self.0[1], &relu(dense(&self.0[0], hidden)))
    }
}

impl Field {
    pub(super) fn read(weights: &Weights<'_>, path: &Path) -> Result<Self> {
        let (ends, _) = weights.floats(&format!("{NET}.grid.aabb"), &[Some(2), Some(3)])?;
        let ends: [[f32; 3]; 2] = std::array::from_fn(|e| std::array::from_fn(|a| ends[3 * e + a]));
        if (0..3).any(|a| !(ends[1][a] - ends[0][a]).is_normal()) {
            return Err(Error::corrupt(path, "tensor `grid.aabb`", format!("{ends:?}"), "a box with a size"));
        }
        let mut scales: Vec<[Plane; 6]> = Vec::new();
        let mut channels = 0;
        while weights.has(&format!("{NET}.grid.grids.{}.0", scales.len())) && scales.len() < MAX_SCALES {
            let mut planes = Vec::with_capacity(6);
            for p in 0..6 {
                let name = format!("{NET}.grid.grids.{}.{p}", scales.len());
                let (values, shape) = weights.floats(&name, &[Some(1), None, None, None])?;
                if values.is_empty() || (channels != 0 && shape[1] != channels) {
                    return Err(Error::corrupt(
                        path,
                        format!("tensor `{name}`"),
                        format!("{shape:?}"),
                        "as many channels each",
                    ));
                }
                channels = shape[1];
                planes.push(Plane { values, height: shape[2], width: shape[3] });
            }
            let planes = planes.try_into().map_err(|_| Error::corrupt(path, "grid", "planes", "six"))?;
            scales.push(planes);
        }
        if scales.is_empty() {
            return Err(Error::corrupt(path, "tensor `grid.grids.0.0`", "nothing", "six planes for each resolution"));
        }
        let width = weights.shape(&format!("{NET}.feature_out.0.weight")).and_then(|s| s.first().copied()).unwrap_or(0);
        if (1..8).any(|i| weights.has(&format!("{NET}.feature_out.{i}.weight"))) {
            let found = "a deeper network before the heads";
            return Err(Error::corrupt(path, "tensor `feature_out`", found, "one layer (net depth 0 or 1)"));
        }
        let features = channels * scales.len();
        Ok(Self {
            ends,
            channels,
            feature: linear(weights, &format!("{NET}.feature_out.0"), features, width, path)?,
            position: Head::read(weights, "pos_deform", width, 3, path)?,
            scaling: Head::read(weights, "scales_deform", width, 3, path)?,
            rotation: Head::read(weights, "rotations_deform", width, 4, path)?,
            scales,
        })
    }

    /// Features of 16 points: the product of the six planes at each resolution.
    fn features(&self, means: &[[f32; 3]], time: f32) -> Vec<Row> {
        let mut features = vec![[0.0; LANES]; self.channels * self.scales.len()];
        for (lane, mean) in means.iter().enumerate() {
            let share = |a: usize| (mean[a] - self.ends[0][a]) * 2.0 / (self.ends[1][a] - self.ends[0][a]) - 1.0;
            // Time is not mapped to −1…1 by the released code, so that only the upper half of its planes is used.
            let point = [share(0), share(1), share(2), time];
            for (planes, rows) in self.scales.iter().zip(features.chunks_exact_mut(self.channels)) {
                rows.iter_mut().for_each(|row| row[lane] = 1.0);
                for (plane, [column, line]) in planes.iter().zip(PAIRS) {
                    let taps = plane.taps(point[column], point[line]);
                    let area = plane.height * plane.width;
                    for (row, values) in rows.iter_mut().zip(plane.values.chunks_exact(area)) {
                        row[lane] *= taps.iter().map(|&(at, weight)| weight * values[at]).sum::<f32>();
                    }
                }
            }
        }
        features
    }
}

impl Plane {
    /// Bilinear interpolation between −1 (the first value) and 1 (the last), held outside: four places and their weights.
    fn taps(&self, x: f32, y: f32) -> [(usize, f32); 4] {
        let along = |v: f32, size: usize| {
            let last = (size - 1) as f32;
            let place = ((v + 1.0) * 0.5 * last).clamp(0.0, last);
            let place = if place.is_nan() { 0.0 } else { place };
            let low = place as usize;
            (low, (low + 1).min(size - 1), place - low as f32)
        };
        let ((x0, x1, wx), (y0, y1, wy)) = (along(x, self.width), along(y, self.height));
        let at = |y: usize, x: usize| y * self.width + x;
        [
            (at(y0, x0), (1.0 - wy) * (1.0 - wx)),
            (at(y0, x1), (1.0 - wy) * wx),
            (at(y1, x0), wy * (1.0 - wx)),
            (at(y1, x1), wy * wx),
        ]
    }
}

impl Deformation for Field {
    fn place(&self, g: &Gaussians, time: f64) -> Vec<Placed> {
        let chunks = g.mean.par_chunks(LANES).enumerate();
        let placed = |(chunk, means): (usize, &[[f32; 3]])| {
            let hidden = relu(dense(&self.feature, &self.features(means, time as f32)));
            let (position, scaling, rotation) =
                (self.position.apply(&hidden), self.scaling.apply(&hidden), self.rotation.apply(&hidden));
            let one = |lane: usize| {
                let i = chunk * LANES + lane;
                let raw: [f32; 4] = std::array::from_fn(|c| g.rotation[i][c] + rotation[c][lane]);
                Placed {
                    mean: std::array::from_fn(|a| g.mean[i][a] + position[a][lane]),
                    rotation: unit(raw),
                    log_scale: std::array::from_fn(|a| g.log_scale[i][a] + scaling[a][lane]),
                }
            };
            (0..means.len()).map(one).collect::<Vec<_>>()
        };
        chunks.flat_map_iter(placed).collect()
    }
}
