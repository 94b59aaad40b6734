//! Reads `.spz` (layout: [`super`]).

use std::io::Read;
use std::path::Path;

use glam::DAffine3;
use rayon::prelude::*;

use super::extensions::{self, Extensions, MAX_EXTENSIONS};
use super::{ANTIALIASED, COLOR_SCALE, GZIP, HAS_EXTENSIONS, HEADER, HEADER_4, MAGIC, PART_MAX};
use crate::error::{Error, Result};
use crate::file::affine;
use crate::file::check::MAX_SH_DEGREE;
use crate::file::codec::{Cursor, allocate, check_memory, from_smallest_three, logit, scene_bytes, u32_at};
use crate::scene::Gaussians;

/// What every version says first.
struct Header {
    version: u32,
    count: usize,
    degree: u32,
    fractional_bits: u8,
    flags: u8,
}

/// The attributes' bytes.
struct Attributes<'a> {
    mean: &'a [u8],
    opacity: &'a [u8],
    color: &'a [u8],
    log_scale: &'a [u8],
    rotation: &'a [u8],
    sh: &'a [u8],
}

/// Reads a `.spz` of version 2, 3 or 4, with warnings. Values are not judged here (see [`crate::file::load`]).
///
/// # Errors
/// [`Error::Corrupt`], [`Error::Limit`] when it would unpack to more than a file of its size can hold.
pub fn parse(bytes: &[u8], path: &Path) -> Result<(Gaussians, Vec<String>)> {
    if bytes.starts_with(&MAGIC) { version_4(bytes, path) } else { gzip(bytes, path) }
}

impl Header {
    fn parse(cursor: &mut Cursor<'_>, versions: std::ops::RangeInclusive<u32>) -> Result<Self> {
        let magic = cursor.take(4, "magic")?;
        if magic != MAGIC {
            return Err(cursor.corrupt(4, "magic", format!("{:?}", magic.escape_ascii().to_string()), "`NGSP`"));
        }
        let version = cursor.u32("version")?;
        if !versions.contains(&version) {
            let expected = format!("{} to {}", versions.start(), versions.end());
            return Err(cursor.corrupt(4, "version", version.to_string(), expected));
        }
        let count = cursor.u32("number of Gaussians")? as usize;
        let degree = u32::from(cursor.u8("SH degree")?);
        if degree > 4 {
            return Err(cursor.corrupt(1, "SH degree", degree.to_string(), "0 to 4"));
        }
        let fractional_bits = cursor.u8("fractional bits")?;
        if fractional_bits > 24 {
            return Err(cursor.corrupt(1, "fractional bits", fractional_bits.to_string(), "0 to 24"));
        }
        let flags = cursor.u8("flags")?;
        Ok(Self { version, count, degree, fractional_bits, flags })
    }

    /// Bytes of each attribute, in the file's order.
    fn sizes(&self) -> [usize; 6] {
        let rotation = if self.version == 2 { 3 } else { 4 };
        let sh = 3 * ((self.degree + 1) * (self.degree + 1) - 1) as usize;
        [9, 1, 3, 3, rotation, sh].map(|bytes| bytes * self.count)
    }

    fn check_memory(&self, path: &Path, file_bytes: usize) -> Result<()> {
        let unpacked: u128 = self.sizes().iter().map(|&s| s as u128).sum();
        let scene = scene_bytes(self.count as u64, self.degree.min(MAX_SH_DEGREE));
        check_memory(path, "its Gaussians", unpacked + scene, file_bytes as u64)
    }
}

