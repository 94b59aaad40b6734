//! What photos say of each superpoint by itself: the 6×6 block JᵀJ of Gauss–Newton.
//!
//! With J the derivative of all pixels by the six numbers of a superpoint, JᵀJ is the mean of ggᵀ over gradients g = Jᵀv of random
//! images v of independent ±1 (Hutchinson 1990). A backward pass gives those of all superpoints at once. The search takes it for
//! its steps' metric, uncertainties for their inverse.

use glam::{DMat3, DVec3};

use super::bodies::Stand;
use super::sight::Sight;
use crate::error::Result;
use crate::reference::Pose;
use crate::scene::synthetic::Random;
use crate::train::photo_loss::{PhotoLoss, Twist};

/// A symmetric 6×6 matrix: three numbers of turn, three of shift.
pub(super) type Block = [[f64; 6]; 6];

/// Blocks `[M]` from `probes` random images per photo of a size, along `axes`, in units `[turn, shift]` of each superpoint.
#[expect(clippy::too_many_arguments, reason = "all of it is the state of one search")]
pub(super) fn information(
    loss: &mut PhotoLoss<'_>,
    stands: &[Stand],
    poses: &[Pose],
    sights: &[Sight],
    size: usize,
    axes: DMat3,
    units: &[[f64; 2]],
    probes: u32,
) -> Result<Vec<Block>> {
    let mut blocks = vec![Block::default(); stands.len()];
    let mut random = Random::new(0x706f_7365);
    for sight in sights {
        let camera = sight.camera_at(size);
        let values = 4 * camera.width as usize * camera.height as usize;
        for _ in 0..probes {
            let image: Vec<f32> = (0..values).map(|k| if k % 4 == 3 { 0.0 } else { sign(&mut random) }).collect();
            let found = loss.pull_back(&image, &camera, poses, false)?;
            let rows = found.poses.iter().zip(stands.iter().zip(units));
            for (block, (twist, (stand, unit))) in blocks.iter_mut().zip(rows) {
                add_square(block, &scaled(twist.about(stand.place), axes, unit), f64::from(probes));
            }
        }
    }
    Ok(blocks)
}

fn sign(random: &mut Random) -> f32 {
    if random.bits() >> 63 == 0 { 1.0 } else { -1.0 }
}

/// Gradient by turn and shift along axes, in units.
pub(super) fn scaled(twist: Twist, axes: DMat3, [turn, shift]: &[f64; 2]) -> [f64; 6] {
    let (r, t): (DVec3, DVec3) = (axes * twist.rotation * *turn, axes * twist.translation * *shift);
    [r.x, r.y, r.z, t.x, t.y, t.z]
}

fn add_square(sum: &mut Block, g: &[f64; 6], count: f64) {
    for (row, a) in sum.iter_mut().zip(g) {
        row.iter_mut().zip(g).for_each(|(value, b)| *value += a * b / count);
    }
}

/// L of matrix + `ridge`·(largest of the diagonal)·I = LLᵀ; `None` where nothing is known.
pub(super) fn cholesky(matrix: &Block, ridge: f64) -> Option<Block> {
    let largest = (0..6).map(|k| matrix[k][k]).fold(0.0, f64::max);
    if !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    let mut l = Block::default();
    for i in 0..6 {
        for j in 0..=i {
            let added = if i == j { ridge * largest } else { 0.0 };
            let rest = matrix[i][j] + added - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = if i == j { rest.max(1e-12 * largest).sqrt() } else { rest / l[j][j] };
        }
    }
    Some(l)
}

/// L⁻¹x.
pub(super) fn forward(l: &Block, x: [f64; 6]) -> [f64; 6] {
    let mut y = [0.0; 6];
    for i in 0..6 {
        y[i] = (x[i] - (0..i).map(|k| l[i][k] * y[k]).sum::<f64>()) / l[i][i];
    }
    y
}

/// L⁻ᵀx.
pub(super) fn backward(l: &Block, x: [f64; 6]) -> [f64; 6] {
    let mut y = [0.0; 6];
    for i in (0..6).rev() {
        y[i] = (x[i] - (i + 1..6).map(|k| l[k][i] * y[k]).sum::<f64>()) / l[i][i];
    }
    y
}

/// Diagonal of the inverse of a positive matrix; what is nearly 0 counts as a billionth of the largest.
pub(super) fn inverse_diagonal(matrix: &Block) -> Option<[f64; 6]> {
    let l = cholesky(matrix, 1e-9)?;
    // Columns of the inverse of L: the diagonal of (LLᵀ)⁻¹ is the sum of their squares.
    let unit = |c: usize| std::array::from_fn(|i| if i == c { 1.0 } else { 0.0 });
    let column = |c: usize| forward(&l, unit(c)).iter().map(|v| v * v).sum::<f64>();
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
        let l = cholesky(&matrix, 0.0).unwrap();
        let x = [1.0, -2.0, 0.5, 3.0, 0.25, -1.0];
        // matrix · (LLᵀ)⁻¹x = x
        let solved = backward(&l, forward(&l, x));
        for (row, x) in matrix.iter().zip(x) {
            assert!((row.iter().zip(solved).map(|(a, b)| a * b).sum::<f64>() - x).abs() < 1e-12);
        }
        assert!(cholesky(&Block::default(), 1e-3).is_none());
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
