//! The PLY body: skips what is not needed, gathers the rows of `vertex` into [`Gaussians`].

use std::path::Path;

use rayon::prelude::*;

use super::header::{Element, Encoding, Header, Number};
use crate::error::{Error, Result};
use crate::file::check::MAX_SH_DEGREE;
use crate::scene::Gaussians;

/// Rows per parallel task.
const CHUNK: usize = 4096;

/// Which property each value of a Gaussian comes from: mean 3, log scale 3, rotation 4, opacity 1, SH `[K,3]`.
struct Layout {
    degree: u32,
    columns: Vec<usize>,
}

/// Position of the first SH value in [`Layout::columns`].
const SH: usize = 11;

/// Reads the body that follows `header`.
pub(super) fn body(bytes: &[u8], header: &Header, path: &Path) -> Result<Gaussians> {
    gathered(bytes, header, &layout(&header.elements[header.vertex], path)?, path)
}

fn gathered(bytes: &[u8], header: &Header, layout: &Layout, path: &Path) -> Result<Gaussians> {
    match header.encoding {
        Encoding::Ascii => ascii(bytes, header, layout, path),
        Encoding::Little => binary::<false>(bytes, header, layout, path),
        Encoding::Big => binary::<true>(bytes, header, layout, path),
    }
}

/// Properties of normals, which 3DGS files have and leave 0.
const NORMALS: [&str; 3] = ["nx", "ny", "nz"];

/// What of the vertices [`body`] does not take, one name each: further properties, and normals that are not 0.
pub(super) fn unread(bytes: &[u8], header: &Header, path: &Path) -> Result<Vec<String>> {
    let vertex = &header.elements[header.vertex];
    let taken = layout(vertex, path)?.columns;
    let is_normal = |i: &usize| NORMALS.contains(&&*vertex.properties[*i].name) && vertex.properties[*i].list.is_none();
    let (normals, further): (Vec<usize>, Vec<usize>) =
        (0..vertex.properties.len()).filter(|i| !taken.contains(i)).partition(is_normal);
    let mut unread: Vec<String> =
        further.iter().map(|&i| format!("property `{}`", vertex.properties[i].name)).collect();
    if let Some(&first) = normals.first() {
        // Read in the place of the centres.
        let mut columns = vec![first; SH + 3];
        columns.iter_mut().zip(&normals).for_each(|(column, i)| *column = *i);
        let read = gathered(bytes, header, &Layout { degree: 0, columns }, path)?;
        if read.mean.as_flattened().iter().any(|v| *v != 0.0) {
            unread.push("normals".into());
        }
    }
    Ok(unread)
}

