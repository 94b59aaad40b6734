//! Compressed `.ply` of PlayCanvas and SuperSplat: chunks of 256 Gaussians with their bounds, 16 bytes per Gaussian.
//!
//! Element `chunk`: 12 or 18 f32, the bounds of centre, log scale and (18) colour. Element `vertex`: four u32, each field
//! between the chunk's bounds: `packed_position` and `packed_scale` 11+10+11 bits, `packed_rotation` the index of the
//! quaternion's largest part and the others (2+10+10+10 bits, w,x,y,z), `packed_color` 8 bits each for red, green, blue and
//! opacity. Element `sh` (optional): one u8 per coefficient, channel-major, −4 to 4.

use std::path::Path;

use rayon::prelude::*;

use super::header::{Element, Encoding, Header, Number};
use crate::error::{Error, Result};
use crate::file::codec::{SH_C0, allocate, check_memory, from_smallest_three, logit, scene_bytes, u32_at};
use crate::scene::Gaussians;

/// Gaussians per chunk.
pub(super) const CHUNK: usize = 256;
/// Bounds of each chunk, in the file's order: lows of an attribute, then its highs.
pub(super) const BOUNDS: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];
/// Packed fields of a Gaussian.
pub(super) const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Whether a header is of this format.
pub(super) fn is_compressed(header: &Header) -> bool {
    header.elements[header.vertex].properties.iter().any(|p| p.name == PACKED[0])
}

/// Properties that [`body`] does not take, one name each.
pub(super) fn unread(header: &Header) -> Vec<String> {
    let further = |element: &str, known: &[&str]| -> Vec<String> {
        let properties = header.elements.iter().filter(|e| e.name == element).flat_map(|e| &e.properties);
        let names = properties.map(|p| &p.name).filter(|name| !known.contains(&name.as_str()));
        names.map(|name| format!("property `{name}`")).collect()
    };
    [further("chunk", &BOUNDS), further("vertex", &PACKED)].concat()
}

/// One element's rows.
struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    offsets: Vec<usize>,
}

impl Rows<'_> {
    fn f32(&self, row: usize, column: usize) -> f64 {
        f64::from(f32::from_bits(self.u32(row, column)))
    }

    fn u32(&self, row: usize, column: usize) -> u32 {
        u32_at(self.bytes.get(row * self.stride + self.offsets[column]..).unwrap_or(&[]), 0)
    }
}

/// Reads the body that follows `header`.
pub(super) fn body(bytes: &[u8], header: &Header, path: &Path) -> Result<Gaussians> {
    if header.encoding != Encoding::Little {
        return Err(Error::corrupt(path, "header", "another encoding", "binary_little_endian"));
    }
    let vertex = &header.elements[header.vertex];
    let chunk = element(header, "chunk", path)?;
    let has_colors = chunk.properties.iter().any(|p| p.name == BOUNDS[12]);
    let n = vertex.count;
    if chunk.count != n.div_ceil(CHUNK as u64) {
        let expected = format!("{} chunks of {CHUNK} for {n} Gaussians", n.div_ceil(CHUNK as u64));
        return Err(Error::corrupt(path, "header, element `chunk`", chunk.count.to_string(), expected));
    }
    let sh = header.elements.iter().find(|e| e.name == "sh").filter(|e| !e.properties.is_empty());
    let degree = sh_degree(sh, n, path)?;
    check_memory(path, "its Gaussians", scene_bytes(n, degree), bytes.len() as u64)?;
    let bounds = rows(bytes, header, chunk, &BOUNDS[..if has_colors { 18 } else { 12 }], Number::F32, path)?;
    let packed = rows(bytes, header, vertex, &PACKED, Number::U32, path)?;
    let names: Vec<String> = (0..sh.map_or(0, |e| e.properties.len())).map(|i| format!("f_rest_{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let coefficients = sh.map(|e| rows(bytes, header, e, &names, Number::U8, path)).transpose()?;
    end(bytes, header, path)?;

    let mut out = allocate(n as usize, degree);
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
            let between = |first: usize, parts: [f64; 3]| -> [f64; 3] {
                std::array::from_fn(|a| {
                    let low = bounds.f32(i / CHUNK, first + a);
                    low + (bounds.f32(i / CHUNK, first + 3 + a) - low) * parts[a]
                })
            };
            *mean = between(0, unpack_11_10_11(packed.u32(i, 0))).map(|v| v as f32);
            *rotation = unpack_rotation(packed.u32(i, 1));
            *log_scale = between(6, unpack_11_10_11(packed.u32(i, 2))).map(|v| v as f32);
            let [red, green, blue, alpha] = packed.u32(i, 3).to_be_bytes().map(|b| f64::from(b) / 255.0);
            let color = if has_colors { between(12, [red, green, blue]) } else { [red, green, blue] };
            *opacity = logit(alpha);
            sh.iter_mut().zip(color).for_each(|(c, v)| *c = ((v - 0.5) / SH_C0) as f32);
            if let Some(rows) = &coefficients {
                let per_channel = k3 / 3 - 1;
                for (j, c) in sh[3..].iter_mut().enumerate() {
                    let column = (j % 3) * per_channel + j / 3;
                    *c = unpack_sh(rows.bytes[i * rows.stride + rows.offsets[column]]);
                }
            }
        });
    Ok(out)
}

