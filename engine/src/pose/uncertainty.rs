//! How well photos fix each superpoint.
//!
//! With J the derivative of all pixels by the six numbers of a superpoint and s² the mean squared difference that is left,
//! its covariance with the others held is s² (JᵀJ)⁻¹ (Gauss–Newton). JᵀJ is the mean of ggᵀ over gradients g = Jᵀv of
//! random images v of independent ±1 (Hutchinson 1990): a backward pass gives those of all superpoints at once. Differences of
//! neighbouring pixels are taken as independent.

use glam::DVec3;
use serde::Serialize;

use super::bodies::{Bodies, Stand};
use super::sight::Sight;
use crate::error::Result;
use crate::reference::Pose;
use crate::scene::synthetic::Random;
use crate::train::photo_loss::{PhotoLoss, Twist};

/// Change of the image, summed over its values, that a shift by a pixel must make for a superpoint to count as seen: a step of
/// 8 bits.
const LEAST_CHANGE: f64 = 1.0 / 255.0;

/// What photos say of one superpoint.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Uncertainty {
    /// Whether any pixel changes with it. Where none does it has followed its neighbours.
    pub seen: bool,
    /// Standard deviation of its centre across the direction of view of the first photo, the larger of two, pixels.
    pub across_px: Option<f64>,
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
    let mut information = vec![[[0.0; 6]; 6]; stands.len()];
    let mut random = Random::new(0x706f_7365);
    let axes = first.camera.rotation;
    let units: Vec<[f64; 2]> = stands
        .iter()
        .zip(&bodies.reach)
        .map(|(stand, reach)| {
            let pixel = first.unit_at(0, stand.place);
            [pixel / reach, pixel]
        })
        .collect();
    for sight in sights {
        let camera = sight.camera_at(0);
        let values = 4 * camera.width as usize * camera.height as usize;
        for _ in 0..probes {
            let image: Vec<f32> = (0..values).map(|k| if k % 4 == 3 { 0.0 } else { sign(&mut random) }).collect();
            let found = loss.pull_back(&image, &camera, poses, false)?;
            for ((sum, twist), (stand, unit)) in information.iter_mut().zip(&found.poses).zip(stands.iter().zip(&units))
            {
                add_square(sum, &in_pixels(twist.about(stand.place), axes, unit), f64::from(probes));
            }
        }
    }
    let variance = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    Ok(information.iter().zip(&units).map(|(information, unit)| of(information, variance, *unit)).collect())
}

fn sign(random: &mut Random) -> f32 {
    if random.bits() >> 63 == 0 { 1.0 } else { -1.0 }
}

/// Gradient by turn and shift along the camera's axes, in units that move the superpoint's rim by a pixel.
fn in_pixels(twist: Twist, axes: glam::DMat3, [turn, shift]: &[f64; 2]) -> [f64; 6] {
    let (r, t): (DVec3, DVec3) = (axes * twist.rotation * *turn, axes * twist.translation * *shift);
    [r.x, r.y, r.z, t.x, t.y, t.z]
}

fn add_square(sum: &mut [[f64; 6]; 6], g: &[f64; 6], count: f64) {
    for (row, a) in sum.iter_mut().zip(g) {
        row.iter_mut().zip(g).for_each(|(value, b)| *value += a * b / count);
    }
}

fn of(information: &[[f64; 6]; 6], variance: f64, [turn, pixel]: [f64; 2]) -> Uncertainty {
    let across = 0.5 * (information[3][3] + information[4][4]);
    if across.is_nan() || across < LEAST_CHANGE.powi(2) {
        return Uncertainty::default();
    }
    let Some(inverse) = inverse_diagonal(information) else { return Uncertainty { seen: true, ..Default::default() } };
    let deviation = |k: usize| (variance * inverse[k]).sqrt();
    Uncertainty {
        seen: true,
        across_px: Some(deviation(3).max(deviation(4))),
        along: Some(deviation(5) * pixel),
        degrees: Some([0, 1, 2].map(deviation).into_iter().fold(0.0, f64::max) * turn.to_degrees()),
    }
}

/// Diagonal of the inverse of a positive matrix, by Cholesky; what is nearly 0 counts as a billionth of the largest.
fn inverse_diagonal(matrix: &[[f64; 6]; 6]) -> Option<[f64; 6]> {
    let largest = (0..6).map(|k| matrix[k][k]).fold(0.0, f64::max);
    let mut l = [[0.0; 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let ridge = if i == j { 1e-9 * largest } else { 0.0 };
            let rest = matrix[i][j] + ridge - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = if i == j { rest.max(1e-12 * largest).sqrt() } else { rest / l[j][j] };
        }
    }
    // Columns of the inverse of L: the diagonal of (LLᵀ)⁻¹ is the sum of their squares.
    let column = |c: usize| {
        let mut x = [0.0; 6];
        for i in c..6 {
            let one = if i == c { 1.0 } else { 0.0 };
            x[i] = (one - (c..i).map(|k| l[i][k] * x[k]).sum::<f64>()) / l[i][i];
        }
        x.iter().map(|v| v * v).sum::<f64>()
    };
    let found = std::array::from_fn(column);
    found.iter().all(|v: &f64| v.is_finite()).then_some(found)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn the_inverse_of_a_known_matrix() {
        let mut matrix = [[0.0; 6]; 6];
        (0..6).for_each(|k| matrix[k][k] = 4.0 + k as f64);
        (matrix[0][5], matrix[5][0]) = (3.0, 3.0);
        let found = inverse_diagonal(&matrix).unwrap();
        assert!((found[0] - 9.0 / 27.0).abs() < 1e-7 && (found[5] - 4.0 / 27.0).abs() < 1e-7, "{found:?}");
        assert!((found[2] - 1.0 / 6.0).abs() < 1e-7);
    }

    #[test]
    fn random_signs_give_the_square_of_a_jacobian() {
        // 40 pixels, 6 numbers.
        let mut random = Random::new(4);
        let jacobian: Vec<[f64; 6]> = (0..40).map(|_| std::array::from_fn(|_| random.normal())).collect();
        let (mut sum, count) = ([[0.0; 6]; 6], 4000);
        for _ in 0..count {
            let mut g = [0.0; 6];
            for row in &jacobian {
                let v = f64::from(sign(&mut random));
                g.iter_mut().zip(row).for_each(|(g, j)| *g += v * j);
            }
            add_square(&mut sum, &g, f64::from(count));
        }
        for i in 0..6 {
            let exact: f64 = jacobian.iter().map(|row| row[i] * row[i]).sum();
            assert!((sum[i][i] / exact - 1.0).abs() < 0.1, "{} {exact}", sum[i][i]);
        }
    }
}