fn layout(vertex: &Element, path: &Path) -> Result<Layout> {
    let at = "header, element `vertex`";
    let rest: Vec<&str> = vertex.properties.iter().filter_map(|p| p.name.strip_prefix("f_rest_")).collect();
    let degree = (0..=MAX_SH_DEGREE).find(|d| 3 * ((d + 1) * (d + 1) - 1) as usize == rest.len());
    let Some(degree) = degree else {
        let expected = "0, 9, 24 or 45 of them (SH degree 0, 1, 2 or 3)";
        return Err(Error::corrupt(path, at, format!("{} properties `f_rest_*`", rest.len()), expected));
    };
    let per_channel = ((degree + 1) * (degree + 1) - 1) as usize;
    let mut names: Vec<String> = ["x", "y", "z", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
        .iter()
        .map(ToString::to_string)
        .collect();
    names.push("opacity".into());
    names.extend((0..3).map(|c| format!("f_dc_{c}")));
    for k in 0..per_channel {
        names.extend((0..3).map(|c| format!("f_rest_{}", c * per_channel + k)));
    }
    let find = |name: &String| match vertex.properties.iter().position(|p| p.name == *name) {
        Some(i) if vertex.properties[i].list.is_none() => Ok(i),
        Some(_) => Err(Error::corrupt(path, at, format!("`{name}` is a list"), "a number")),
        None => Err(missing(vertex, name, path, at)),
    };
    Ok(Layout { degree, columns: names.iter().map(find).collect::<Result<_>>()? })
}

/// Says what kind of file it is, where that is known.
fn missing(vertex: &Element, name: &str, path: &Path, at: &str) -> Error {
    let has = |name: &str| vertex.properties.iter().any(|p| p.name == name);
    let found = if !has("opacity") && !has("f_dc_0") {
        format!("no `{name}` (a mesh or a point cloud)")
    } else {
        format!("no property `{name}`")
    };
    let expected = "a 3DGS model: x y z, f_dc_0..2, opacity, scale_0..2, rot_0..3 and 0, 9, 24 or 45 f_rest_*";
    Error::corrupt(path, at, found, expected)
}

// ---------------------------------------------------------------------------------------------- output

fn allocate(count: usize, degree: u32) -> Gaussians {
    let k3 = 3 * ((degree + 1) * (degree + 1)) as usize;
    Gaussians {
        mean: vec![[0.0; 3]; count],
        log_scale: vec![[0.0; 3]; count],
        rotation: vec![[0.0; 4]; count],
        opacity_logit: vec![0.0; count],
        sh_degree: degree,
        sh: vec![0.0; count * k3],
        ..Gaussians::default()
    }
}

/// Stores one row whose value `j` (in the order of [`Layout::columns`]) is `value(j)`.
#[inline(always)]
fn store(
    mean: &mut [f32; 3],
    log_scale: &mut [f32; 3],
    rotation: &mut [f32; 4],
    opacity: &mut f32,
    sh: &mut [f32],
    value: impl Fn(usize) -> f32,
) {
    for j in 0..3 {
        mean[j] = value(j);
        log_scale[j] = value(3 + j);
    }
    for j in 0..4 {
        rotation[j] = value(6 + j);
    }
    *opacity = value(10);
    for (j, coefficient) in sh.iter_mut().enumerate() {
        *coefficient = value(SH + j);
    }
}

fn store_row(out: &mut Gaussians, i: usize, value: impl Fn(usize) -> f32) {
    let k3 = out.sh_coefficients() * 3;
    let sh = &mut out.sh[i * k3..(i + 1) * k3];
    store(&mut out.mean[i], &mut out.log_scale[i], &mut out.rotation[i], &mut out.opacity_logit[i], sh, value);
}

// ---------------------------------------------------------------------------------------------- binary

/// Reads the number at the start of `bytes`; missing bytes read as zero (callers have checked the length).
#[inline(always)]
fn number<const BIG: bool>(kind: Number, bytes: &[u8]) -> f64 {
    macro_rules! read {
        ($t:ty) => {{
            let raw = bytes.first_chunk().copied().unwrap_or_default();
            (if BIG { <$t>::from_be_bytes(raw) } else { <$t>::from_le_bytes(raw) }) as f64
        }};
    }
    match kind {
        Number::I8 => read!(i8),
        Number::U8 => read!(u8),
        Number::I16 => read!(i16),
        Number::U16 => read!(u16),
        Number::I32 => read!(i32),
        Number::U32 => read!(u32),
        Number::F32 => read!(f32),
        Number::F64 => read!(f64),
    }
}

/// As [`number`], in f32; a stored f32 keeps its bits (NaN payloads included).
#[inline(always)]
fn float<const BIG: bool>(kind: Number, bytes: &[u8]) -> f32 {
    if kind == Number::F32 {
        let raw = bytes.first_chunk().copied().unwrap_or_default();
        if BIG { f32::from_be_bytes(raw) } else { f32::from_le_bytes(raw) }
    } else {
        number::<BIG>(kind, bytes) as f32
    }
}

fn binary<const BIG: bool>(bytes: &[u8], header: &Header, layout: &Layout, path: &Path) -> Result<Gaussians> {
    let mut at = header.body;
    let mut gaussians = None;
    for (index, element) in header.elements.iter().enumerate() {
        let needed = u128::from(element.count) * element.least_row() as u128;
        let left = bytes.len() - at;
        if needed > left as u128 {
            let row = element.stride().map_or("at least ", |_| "");
            return Err(Error::corrupt(
                path,
                format!("byte {at} (element `{}`)", element.name),
                format!("{left} bytes to the end of the file"),
                format!("{needed} bytes: {} rows of {row}{} bytes", element.count, element.least_row()),
            ));
        }
        let rows = &bytes[at..];
        if index == header.vertex {
            let count = element.count as usize;
            let mut out = allocate(count, layout.degree);
            match element.stride() {
                Some(stride) => gather::<BIG>(&rows[..count * stride], stride, element, layout, &mut out),
                None => {
                    walk::<BIG>(bytes, at, element, path, |i, offsets| {
                        store_row(&mut out, i, |j| {
                            let column = layout.columns[j];
                            float::<BIG>(element.properties[column].number, &bytes[offsets[column]..])
                        });
                    })?;
                }
            }
            gaussians = Some(out);
        }
        at = match element.stride() {
            Some(_) => at + needed as usize,
            None => walk::<BIG>(bytes, at, element, path, |_, _| ())?,
        };
    }
    if at != bytes.len() {
        let found = format!("{} more bytes", bytes.len() - at);
        return Err(Error::corrupt(path, format!("byte {at}"), found, "the end of the file, by the header's counts"));
    }
    gaussians.ok_or_else(|| Error::corrupt(path, "header", "no element `vertex`", "one"))
}

/// Gathers fixed-size rows, in parallel.
fn gather<const BIG: bool>(rows: &[u8], stride: usize, element: &Element, layout: &Layout, out: &mut Gaussians) {
    let mut offsets = Vec::with_capacity(element.properties.len());
    let mut offset = 0;
    for property in &element.properties {
        offsets.push((offset, property.number));
        offset += property.number.size();
    }
    let columns: Vec<(usize, Number)> = layout.columns.iter().map(|&c| offsets[c]).collect();
    let all_f32 = columns.iter().all(|&(_, kind)| kind == Number::F32);
    let k3 = out.sh_coefficients() * 3;
    (
        rows.par_chunks(CHUNK * stride),
        out.mean.par_chunks_mut(CHUNK),
        out.log_scale.par_chunks_mut(CHUNK),
        out.rotation.par_chunks_mut(CHUNK),
        out.opacity_logit.par_chunks_mut(CHUNK),
        out.sh.par_chunks_mut(CHUNK * k3),
    )
        .into_par_iter()
        .for_each(|(rows, mean, log_scale, rotation, opacity, sh)| {
            for (i, row) in rows.chunks_exact(stride).enumerate() {
                let sh = &mut sh[i * k3..(i + 1) * k3];
                let (m, s, r, o) = (&mut mean[i], &mut log_scale[i], &mut rotation[i], &mut opacity[i]);
                if all_f32 {
                    store(m, s, r, o, sh, |j| float::<BIG>(Number::F32, &row[columns[j].0..]));
                } else {
                    store(m, s, r, o, sh, |j| float::<BIG>(columns[j].1, &row[columns[j].0..]));
                }
            }
        });
}

/// Further properties of the vertices (see [`super::numbered`]).
pub(super) fn numbered(bytes: &[u8], header: &Header, prefix: &str, path: &Path) -> Result<Vec<f32>> {
    let vertex = &header.elements[header.vertex];
    let at = || "header, element `vertex`";
    let (Some(stride), 0, Encoding::Little | Encoding::Big) = (vertex.stride(), header.vertex, header.encoding) else {
        return Err(Error::corrupt(path, at(), "lists, text or another element first", "a binary file of vertices"));
    };
    let column = |i: usize| vertex.properties.iter().position(|p| p.name == format!("{prefix}{i}"));
    let columns: Vec<(usize, Number)> = (0..)
        .map_while(column)
        .map(|c| (vertex.properties[..c].iter().map(|p| p.number.size()).sum(), vertex.properties[c].number))
        .collect();
    let big = header.encoding == Encoding::Big;
    let value = |row: &[u8], (offset, kind): (usize, Number)| {
        if big { float::<true>(kind, &row[offset..]) } else { float::<false>(kind, &row[offset..]) }
    };
    let rows = bytes[header.body..].chunks_exact(stride.max(1)).take(vertex.count as usize);
    Ok(rows.flat_map(|row| columns.iter().map(move |&c| value(row, c))).collect())
}

/// Walks rows that hold lists, from byte `at`; `row` gets the row's index and the byte of each property. Returns the byte
/// after the last row.
fn walk<const BIG: bool>(
    bytes: &[u8],
    mut at: usize,
    element: &Element,
    path: &Path,
    mut row: impl FnMut(usize, &[usize]),
) -> Result<usize> {
    let mut offsets = vec![0; element.properties.len()];
    let short = |at: usize, i: u64, name: &str, needed: u128| {
        let place = format!("byte {at} (element `{}` row {i}, property `{name}`)", element.name);
        let found = format!("{} bytes to the end of the file", bytes.len() - at);
        Error::corrupt(path, place, found, format!("{needed} bytes"))
    };
    for i in 0..element.count {
        for (offset, property) in offsets.iter_mut().zip(&element.properties) {
            *offset = at;
            let mut needed = property.number.size() as u128;
            if let Some(count) = property.list {
                let head = count.size();
                if bytes.len() - at < head {
                    return Err(short(at, i, &property.name, head as u128));
                }
                let items = number::<BIG>(count, &bytes[at..]);
                if items < 0.0 {
                    let place = format!("byte {at} (element `{}` row {i})", element.name);
                    return Err(Error::corrupt(path, place, format!("a list of {items} items"), "a count ≥ 0"));
                }
                needed = head as u128 + items as u128 * property.number.size() as u128;
            }
            if needed > (bytes.len() - at) as u128 {
                return Err(short(at, i, &property.name, needed));
            }
            at += needed as usize;
        }
        row(i as usize, &offsets);
    }
    Ok(at)
}

// ---------------------------------------------------------------------------------------------- ascii

/// The non-blank lines of an ascii body, with their numbers.
struct TextLines<'a> {
    rest: &'a [u8],
    number: usize,
}

