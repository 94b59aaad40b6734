//! How well photos fix each superpoint.
//!
//! With J the derivative of all pixels by the six numbers of a superpoint and s² the mean squared difference that is left,
//! its covariance with the others held is s² (JᵀJ)⁻¹ ([`super::information`]). Differences of neighbouring pixels are taken as
//! independent.

use serde::{Deserialize, Serialize};

use super::bodies::{Bodies, Stand};
use super::information::{Block, information, inverse_diagonal};
use super::sight::Sight;
use crate::error::Result;
use crate::reference::Pose;
use crate::train::photo_loss::PhotoLoss;

/// Change of the image, summed over its values, that a shift by a pixel must make for a superpoint to count as seen: a step of
/// 8 bits.
pub(super) const LEAST_CHANGE: f64 = 1.0 / 255.0;

/// What photos say of one superpoint.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// Whether any pixel changes with it. Where none does it has followed its neighbours.
    pub seen: bool,
    /// Standard deviation of its centre across the direction of view of the first photo, the larger of two, pixels.
    pub across_px: Option<f64>,
    /// The same in world units.
    pub across: Option<f64>,
    /// Along that direction, world units.
    pub along: Option<f64>,
    /// Of its turn, the largest of three axes, degrees.
    pub degrees: Option<f64>,
}

/// Of every superpoint, from `probes` random images per photo and the mean squared error of each photo.
pub(super) fn uncertainties(
    loss: &mut PhotoLoss<'_>,
    bodies: &Bodies,
    stands: &[Stand],
    poses: &[Pose],
    sights: &[Sight],
    errors: &[f64],
    probes: u32,
) -> Result<Vec<Uncertainty>> {
    let Some(first) = sights.first().filter(|_| probes > 0) else { return Ok(Vec::new()) };
    let axes = first.camera.rotation;
    let units: Vec<[f64; 2]> = stands
        .iter()
        .zip(&bodies.reach)
        .map(|(stand, reach)| {
            let pixel = first.unit_at(0, stand.place);
            [pixel / reach, pixel]
        })
        .collect();
    let blocks = information(loss, stands, poses, sights, 0, axes, &units, probes)?;
    let variance = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    Ok(blocks.iter().zip(&units).map(|(block, unit)| of(block, variance, *unit)).collect())
}

fn of(information: &Block, variance: f64, [turn, pixel]: [f64; 2]) -> Uncertainty {
    let across = 0.5 * (information[3][3] + information[4][4]);
    if across.is_nan() || across < LEAST_CHANGE.powi(2) {
        return Uncertainty::default();
    }
    let Some(inverse) = inverse_diagonal(information) else { return Uncertainty { seen: true, ..Default::default() } };
    let deviation = |k: usize| (variance * inverse[k]).sqrt();
    let across = deviation(3).max(deviation(4));
    Uncertainty {
        seen: true,
        across_px: Some(across),
        across: Some(across * pixel),
        along: Some(deviation(5) * pixel),
        degrees: Some([0, 1, 2].map(deviation).into_iter().fold(0.0, f64::max) * turn.to_degrees()),
    }
}