fn gzip(bytes: &[u8], path: &Path) -> Result<(Gaussians, Vec<String>)> {
    if !bytes.starts_with(&GZIP) {
        let head = &bytes[..bytes.len().min(4)];
        return Err(Error::corrupt(path, "byte 0", format!("{:?}", head.escape_ascii().to_string()), "gzip or `NGSP`"));
    }
    let damaged = |e: std::io::Error| Error::corrupt(path, "gzip stream", e.to_string(), "an undamaged one");
    let mut stream = flate2::bufread::GzDecoder::new(bytes);
    let mut head = Vec::new();
    stream.by_ref().take(HEADER as u64).read_to_end(&mut head).map_err(damaged)?;
    let mut cursor = Cursor { unit: "the unpacked data, byte", ..Cursor::new(&head, path) };
    let header = Header::parse(&mut cursor, 2..=3)?;
    cursor.take(1, "reserved")?;
    header.check_memory(path, bytes.len())?;
    let body_bytes: usize = header.sizes().iter().sum();
    let mut body = Vec::new();
    let has_extensions = header.flags & HAS_EXTENSIONS != 0;
    let most = body_bytes + if has_extensions { MAX_EXTENSIONS } else { 0 };
    // One byte more than there should be: too much is an error, and reading on also checks the stream's own checksum.
    stream.take(most as u64 + 1).read_to_end(&mut body).map_err(damaged)?;
    if body.len() > most && has_extensions {
        let what = format!("{}: bytes of extension records", path.display());
        let need = (body.len() - body_bytes) as u128;
        return Err(Error::Limit { what, need, have: MAX_EXTENSIONS as u128 });
    }
    if body.len() < body_bytes || body.len() > most {
        let found = if body.len() < body_bytes { body.len().to_string() } else { format!("more than {body_bytes}") };
        let expected = format!("{body_bytes}, for {} Gaussians of SH degree {}", header.count, header.degree);
        return Err(Error::corrupt(path, "unpacked data", format!("{found} bytes after the header"), expected));
    }
    let mut cursor = Cursor { unit: "the unpacked data, byte", ..Cursor::new(&body, path) };
    let [mean, opacity, color, log_scale, rotation, sh] = header.sizes();
    let attributes = Attributes {
        mean: cursor.take(mean, "centres")?,
        opacity: cursor.take(opacity, "opacities")?,
        color: cursor.take(color, "colours")?,
        log_scale: cursor.take(log_scale, "scales")?,
        rotation: cursor.take(rotation, "rotations")?,
        sh: cursor.take(sh, "SH coefficients")?,
    };
    let extensions = if has_extensions { extensions::after_attributes(&mut cursor)? } else { Extensions::default() };
    Ok((decode(&header, &attributes, &extensions), warnings(&header, extensions, path)))
}

fn version_4(bytes: &[u8], path: &Path) -> Result<(Gaussians, Vec<String>)> {
    let mut cursor = Cursor::new(bytes, path);
    let header = Header::parse(&mut cursor, 4..=4)?;
    let streams = usize::from(cursor.u8("number of streams")?);
    let table = cursor.u32("offset of the table")? as usize;
    header.check_memory(path, bytes.len())?;
    // Empty attributes have no stream.
    let sizes = header.sizes();
    let expected = sizes.iter().filter(|&&s| s > 0).count();
    if streams != expected && streams != 6 {
        return Err(cursor.corrupt(5, "number of streams", streams.to_string(), expected.to_string()));
    }
    if table < HEADER_4 {
        return Err(cursor.corrupt(4, "offset of the table", table.to_string(), format!("at least {HEADER_4}")));
    }
    let has_extensions = header.flags & HAS_EXTENSIONS != 0;
    let extensions = if has_extensions { extensions::before_table(bytes, table, path)? } else { Extensions::default() };
    cursor.at = table.min(bytes.len());
    let mut packed = Vec::with_capacity(streams);
    for size in sizes.iter().filter(|&&s| s > 0 || streams == 6) {
        let length = cursor.u64("packed size")?;
        let unpacked = cursor.u64("unpacked size")?;
        if unpacked != *size as u64 {
            return Err(cursor.corrupt(8, "unpacked size", unpacked.to_string(), size.to_string()));
        }
        packed.push(usize::try_from(length).unwrap_or(usize::MAX));
    }
    let mut packed = packed.into_iter();
    let mut parts: [Vec<u8>; 6] = Default::default();
    for (part, &size) in parts.iter_mut().zip(&sizes) {
        if size > 0 || streams == 6 {
            let at = cursor.at;
            let stream = cursor.take(packed.next().unwrap_or(0), "zstd stream")?;
            *part = if size == 0 { Vec::new() } else { unzstd(stream, size, at, path)? };
        }
    }
    let [mean, opacity, color, log_scale, rotation, sh] = &parts;
    let attributes = Attributes { mean, opacity, color, log_scale, rotation, sh };
    Ok((decode(&header, &attributes, &extensions), warnings(&header, extensions, path)))
}