impl<'a> TextLines<'a> {
    fn next_line(&mut self, path: &Path) -> Result<Option<(usize, &'a str)>> {
        while !self.rest.is_empty() {
            let end = self.rest.iter().position(|&b| b == b'\n').unwrap_or(self.rest.len());
            let (line, number) = (&self.rest[..end], self.number);
            self.rest = self.rest.get(end + 1..).unwrap_or(&[]);
            self.number += 1;
            let text = std::str::from_utf8(line).map_err(|_| {
                Error::corrupt(
                    path,
                    format!("line {number}"),
                    "bytes that are no text",
                    "numbers (the format is ascii)",
                )
            })?;
            if !text.trim().is_empty() {
                return Ok(Some((number, text)));
            }
        }
        Ok(None)
    }
}

fn ascii(bytes: &[u8], header: &Header, layout: &Layout, path: &Path) -> Result<Gaussians> {
    let mut lines = TextLines { rest: &bytes[header.body..], number: header.body_line };
    let mut gaussians = None;
    for (index, element) in header.elements.iter().enumerate() {
        // Rows without a number have no line.
        if element.properties.is_empty() {
            continue;
        }
        // Each number takes a digit and a separator (the file's last separator may be missing).
        let least = u128::from(element.count) * 2 * element.properties.len() as u128;
        if least > lines.rest.len() as u128 + 1 {
            return Err(Error::corrupt(
                path,
                format!("line {} (element `{}`)", lines.number, element.name),
                format!("{} bytes to the end of the file", lines.rest.len()),
                format!("{} lines of {} numbers", element.count, element.properties.len()),
            ));
        }
        let is_vertex = index == header.vertex;
        let mut out = allocate(if is_vertex { element.count as usize } else { 0 }, layout.degree);
        let mut values = vec![0.0; element.properties.len()];
        for i in 0..element.count {
            let Some((number, text)) = lines.next_line(path)? else {
                let expected = format!("row {i} of the {} of element `{}`", element.count, element.name);
                return Err(Error::corrupt(path, format!("line {}", lines.number), "the end of the file", expected));
            };
            ascii_row(text, number, element, path, &mut values)?;
            if is_vertex {
                store_row(&mut out, i as usize, |j| values[layout.columns[j]]);
            }
        }
        if is_vertex {
            gaussians = Some(out);
        }
    }
    if let Some((number, _)) = lines.next_line(path)? {
        let expected = "the end of the file, by the header's counts";
        return Err(Error::corrupt(path, format!("line {number}"), "another line", expected));
    }
    gaussians.ok_or_else(|| Error::corrupt(path, "header", "no element `vertex`", "one"))
}