fn element<'a>(header: &'a Header, name: &str, path: &Path) -> Result<&'a Element> {
    header
        .elements
        .iter()
        .find(|e| e.name == name)
        .ok_or_else(|| Error::corrupt(path, "header", format!("no element `{name}`"), "it beside `packed_position`"))
}

fn sh_degree(sh: Option<&Element>, n: u64, path: &Path) -> Result<u32> {
    let Some(sh) = sh else { return Ok(0) };
    let at = "header, element `sh`";
    if sh.count != n {
        return Err(Error::corrupt(path, at, format!("{} rows", sh.count), format!("{n}, as many as vertices")));
    }
    match sh.properties.len() {
        9 => Ok(1),
        24 => Ok(2),
        45 => Ok(3),
        other => Err(Error::corrupt(path, at, format!("{other} properties"), "9, 24 or 45 (SH degree 1, 2 or 3)")),
    }
}

/// The rows of an element that lie in the file, with the columns asked for.
fn rows<'a>(
    bytes: &'a [u8],
    header: &Header,
    element: &Element,
    names: &[&str],
    number: Number,
    path: &Path,
) -> Result<Rows<'a>> {
    let at = format!("header, element `{}`", element.name);
    let start = start_of(header, element, path)?;
    let Some(stride) = element.stride() else {
        return Err(Error::corrupt(path, at, "a list", "numbers"));
    };
    let needed = u128::from(element.count) * stride as u128;
    let left = bytes.len() as u128 - start.min(bytes.len() as u128);
    if needed > left {
        let place = format!("byte {start} (element `{}`)", element.name);
        let expected = format!("{needed} bytes: {} rows of {stride} bytes", element.count);
        return Err(Error::corrupt(path, place, format!("{left} bytes to the end of the file"), expected));
    }
    let find = |name: &&str| {
        let column = element.properties.iter().position(|p| p.name == *name && p.number == number);
        let column = column.ok_or_else(|| {
            Error::corrupt(path, at.clone(), format!("no `{name}` of type {number:?}"), "the compressed PLY layout")
        })?;
        Ok(element.properties[..column].iter().map(|p| p.number.size()).sum())
    };
    let offsets = names.iter().map(find).collect::<Result<_>>()?;
    let start = start as usize;
    Ok(Rows { bytes: &bytes[start..start + needed as usize], stride, offsets })
}

/// First byte of an element, by the header's counts.
fn start_of(header: &Header, element: &Element, path: &Path) -> Result<u128> {
    let mut start = header.body as u128;
    for before in header.elements.iter().take_while(|e| e.name != element.name) {
        let Some(stride) = before.stride() else {
            let at = format!("header, element `{}`", before.name);
            return Err(Error::corrupt(path, at, "a list", "numbers"));
        };
        start += u128::from(before.count) * stride as u128;
    }
    Ok(start)
}

/// The file ends where the header says.
fn end(bytes: &[u8], header: &Header, path: &Path) -> Result<()> {
    let mut end = header.body as u128;
    for element in &header.elements {
        end += u128::from(element.count) * element.stride().unwrap_or(0) as u128;
    }
    if end == bytes.len() as u128 {
        return Ok(());
    }
    let expected = format!("{end} bytes, by the header's counts");
    Err(Error::corrupt(path, format!("byte {}", bytes.len()), format!("{} bytes", bytes.len()), expected))
}

fn unpack_11_10_11(v: u32) -> [f64; 3] {
    [f64::from(v >> 21) / 2047.0, f64::from(v >> 11 & 1023) / 1023.0, f64::from(v & 2047) / 2047.0]
}

fn unpack_rotation(v: u32) -> [f32; 4] {
    let part = |shift: u32| (f64::from(v >> shift & 1023) / 1023.0 - 0.5) * std::f64::consts::SQRT_2;
    from_smallest_three((v >> 30) as usize, [part(20), part(10), part(0)])
}

/// −4 to 4 in 8 bits: the ends are exact, the rest are middles of 256 equal parts.
fn unpack_sh(byte: u8) -> f32 {
    match byte {
        0 => -4.0,
        255 => 4.0,
        _ => ((f64::from(byte) + 0.5) / 32.0 - 4.0) as f32,
    }
}
