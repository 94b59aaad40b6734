//! Pictures to [`Gaussians`].

use std::path::Path;

use rayon::prelude::*;

use super::meta::{self, Meta, Values, corrupt};
use super::picture::{self, Picture};
use super::{META, unstretch};
use crate::error::{Error, Result};
use crate::file::archive::Files;
use crate::file::codec::{allocate, check_memory, from_smallest_three, logit, scene_bytes};
use crate::scene::Gaussians;

/// Largest `meta.json`, bytes.
const MAX_META: u64 = 16 << 20;
/// Rows of the SH palette in one line of pixels.
pub(super) const PALETTE_WIDTH: usize = 64;

/// Pixels that a picture may have beside those in use.
const MAX_EMPTY: u64 = 1 << 20;
/// Largest palette, pixels: 65,536 rows of SH degree 3.
const MAX_PALETTE: u64 = 65_536 * 15;

/// View-dependent colour.
struct Palette {
    centroids: Picture,
    labels: Picture,
    values: Values,
    /// SH coefficients per row, without degree 0.
    coefficients: usize,
}

/// The description in a folder within (empty, or with a slash at its end).
pub(super) fn description(files: &mut Files<'_>, folder: &str, path: &Path) -> Result<Meta> {
    let place = if folder.is_empty() { path.to_path_buf() } else { path.join(folder) };
    Ok(meta::parse(&files.read(&format!("{folder}{META}"), MAX_META)?, &place)?.in_folder(folder))
}

/// Bytes in memory beside the Gaussians while they are read: up to six pictures and the decoder's copy of one.
pub(super) fn picture_bytes(n: u64) -> u128 {
    28 * u128::from(n)
}

/// Reads what is in a folder within (empty, or with a slash at its end).
pub(super) fn read(files: &mut Files<'_>, folder: &str, path: &Path) -> Result<Gaussians> {
    let meta = description(files, folder, path)?;
    let n = meta.gaussians(path)?;
    let need = scene_bytes(n as u64, 3) + picture_bytes(n as u64);
    check_memory(path, "its Gaussians", need, files.total_bytes(&meta.names()))?;
    let most = 2 * n as u64 + MAX_EMPTY;
    let mut picture = |part: &meta::Part, name: &str, i: usize| -> Result<Picture> {
        let picture = picture::read(files, part.file(name, i, path)?, most, path)?;
        if picture.len() < n {
            let found = format!("{} pixels", picture.len());
            return Err(Error::corrupt(
                path,
                part.file(name, i, path)?,
                found,
                format!("at least {n}, one per Gaussian"),
            ));
        }
        Ok(picture)
    };
    let low = picture(&meta.means, "means", 0)?;
    let high = picture(&meta.means, "means", 1)?;
    let quats = picture(&meta.quats, "quats", 0)?;
    let scales = picture(&meta.scales, "scales", 0)?;
    let sh0 = picture(&meta.sh0, "sh0", 0)?;
    let labels = meta.sh_n.as_ref().map(|part| picture(part, "shN", 1)).transpose()?;
    let palette = palette(&meta, labels, n, files, path)?;
    let degree =
        palette.as_ref().map_or(0, |p| [3, 8, 15].iter().position(|&k| k == p.coefficients).map_or(0, |d| d + 1));
    let ends = meta.means.ends("means", 3, path)?;
    let scale_values = meta.scales.values("scales", meta.version, 3, path)?;
    let sh0_values = meta.sh0.values("sh0", meta.version, 4, path)?;
    if let Some(i) = (0..n).find(|&i| quats.pixel(i)[3] < 252) {
        let found = format!("alpha {} at pixel {i}", quats.pixel(i)[3]);
        return Err(Error::corrupt(path, meta.quats.file("quats", 0, path)?, found, "252 to 255"));
    }

    let mut out = allocate(n, degree as u32);
    let k3 = out.sh_coefficients() * 3;
    (
        out.mean.par_iter_mut(),
        out.log_scale.par_iter_mut(),
        out.rotation.par_iter_mut(),
        out.opacity_logit.par_iter_mut(),
        out.sh.par_chunks_exact_mut(k3),
    )
        .into_par_iter()
        .enumerate()
        .for_each(|(i, (mean, log_scale, rotation, opacity, sh))| {
            let (l, u) = (low.pixel(i), high.pixel(i));
            *mean = std::array::from_fn(|a| {
                let share = f64::from(u32::from(u[a]) << 8 | u32::from(l[a])) / 65535.0;
                unstretch(ends[a][0] + (ends[a][1] - ends[a][0]) * share) as f32
            });
            let scale = scales.pixel(i);
            *log_scale = std::array::from_fn(|a| scale_values.of(scale[a], a));
            let q = quats.pixel(i);
            let part = |c: usize| (f64::from(q[c]) / 255.0 - 0.5) * std::f64::consts::SQRT_2;
            *rotation = from_smallest_three(usize::from(q[3] - 252), [part(0), part(1), part(2)]);
            let color = sh0.pixel(i);
            *opacity = match &sh0_values {
                Values::Codebook(_) => logit(f64::from(color[3]) / 255.0),
                between @ Values::Between(_) => between.of(color[3], 3),
            };
            sh.iter_mut().take(3).enumerate().for_each(|(c, v)| *v = sh0_values.of(color[c], c));
            if let Some(p) = &palette {
                let first = p.first(p.label(i));
                for (k, coefficient) in sh[3..].chunks_exact_mut(3).enumerate() {
                    let pixel = p.centroids.pixel(first + k);
                    coefficient.iter_mut().enumerate().for_each(|(c, v)| *v = p.values.of(pixel[c], c));
                }
            }
        });
    Ok(out)
}

