//! Writes `.spz` (layout: [`super`]).

use std::io::Write;
use std::path::Path;

use super::{ANTIALIASED, COLOR_SCALE, HEADER_4, MAGIC, PART_MAX, flip_axes};
use crate::error::{Error, Result};
use crate::file::check;
use crate::file::codec::{morton_order, sigmoid, smallest_three, to_byte, unit};
use crate::file::durable::write_atomic;
use crate::scene::Gaussians;

/// Version to write.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Version {
    /// Version 3, gzip: what most viewers read.
    #[default]
    Three,
    /// Version 4, zstd.
    Four,
}

/// Most bits after the binary point: finer than f32 near 1 would gain nothing and cost bytes.
const MAX_FRACTIONAL_BITS: u8 = 20;
/// Largest 24-bit integer.
const MAX_I24: f64 = 8_388_607.0;

/// Writes a `.spz`, durably, in Morton order. Centres get as many bits after the binary point as their extent leaves.
///
/// # Errors
/// [`Error::Usage`] when the arrays' lengths disagree, [`Error::Limit`] for coordinates beyond 24 bits, [`Error::Io`].
pub fn write(path: &Path, gaussians: &Gaussians, version: Version) -> Result<()> {
    check::gaussians(gaussians).map_err(|problem| problem.usage(path))?;
    let mut g = gaussians.selected(&morton_order(&gaussians.mean));
    flip_axes(&mut g);
    let bits = fractional_bits(&g, path)?;
    let attributes = attributes(&g, bits);
    let mut header = Vec::with_capacity(HEADER_4);
    header.extend(MAGIC);
    header.extend((if version == Version::Three { 3u32 } else { 4 }).to_le_bytes());
    header.extend((g.len() as u32).to_le_bytes());
    header.extend([g.sh_degree as u8, bits, if g.antialiased { ANTIALIASED } else { 0 }]);
    match version {
        Version::Three => write_atomic(path, |out| {
            header.push(0);
            let mut gzip = flate2::write::GzEncoder::new(out, flate2::Compression::default());
            gzip.write_all(&header)?;
            attributes.iter().try_for_each(|a| gzip.write_all(a))?;
            gzip.finish().map(|_| ())
        }),
        Version::Four => {
            let level = ruzstd::encoding::CompressionLevel::Fastest;
            let present: Vec<&Vec<u8>> = attributes.iter().filter(|a| !a.is_empty()).collect();
            let streams: Vec<Vec<u8>> =
                present.iter().map(|a| ruzstd::encoding::compress_to_vec(a.as_slice(), level)).collect();
            header.push(streams.len() as u8);
            header.extend((HEADER_4 as u32).to_le_bytes());
            header.resize(HEADER_4, 0);
            for (stream, attribute) in streams.iter().zip(present) {
                header.extend((stream.len() as u64).to_le_bytes());
                header.extend((attribute.len() as u64).to_le_bytes());
            }
            write_atomic(path, |out| {
                out.write_all(&header)?;
                streams.iter().try_for_each(|s| out.write_all(s))
            })
        }
    }
}

fn fractional_bits(g: &Gaussians, path: &Path) -> Result<u8> {
    let largest = g.mean.as_flattened().iter().fold(0.0, |m, v| f64::max(m, f64::from(v.abs())));
    let fits = |bits: &u8| largest * f64::from(1u32 << bits) <= MAX_I24;
    (0..=MAX_FRACTIONAL_BITS).rev().find(fits).ok_or_else(|| Error::Limit {
        what: format!("writing {}: largest coordinate", path.display()),
        need: largest as u128,
        have: MAX_I24 as u128,
    })
}

fn attributes(g: &Gaussians, bits: u8) -> [Vec<u8>; 6] {
    let k3 = g.sh_coefficients() * 3;
    let scale = f64::from(1u32 << bits);
    let fixed = |v: &f32| {
        let [a, b, c, _] = ((f64::from(*v) * scale).round() as i32).to_le_bytes();
        [a, b, c]
    };
    let first = |i: usize| &g.sh[i * k3..i * k3 + 3];
    [
        g.mean.as_flattened().iter().flat_map(fixed).collect(),
        g.opacity_logit.iter().map(|&o| to_byte(sigmoid(o))).collect(),
        (0..g.len()).flat_map(first).map(|&c| to_byte(0.5 + COLOR_SCALE * f64::from(c))).collect(),
        g.log_scale.as_flattened().iter().map(|s| ((s + 10.0) * 16.0).round().clamp(0.0, 255.0) as u8).collect(),
        g.rotation.iter().flat_map(|&q| rotation(unit(q)).to_le_bytes()).collect(),
        g.sh.chunks_exact(k3)
            .flat_map(|sh| sh[3..].iter().map(|v| (v * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8))
            .collect(),
    ]
}

fn rotation([w, x, y, z]: [f64; 4]) -> u32 {
    let (largest, parts) = smallest_three([x, y, z, w]);
    let pack = |v: f64| {
        let magnitude = (v.abs() * std::f64::consts::SQRT_2 * PART_MAX).round().min(PART_MAX) as u32;
        magnitude | if v < 0.0 { 512 } else { 0 }
    };
    parts.iter().fold(largest as u32, |packed, &v| packed << 10 | pack(v))
}
