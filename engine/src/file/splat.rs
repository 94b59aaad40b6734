//! `.splat` (antimatter15's web viewer): 32 bytes per Gaussian, no header, no view-dependent colour.
//!
//! Per Gaussian, little-endian: centre 3·f32; standard deviations 3·f32; red, green, blue, opacity 4·u8 (colour
//! 0.5 + `SH_C0`·coefficient, opacity after the sigmoid, both ·255); quaternion w,x,y,z 4·u8 ((q + 1)·128).

use std::path::Path;

use rayon::prelude::*;

use super::check;
use super::codec::{SH_C0, allocate, check_memory, f32_at, logit, scene_bytes, sigmoid, to_byte, unit};
use super::durable::write_atomic;
use crate::error::{Error, Result};
use crate::scene::Gaussians;

/// Bytes of a Gaussian.
pub const ROW: usize = 32;
/// Smallest standard deviation that is taken from a file; the format has no sign or zero for "none".
const SCALE_MIN: f32 = 1.0e-9;

/// Whether bytes look like this format, which has no magic: whole rows, finite centres, standard deviations ≥ 0, in the
/// first rows of the file.
pub(crate) fn is_plausible(head: &[u8], file_bytes: u64) -> bool {
    let row = |row: &[u8]| {
        let numbers: [f32; 6] = std::array::from_fn(|i| f32_at(row, i));
        numbers.iter().all(|v| v.is_finite() && v.abs() < 1.0e9) && numbers[3..].iter().all(|&s| s >= 0.0)
    };
    file_bytes > 0 && file_bytes.is_multiple_of(ROW as u64) && head.chunks_exact(ROW).all(row)
}

/// Reads a `.splat`. Values are not judged here (see [`crate::file::load`]).
///
/// # Errors
/// [`Error::Corrupt`] when the file does not consist of whole rows.
pub fn parse(bytes: &[u8], path: &Path) -> Result<Gaussians> {
    if !bytes.len().is_multiple_of(ROW) {
        let at = format!("byte {}", bytes.len() - bytes.len() % ROW);
        let found = format!("{} bytes to the end of the file", bytes.len() % ROW);
        return Err(Error::corrupt(path, at, found, format!("rows of {ROW} bytes")));
    }
    let n = bytes.len() / ROW;
    check_memory(path, "its Gaussians", scene_bytes(n as u64, 0), bytes.len() as u64)?;
    let mut out = allocate(n, 0);
    (
        bytes.par_chunks_exact(ROW),
        out.mean.par_iter_mut(),
        out.log_scale.par_iter_mut(),
        out.rotation.par_iter_mut(),
        out.opacity_logit.par_iter_mut(),
        out.sh.par_chunks_exact_mut(3),
    )
        .into_par_iter()
        .for_each(|(row, mean, log_scale, rotation, opacity, sh)| {
            *mean = std::array::from_fn(|i| f32_at(row, i));
            *log_scale = std::array::from_fn(|i| log_scale_of(f32_at(row, 3 + i)));
            *rotation = std::array::from_fn(|i| (f32::from(row[28 + i]) - 128.0) / 128.0);
            *opacity = logit(f64::from(row[27]) / 255.0);
            sh.iter_mut().zip(&row[24..27]).for_each(|(c, &b)| *c = ((f64::from(b) / 255.0 - 0.5) / SH_C0) as f32);
        });
    Ok(out)
}

/// NaN stays NaN, so that the Gaussian is rejected.
fn log_scale_of(scale: f32) -> f32 {
    if scale.is_nan() { scale } else { scale.max(SCALE_MIN).ln() }
}

/// Writes a `.splat`, durably. SH above degree 0 is left out; colours are clamped to [0, 1].
///
/// # Errors
/// [`Error::Usage`] when the arrays' lengths disagree; [`Error::Io`].
pub fn write(path: &Path, gaussians: &Gaussians) -> Result<()> {
    check::gaussians(gaussians).map_err(|problem| problem.usage(path))?;
    write_atomic(path, |out| (0..gaussians.len()).try_for_each(|i| out.write_all(&row(gaussians, i))))
}

fn row(g: &Gaussians, i: usize) -> [u8; ROW] {
    let mut row = [0; ROW];
    let sh = &g.sh[i * g.sh_coefficients() * 3..];
    let numbers = g.mean[i].iter().copied().chain(g.log_scale[i].iter().map(|s| s.exp()));
    for (place, value) in row.chunks_exact_mut(4).zip(numbers) {
        place.copy_from_slice(&value.to_le_bytes());
    }
    for c in 0..3 {
        row[24 + c] = to_byte(0.5 + SH_C0 * f64::from(sh[c]));
    }
    row[27] = to_byte(sigmoid(g.opacity_logit[i]));
    for (place, q) in row[28..].iter_mut().zip(unit(g.rotation[i])) {
        *place = (q * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8;
    }
    row
}
