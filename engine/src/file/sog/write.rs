//! Writes a zipped SOG, version 2 (layout: [`super`]).

use std::io::{Cursor, Write};
use std::path::Path;

use rayon::prelude::*;
use zip::write::SimpleFileOptions;

use super::meta::{Meta, Numbers, Part};
use super::palette::palette;
use super::read::PALETTE_WIDTH;
use super::{META, picture, stretch};
use crate::error::{Error, Result};
use crate::file::check;
use crate::file::codec::{codebook, morton_order, nearest, sigmoid, smallest_three, to_byte, unit};
use crate::file::durable::write_atomic;
use crate::scene::Gaussians;

/// A file of the archive.
type Entry = (&'static str, Vec<u8>);

/// Writes a zipped SOG (`.sog`) of version 2, durably, in Morton order.
///
/// # Errors
/// [`Error::Usage`] when the arrays' lengths disagree or there is no Gaussian (a picture has pixels), [`Error::Io`].
pub fn write(path: &Path, gaussians: &Gaussians) -> Result<()> {
    check::gaussians(gaussians).map_err(|problem| problem.usage(path))?;
    if gaussians.is_empty() {
        return Err(Error::usage(
            format!("writing {}", path.display()),
            "no Gaussian",
            "at least one: an image has pixels",
        ));
    }
    let g = gaussians.selected(&morton_order(&gaussians.mean));
    let mut entries: Vec<Entry> = Vec::new();
    let meta = Meta {
        version: 2,
        asset: Some(serde_json::json!({ "generator": concat!("spgs ", env!("CARGO_PKG_VERSION")) })),
        count: Some(g.len() as u64),
        means: means(&g, path, &mut entries)?,
        scales: scales(&g, path, &mut entries)?,
        quats: quats(&g, path, &mut entries)?,
        sh0: sh0(&g, path, &mut entries)?,
        sh_n: if g.sh_degree > 0 { Some(sh_n(&g, path, &mut entries)?) } else { None },
    };
    let json = serde_json::to_vec(&meta).map_err(|e| Error::usage("meta.json", e.to_string(), "finite numbers"))?;
    entries.push((META, json));
    let archive = archive(&entries).map_err(|e| Error::io(path, "make a zip archive", std::io::Error::other(e)))?;
    write_atomic(path, |out| out.write_all(&archive))
}

fn archive(entries: &[Entry]) -> zip::result::ZipResult<Vec<u8>> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    // WebP is compressed already; stored entries can be read in place.
    let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, content) in entries {
        zip.start_file(*name, stored)?;
        zip.write_all(content)?;
    }
    Ok(zip.finish()?.into_inner())
}

/// The nearly square picture of `n` pixels, sides multiples of 4 as in other writers.
fn size(n: usize) -> [usize; 2] {
    let width = ((n as f64).sqrt() / 4.0).ceil() as usize * 4;
    [width, (n.div_ceil(width)).div_ceil(4) * 4]
}

/// One pixel per Gaussian.
fn pixels(g: &Gaussians, path: &Path, pixel: impl Fn(usize) -> [u8; 4] + Sync + Send) -> Result<Vec<u8>> {
    let all: Vec<[u8; 4]> = (0..g.len()).into_par_iter().map(pixel).collect();
    picture::encode(path, all.into_flattened(), size(g.len()))
}

fn names(files: &[&str]) -> Vec<String> {
    files.iter().map(|f| (*f).to_owned()).collect()
}

