//! The description, its buffers and what is in them.

use std::path::Path;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use serde_json::Value;

use super::{BIN, JSON, MAGIC};
use crate::error::{Error, Result};
use crate::file::archive::is_inside;
use crate::file::codec::{Cursor, f32_at};
use crate::gpu::mmap::{MappedFile, map_file};

/// A parsed file.
pub(super) struct Document<'a> {
    description: Value,
    buffers: Vec<Buffer<'a>>,
    path: &'a Path,
}

enum Buffer<'a> {
    /// The binary chunk of a `.glb`.
    Chunk(&'a [u8]),
    /// Another file.
    File(MappedFile),
    /// Within the description.
    Decoded(Vec<u8>),
    /// Not described: extensions may put something in its place.
    Absent,
}

impl Buffer<'_> {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Chunk(bytes) => bytes,
            Self::File(bytes) => bytes,
            Self::Decoded(bytes) => bytes,
            Self::Absent => &[],
        }
    }
}

/// The elements of an array; none of anything else.
pub(super) fn elements(value: &Value) -> &[Value] {
    value.as_array().map(Vec::as_slice).unwrap_or_default()
}

fn entry(value: &Value, key: &str) -> Option<usize> {
    value[key].as_u64().map(|v| usize::try_from(v).unwrap_or(usize::MAX))
}

impl<'a> Document<'a> {
    pub(super) fn open(bytes: &'a [u8], path: &'a Path) -> Result<Self> {
        let (description, chunk) = if bytes.starts_with(&MAGIC) { chunks(bytes, path)? } else { (bytes, None) };
        let description: Value = serde_json::from_slice(description)
            .map_err(|e| Error::corrupt(path, "glTF description", e.to_string(), "JSON"))?;
        let mut document = Self { description, buffers: Vec::new(), path };
        let of = |(i, buffer)| document.buffer(i, buffer, chunk);
        document.buffers =
            elements(&document.description["buffers"]).iter().enumerate().map(of).collect::<Result<_>>()?;
        Ok(document)
    }

    pub(super) fn corrupt(&self, at: &str, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::corrupt(self.path, format!("glTF {at}"), found, expected)
    }

    /// Bytes of all buffers together.
    pub(super) fn buffer_bytes(&self) -> u64 {
        self.buffers.iter().map(|buffer| buffer.bytes().len() as u64).sum()
    }

    /// An array of the description.
    pub(super) fn list(&self, name: &str) -> &[Value] {
        elements(&self.description[name])
    }

    /// An entry of the description.
    pub(super) fn entry(&self, name: &str) -> Option<usize> {
        entry(&self.description, name)
    }