fn unzstd(stream: &[u8], size: usize, at: usize, path: &Path) -> Result<Vec<u8>> {
    let corrupt = |found: String| {
        let expected = format!("a zstd stream of {size} bytes");
        Error::corrupt(path, format!("byte {at} (zstd stream)"), found, expected)
    };
    let mut decoder = ruzstd::decoding::StreamingDecoder::new(stream).map_err(|e| corrupt(e.to_string()))?;
    let mut unpacked = Vec::new();
    decoder.by_ref().take(size as u64 + 1).read_to_end(&mut unpacked).map_err(|e| corrupt(e.to_string()))?;
    if unpacked.len() == size { Ok(unpacked) } else { Err(corrupt(format!("{} bytes or more", unpacked.len()))) }
}

fn warnings(header: &Header, extensions: Extensions, path: &Path) -> Vec<String> {
    let name = path.display();
    let mut warnings = Vec::new();
    warnings.extend(extensions.left_out.iter().map(|what| format!("{name}: {what} is left out")));
    if header.degree > MAX_SH_DEGREE {
        warnings.push(format!("{name}: SH degree {} is left out above {MAX_SH_DEGREE}", header.degree));
    }
    warnings
}

fn decode(header: &Header, from: &Attributes<'_>, extensions: &Extensions) -> Gaussians {
    let mut out = allocate(header.count, header.degree.min(MAX_SH_DEGREE));
    out.antialiased = header.flags & ANTIALIASED != 0;
    let k3 = out.sh_coefficients() * 3;
    let stored = 3 * ((header.degree + 1) * (header.degree + 1) - 1) as usize;
    let unit = 1.0 / f64::from(1u32 << header.fractional_bits);
    let bytes = if header.version == 2 { 3 } else { 4 };
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
            *mean = std::array::from_fn(|a| (f64::from(i24(&from.mean[9 * i + 3 * a..])) * unit) as f32);
            *opacity = logit(f64::from(from.opacity[i]) / 255.0);
            *log_scale = std::array::from_fn(|a| f32::from(from.log_scale[3 * i + a]) / 16.0 - 10.0);
            let stored_rotation = &from.rotation[bytes * i..bytes * (i + 1)];
            *rotation = if bytes == 3 { first_three(stored_rotation) } else { largest_of_four(stored_rotation) };
            for (c, value) in sh.iter_mut().take(3).enumerate() {
                *value = ((f64::from(from.color[3 * i + c]) / 255.0 - 0.5) / COLOR_SCALE) as f32;
            }
            for (value, &byte) in sh[3..].iter_mut().zip(&from.sh[stored * i..]) {
                *value = (f32::from(byte) - 128.0) / 128.0;
            }
        });
    affine::transform(&mut out, &DAffine3::from_mat3(extensions.axes));
    out
}

/// A 24-bit integer with sign.
fn i24(bytes: &[u8]) -> i32 {
    i32::from_le_bytes([0, bytes[0], bytes[1], bytes[2]]) >> 8
}

/// Version 2: x, y, z, with w ≥ 0.
fn first_three(bytes: &[u8]) -> [f32; 4] {
    let part = |i: usize| f64::from(bytes[i]) / 127.5 - 1.0;
    from_smallest_three(0, [part(0), part(1), part(2)])
}

/// Versions 3 and 4: the index of the largest of x,y,z,w in the top 2 bits; the others below, the last lowest, each a sign
/// above 9 bits.
fn largest_of_four(bytes: &[u8]) -> [f32; 4] {
    let packed = u32_at(bytes, 0);
    let part = |slot: u32| {
        let bits = packed >> (10 * slot);
        let magnitude = std::f64::consts::FRAC_1_SQRT_2 * f64::from(bits & 511) / PART_MAX;
        if bits & 512 != 0 { -magnitude } else { magnitude }
    };
    let [x, y, z, w] = from_smallest_three((packed >> 30) as usize, [part(2), part(1), part(0)]);
    [w, x, y, z]
}
