//! Colours of a selection under an affine map of colour space: c' = M·c + o.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::measure::Touched;
use crate::file::codec::SH_C0;
use crate::scene::Scene;

/// Shares of red, green and blue in brightness (ITU-R BT.709).
const LUMA: DVec3 = DVec3::new(0.2126, 0.7152, 0.0722);

/// c ↦ M·c + o on RGB as stored, in which 1 is white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recolor {
    /// M.
    pub matrix: DMat3,
    /// o.
    pub offset: DVec3,
}

impl Recolor {
    /// Brightness as it is, in the hue of a colour: a grey of brightness 1 becomes `tint`.
    pub fn tint(tint: DVec3) -> Self {
        Self { matrix: DMat3::from_cols(tint * LUMA.x, tint * LUMA.y, tint * LUMA.z), offset: DVec3::ZERO }
    }
}

/// Changes the colours of the Gaussians of `mask`, from wherever they are seen: the matrix on all SH bands, the offset on band 0.
/// A colour stays 0.5 + Σ, clamped at 0 after the map as it was before it.
pub fn recolor(scene: &mut Scene, mask: &[bool], change: &Recolor) -> Touched {
    let Recolor { matrix, offset } = *change;
    let gaussians = mask.iter().filter(|m| **m).count();
    if matrix == DMat3::IDENTITY && offset == DVec3::ZERO {
        return Touched::default();
    }
    let shift = (matrix * DVec3::splat(0.5) - DVec3::splat(0.5) + offset) / SH_C0;
    let width = 3 * scene.gaussians.sh_coefficients();
    let rows = scene.gaussians.sh.par_chunks_exact_mut(width).enumerate().filter(|(i, _)| mask[*i]);
    rows.for_each(|(_, row)| {
        for (k, sh) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let changed = matrix * DVec3::from_array(sh.map(f64::from)) + if k == 0 { shift } else { DVec3::ZERO };
            *sh = changed.as_vec3().to_array();
        }
    });
    Touched { gaussians, ..Touched::default() }
}

/// The colour of band 0 of a Gaussian: what it looks like on average.
pub(crate) fn mean_color(scene: &Scene, i: usize) -> DVec3 {
    let at = i * 3 * scene.gaussians.sh_coefficients();
    DVec3::from_array([0, 1, 2].map(|c| 0.5 + SH_C0 * f64::from(scene.gaussians.sh[at + c])))
}