/// Reads a row of text; lists are checked and skipped (their value is 0).
fn ascii_row(text: &str, line: usize, element: &Element, path: &Path, values: &mut [f32]) -> Result<()> {
    let mut words = text.split_ascii_whitespace();
    let mut position = 0;
    let mut next = |name: &str| {
        position += 1;
        words.next().ok_or_else(|| {
            let found = format!("{} numbers", position - 1);
            Error::corrupt(path, format!("line {line}"), found, format!("a further number, for `{name}`"))
        })
    };
    let bad = |word: &str, name: &str, expected: &str| {
        Error::corrupt(path, format!("line {line} (`{name}`)"), format!("`{word}`"), expected)
    };
    for (value, property) in values.iter_mut().zip(&element.properties) {
        let name = property.name.as_str();
        let word = next(name)?;
        if property.list.is_some() {
            let items: u64 = word.parse().map_err(|_| bad(word, name, "a count of list items"))?;
            for _ in 0..items {
                let item = next(name)?;
                item.parse::<f64>().map_err(|_| bad(item, name, "a number"))?;
            }
            *value = 0.0;
        } else {
            // Straight to f32: going through f64 would round twice.
            let parsed = match property.number {
                Number::F32 => word.parse::<f32>().ok(),
                Number::F64 => word.parse::<f64>().ok().map(|v| v as f32),
                _ => word.parse::<i64>().ok().map(|v| v as f32),
            };
            *value = parsed.ok_or_else(|| {
                bad(word, name, if property.number.is_integer() { "a whole number" } else { "a number" })
            })?;
        }
    }
    match words.next() {
        None => Ok(()),
        Some(extra) => {
            let expected = format!("the end of the line after the {} properties", element.properties.len());
            Err(Error::corrupt(path, format!("line {line}"), format!("a further `{extra}`"), expected))
        }
    }
}