impl Palette {
    fn label(&self, i: usize) -> usize {
        let pixel = self.labels.pixel(i);
        usize::from(pixel[0]) | usize::from(pixel[1]) << 8
    }

    /// The first pixel of a palette row.
    fn first(&self, label: usize) -> usize {
        label / PALETTE_WIDTH * self.centroids.width + label % PALETTE_WIDTH * self.coefficients
    }
}

fn palette(
    meta: &Meta,
    labels: Option<Picture>,
    n: usize,
    files: &mut Files<'_>,
    path: &Path,
) -> Result<Option<Palette>> {
    let (Some(part), Some(labels)) = (&meta.sh_n, labels) else { return Ok(None) };
    let name = part.file("shN", 0, path)?;
    let centroids = picture::read(files, name, MAX_PALETTE, path)?;
    let coefficients = centroids.width / PALETTE_WIDTH;
    if centroids.width % PALETTE_WIDTH != 0 || ![3, 8, 15].contains(&coefficients) {
        let expected = "64·3, 64·8 or 64·15 pixels a line (SH degree 1, 2 or 3)";
        return Err(Error::corrupt(path, name, format!("{} pixels a line", centroids.width), expected));
    }
    if part.bands.is_some_and(|bands| [3, 8, 15].get(bands.wrapping_sub(1) as usize) != Some(&coefficients)) {
        let found = format!("{:?} for {coefficients} coefficients", part.bands);
        return Err(corrupt(path, "shN.bands", found, "the SH degree of the palette"));
    }
    let palette = Palette { values: part.values("shN", meta.version, 3, path)?, centroids, labels, coefficients };
    let rows = palette.centroids.len() / palette.centroids.width * PALETTE_WIDTH;
    match (0..n).map(|i| palette.label(i)).enumerate().find(|&(_, label)| label >= rows) {
        None => Ok(Some(palette)),
        Some((i, label)) => {
            let found = format!("label {label} at pixel {i}");
            Err(Error::corrupt(path, part.file("shN", 1, path)?, found, format!("below {rows}, the palette's rows")))
        }
    }
}