    fn buffer(&self, i: usize, buffer: &Value, chunk: Option<&'a [u8]>) -> Result<Buffer<'a>> {
        let at = format!("buffers[{i}]");
        let content = match (buffer["uri"].as_str(), chunk) {
            (Some(uri), _) => match uri.strip_prefix("data:") {
                Some(data) => Buffer::Decoded(self.decode(&at, data)?),
                None => Buffer::File(self.open_beside(&at, uri)?),
            },
            (None, Some(chunk)) if i == 0 => Buffer::Chunk(chunk),
            _ => return Ok(Buffer::Absent),
        };
        let (need, have) = (entry(buffer, "byteLength").unwrap_or(0), content.bytes().len());
        if need > have {
            return Err(self.corrupt(&at, format!("{have} bytes"), format!("{need}, its byteLength")));
        }
        Ok(content)
    }

    /// A `data:` URI without its beginning.
    fn decode(&self, at: &str, data: &str) -> Result<Vec<u8>> {
        let Some((kind, text)) = data.split_once(',').filter(|(kind, _)| kind.ends_with(";base64")) else {
            let start: String = data.chars().take(40).collect();
            return Err(self.corrupt(at, format!("URI `data:{start}…`"), "one in base64"));
        };
        BASE64_STANDARD.decode(text).map_err(|e| self.corrupt(at, format!("data of type `{kind}`: {e}"), "base64"))
    }

    /// A file in the folder of this one.
    fn open_beside(&self, at: &str, uri: &str) -> Result<MappedFile> {
        let name = percent_encoding::percent_decode_str(uri).decode_utf8_lossy();
        if name.contains("://") || !is_inside(&name) {
            return Err(self.corrupt(at, format!("URI `{uri}`"), "a file in the same folder"));
        }
        let file = self.path.parent().unwrap_or(Path::new("")).join(name.as_ref());
        map_file(&file).map_err(|e| self.corrupt(at, format!("URI `{uri}` ({e})"), "a file that can be read beside it"))
    }

    /// The bytes of a buffer view, and those from one element to the next, if it says.
    pub(super) fn view(&self, index: Option<usize>, name: &str) -> Result<(&[u8], Option<usize>)> {
        let view = index.and_then(|i| self.list("bufferViews").get(i)).filter(|view| view.is_object());
        let view = view.ok_or_else(|| self.corrupt(name, "no bufferView", "one"))?;
        let compression = view["extensions"].as_object().and_then(|o| o.keys().find(|k| k.contains("compression")));
        if let Some(extension) = compression {
            return Err(self.corrupt(name, format!("a bufferView with `{extension}`"), "one without compression"));
        }
        let buffer = entry(view, "buffer").and_then(|i| self.buffers.get(i));
        let Some(bytes) = buffer.filter(|buffer| !matches!(buffer, Buffer::Absent)).map(Buffer::bytes) else {
            return Err(self.corrupt(name, format!("buffer {}", view["buffer"]), "one with a URI or the file's own"));
        };
        let start = entry(view, "byteOffset").unwrap_or(0);
        let length = entry(view, "byteLength").unwrap_or(bytes.len().saturating_sub(start));
        match start.checked_add(length).and_then(|end| bytes.get(start..end)) {
            Some(part) => Ok((part, entry(view, "byteStride"))),
            None => {
                let found = format!("{length} bytes from byte {start}");
                Err(self.corrupt(name, found, format!("what lies in the {} bytes of the buffer", bytes.len())))
            }
        }
    }

    /// The accessor of an attribute.
    pub(super) fn accessor(&self, attributes: &Value, name: &str) -> Option<&Value> {
        self.list("accessors").get(entry(attributes, name)?).filter(|accessor| accessor.is_object())
    }

    /// An attribute as floats, normalised where the accessor says so.
    pub(super) fn floats(&self, attributes: &Value, name: &str, width: usize) -> Result<Vec<f32>> {
        let accessor = self.accessor(attributes, name).ok_or_else(|| self.corrupt(name, "no accessor", "one"))?;
        let kind = ["SCALAR", "", "VEC3", "VEC4"][width - 1];
        if accessor["type"] != kind || !accessor["sparse"].is_null() {
            let found = format!("type {}, sparse {}", accessor["type"], !accessor["sparse"].is_null());
            return Err(self.corrupt(name, found, format!("type \"{kind}\", sparse false")));
        }
        let (bytes, stride) = self.view(entry(accessor, "bufferView"), name)?;
        let normalized = accessor["normalized"].as_bool().unwrap_or(false);
        let (size, read) = component(accessor["componentType"].as_u64(), normalized)
            .ok_or_else(|| self.corrupt(name, accessor["componentType"].to_string(), "5120 to 5123 or 5126"))?;
        let stride = stride.unwrap_or(size * width);
        let count = entry(accessor, "count").unwrap_or(0);
        let start = entry(accessor, "byteOffset").unwrap_or(0);
        let end = start as u128 + (count.max(1) - 1) as u128 * stride as u128 + (size * width) as u128;
        if stride < size * width || (count > 0 && end > bytes.len() as u128) {
            let found = format!("{count} elements of {stride} bytes from byte {start}");
            return Err(self.corrupt(name, found, format!("what lies in the {} bytes of the view", bytes.len())));
        }
        let element = |i: usize| {
            let row = &bytes[start + i * stride..];
            (0..width).map(move |c| read(&row[c * size..]))
        };
        Ok((0..count).flat_map(element).collect())
    }
}

/// The description and the numbers of a `.glb`.
fn chunks<'a>(bytes: &'a [u8], path: &'a Path) -> Result<(&'a [u8], Option<&'a [u8]>)> {
    let mut cursor = Cursor::new(bytes, path);
    let magic = cursor.take(4, "magic")?;
    let version = cursor.u32("version")?;
    if magic != MAGIC || version != 2 {
        return Err(cursor.corrupt(8, "header", format!("version {version}"), "`glTF` and version 2"));
    }
    let length = cursor.u32("length")?;
    if length as usize != bytes.len() {
        return Err(cursor.corrupt(4, "length", length.to_string(), format!("{}, the file's", bytes.len())));
    }
    let (mut description, mut numbers) = (None, None);
    while cursor.at < bytes.len() {
        let length = cursor.u32("length of a chunk")? as usize;
        let kind = cursor.u32("kind of a chunk")?;
        let content = cursor.take(length, "chunk")?;
        match kind {
            JSON => description = description.or(Some(content)),
            BIN => numbers = numbers.or(Some(content)),
            _ => {}
        }
    }
    let description = description.ok_or_else(|| Error::corrupt(path, "byte 12", "no JSON chunk", "one"))?;
    Ok((description, numbers))
}

type Component = fn(&[u8]) -> f32;

/// Size and reader of a component type; callers have checked the length.
fn component(kind: Option<u64>, normalized: bool) -> Option<(usize, Component)> {
    fn u16_of(b: &[u8]) -> u16 {
        b.first_chunk().map_or(0, |b| u16::from_le_bytes(*b))
    }
    fn u8_of(b: &[u8]) -> u8 {
        b.first().copied().unwrap_or(0)
    }
    Some(match (kind?, normalized) {
        (5120, false) => (1, |b| f32::from(u8_of(b) as i8)),
        (5120, true) => (1, |b| (f32::from(u8_of(b) as i8) / 127.0).max(-1.0)),
        (5121, false) => (1, |b| f32::from(u8_of(b))),
        (5121, true) => (1, |b| f32::from(u8_of(b)) / 255.0),
        (5122, false) => (2, |b| f32::from(u16_of(b) as i16)),
        (5122, true) => (2, |b| (f32::from(u16_of(b) as i16) / 32767.0).max(-1.0)),
        (5123, false) => (2, |b| f32::from(u16_of(b))),
        (5123, true) => (2, |b| f32::from(u16_of(b)) / 65535.0),
        (5126, false) => (4, |b| f32_at(b, 0)),
        _ => return None,
    })
}