fn means(g: &Gaussians, path: &Path, entries: &mut Vec<Entry>) -> Result<Part> {
    let stretched: Vec<[f64; 3]> = g.mean.iter().map(|m| m.map(|v| stretch(f64::from(v)))).collect();
    let end = |a: usize, pick: fn(f64, f64) -> f64| stretched.iter().map(|m| m[a]).reduce(pick).unwrap_or(0.0);
    let low: [f64; 3] = std::array::from_fn(|a| end(a, f64::min));
    let high: [f64; 3] = std::array::from_fn(|a| end(a, f64::max));
    let code = |i: usize, a: usize| {
        let range = high[a] - low[a];
        let share = if range > 0.0 { (stretched[i][a] - low[a]) / range } else { 0.0 };
        (share * 65535.0).round() as u16
    };
    let byte = |shift: u32| move |v: u16| (v >> shift) as u8;
    for (name, take) in [("means_l.webp", byte(0)), ("means_u.webp", byte(8))] {
        let pixel = |i: usize| [take(code(i, 0)), take(code(i, 1)), take(code(i, 2)), 255];
        entries.push((name, pixels(g, path, pixel)?));
    }
    let files = names(&["means_l.webp", "means_u.webp"]);
    let (mins, maxs) = (Some(Numbers::Many(low.to_vec())), Some(Numbers::Many(high.to_vec())));
    Ok(Part { mins, maxs, files, ..Part::default() })
}

fn scales(g: &Gaussians, path: &Path, entries: &mut Vec<Entry>) -> Result<Part> {
    let book = codebook(g.log_scale.as_flattened().iter().copied());
    let pixel = |i: usize| {
        let [x, y, z] = g.log_scale[i].map(|s| nearest(&book, s));
        [x, y, z, 255]
    };
    entries.push(("scales.webp", pixels(g, path, pixel)?));
    Ok(Part { codebook: Some(book), files: names(&["scales.webp"]), ..Part::default() })
}

fn quats(g: &Gaussians, path: &Path, entries: &mut Vec<Entry>) -> Result<Part> {
    let pixel = |i: usize| {
        let (largest, rest) = smallest_three(unit(g.rotation[i]));
        let [a, b, c] = rest.map(|v| to_byte(v / std::f64::consts::SQRT_2 + 0.5));
        [a, b, c, 252 + largest as u8]
    };
    entries.push(("quats.webp", pixels(g, path, pixel)?));
    Ok(Part { files: names(&["quats.webp"]), ..Part::default() })
}

fn sh0(g: &Gaussians, path: &Path, entries: &mut Vec<Entry>) -> Result<Part> {
    let k3 = g.sh_coefficients() * 3;
    let of = |i: usize| &g.sh[i * k3..i * k3 + 3];
    let book = codebook((0..g.len()).flat_map(of).copied());
    let pixel = |i: usize| {
        let color = of(i);
        let [r, g_, b] = [0, 1, 2].map(|c| nearest(&book, color[c]));
        [r, g_, b, to_byte(sigmoid(g.opacity_logit[i]))]
    };
    entries.push(("sh0.webp", pixels(g, path, pixel)?));
    Ok(Part { codebook: Some(book), files: names(&["sh0.webp"]), ..Part::default() })
}

fn sh_n(g: &Gaussians, path: &Path, entries: &mut Vec<Entry>) -> Result<Part> {
    let k3 = g.sh_coefficients() * 3;
    let width = k3 - 3;
    let rest: Vec<f32> = g.sh.chunks_exact(k3).flat_map(|sh| &sh[3..]).copied().collect();
    let palette = palette(&rest, width);
    let book = codebook(palette.rows.iter().copied());
    let rows = palette.rows.len() / width;
    let bytes: Vec<u8> = palette.rows.par_iter().map(|&v| nearest(&book, v)).collect();
    let centroids: Vec<u8> = bytes.chunks_exact(3).flat_map(|c| [c[0], c[1], c[2], 255]).collect();
    let size = [PALETTE_WIDTH * width / 3, rows.div_ceil(PALETTE_WIDTH)];
    entries.push(("shN_centroids.webp", picture::encode(path, centroids, size)?));
    let pixel = |i: usize| {
        let [low, high] = palette.labels[i].to_le_bytes();
        [low, high, 0, 255]
    };
    entries.push(("shN_labels.webp", pixels(g, path, pixel)?));
    Ok(Part {
        count: Some(rows as u64),
        bands: Some(g.sh_degree),
        codebook: Some(book),
        files: names(&["shN_centroids.webp", "shN_labels.webp"]),
        ..Part::default()
    })
}
