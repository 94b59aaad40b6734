//! Reads `.glb` (layout: [`super`]).

use std::path::Path;

use serde_json::Value;

use super::{BIN, EXTENSION, JSON, MAGIC, TURN};
use crate::error::{Error, Result};
use crate::file::check::MAX_SH_DEGREE;
use crate::file::codec::{Cursor, allocate, check_memory, logit, scene_bytes};
use crate::file::spz::flip_axes;
use crate::scene::Gaussians;

/// A parsed file.
struct File<'a> {
    description: Value,
    bytes: &'a [u8],
    path: &'a Path,
}

/// Reads the first primitive with Gaussians of a `.glb`. Values are not judged here (see [`crate::file::load`]).
///
/// # Errors
/// [`Error::Corrupt`] naming the place; what the format allows but is not supported is named as such: sparse accessors,
/// several buffers, compressed extensions, nodes that do more than turn the axes.
pub fn parse(bytes: &[u8], path: &Path) -> Result<Gaussians> {
    let file = File::open(bytes, path)?;
    let (mesh, attributes) = file.primitive()?;
    let name = |attribute: &str| format!("{EXTENSION}:{attribute}");
    let mean = file.floats(attributes, "POSITION", 3)?;
    let n = mean.len() / 3;
    let get = |attribute: String, width: usize| {
        let values = file.floats(attributes, &attribute, width)?;
        let error = || file.corrupt(&attribute, format!("{} elements", values.len() / width), n.to_string());
        if values.len() == n * width { Ok(values) } else { Err(error()) }
    };
    let has = |degree: u32| attributes.get(name(&format!("SH_DEGREE_{degree}_COEF_0"))).is_some();
    let degree = (1..=MAX_SH_DEGREE).take_while(|&d| has(d)).last().unwrap_or(0);
    check_memory(path, "its Gaussians", scene_bytes(n as u64, degree), bytes.len() as u64)?;
    let (rotation, scale, opacity) = (get(name("ROTATION"), 4)?, get(name("SCALE"), 3)?, get(name("OPACITY"), 1)?);
    let mut out = allocate(n, degree);
    let k3 = out.sh_coefficients() * 3;
    for l in 0..=degree as usize {
        for c in 0..2 * l + 1 {
            let values = get(name(&format!("SH_DEGREE_{l}_COEF_{c}")), 3)?;
            for (sh, value) in out.sh.chunks_exact_mut(k3).zip(values.chunks_exact(3)) {
                sh[3 * (l * l + c)..][..3].copy_from_slice(value);
            }
        }
    }
    for i in 0..n {
        out.mean[i] = std::array::from_fn(|a| mean[3 * i + a]);
        out.log_scale[i] = std::array::from_fn(|a| scale[3 * i + a].ln());
        out.rotation[i] = [3, 0, 1, 2].map(|a| rotation[4 * i + a]);
        out.opacity_logit[i] = logit(f64::from(opacity[i]));
    }
    if !file.is_turned(mesh)? {
        flip_axes(&mut out);
    }
    Ok(out)
}

impl<'a> File<'a> {
    fn open(bytes: &'a [u8], path: &'a Path) -> Result<Self> {
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
        let (mut description, mut data) = (None, &[][..]);
        while cursor.at < bytes.len() {
            let length = cursor.u32("length of a chunk")? as usize;
            let kind = cursor.u32("kind of a chunk")?;
            let content = cursor.take(length, "chunk")?;
            match kind {
                JSON if description.is_none() => {
                    let parsed = serde_json::from_slice(content)
                        .map_err(|e| Error::corrupt(path, "JSON chunk", e.to_string(), "a glTF description"))?;
                    description = Some(parsed);
                }
                BIN if data.is_empty() => data = content,
                _ => {}
            }
        }
        let description = description.ok_or_else(|| Error::corrupt(path, "byte 12", "no JSON chunk", "one"))?;
        Ok(Self { description, bytes: data, path })
    }

    fn corrupt(&self, at: &str, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::corrupt(self.path, format!("glTF {at}"), found, expected)
    }

    /// Mesh index and attributes of the first primitive with Gaussians.
    fn primitive(&self) -> Result<(usize, &Value)> {
        let meshes = self.description["meshes"].as_array().map(Vec::as_slice).unwrap_or_default();
        for (m, mesh) in meshes.iter().enumerate() {
            for primitive in mesh["primitives"].as_array().map(Vec::as_slice).unwrap_or_default() {
                let extension = &primitive["extensions"][EXTENSION];
                if extension.is_null() {
                    continue;
                }
                if let Some(inner) = extension["extensions"].as_object().and_then(|o| o.keys().next()) {
                    return Err(self.corrupt("primitive", format!("extension `{inner}`"), "uncompressed Gaussians"));
                }
                return Ok((m, &primitive["attributes"]));
            }
        }
        Err(self.corrupt("meshes", format!("no primitive with `{EXTENSION}`"), "one"))
    }

    /// Whether the node of the mesh turns our axes into glTF's; otherwise its points are in glTF's.
    fn is_turned(&self, mesh: usize) -> Result<bool> {
        let nodes = self.description["nodes"].as_array().map(Vec::as_slice).unwrap_or_default();
        let Some(node) = nodes.iter().find(|n| n["mesh"].as_u64() == Some(mesh as u64)) else { return Ok(false) };
        let moved = ["matrix", "translation", "scale"].iter().find(|key| !node[**key].is_null());
        let rotation: Vec<f64> =
            node["rotation"].as_array().map(|q| q.iter().filter_map(Value::as_f64).collect()).unwrap_or_default();
        match (moved, rotation.as_slice()) {
            (None, [] | [0.0, 0.0, 0.0, 1.0]) => Ok(false),
            (None, q) if q == TURN => Ok(true),
            (None, _) => Err(self.corrupt("node", "a rotation", "none, or 180 degrees about x")),
            (Some(key), _) => Err(self.corrupt("node", format!("`{key}`"), "no transform but a rotation")),
        }
    }

    /// An attribute as floats, normalised where the accessor says so.
    fn floats(&self, attributes: &Value, name: &str, width: usize) -> Result<Vec<f32>> {
        let entry = |value: &Value, key: &str| value[key].as_u64().map(|v| v as usize);
        let accessor = attributes[name].as_u64().map(|i| &self.description["accessors"][i as usize]);
        let accessor = accessor.filter(|a| a.is_object()).ok_or_else(|| self.corrupt(name, "no accessor", "one"))?;
        let kind = ["SCALAR", "", "VEC3", "VEC4"][width - 1];
        if accessor["type"] != kind || !accessor["sparse"].is_null() {
            let found = format!("type {}, sparse {}", accessor["type"], !accessor["sparse"].is_null());
            return Err(self.corrupt(name, found, format!("type \"{kind}\", sparse false")));
        }
        let view = entry(accessor, "bufferView").map(|i| &self.description["bufferViews"][i]);
        let view = view.filter(|v| v.is_object()).ok_or_else(|| self.corrupt(name, "no bufferView", "one"))?;
        if entry(view, "buffer") != Some(0) {
            return Err(self.corrupt(name, "another buffer", "buffer 0, the file's own"));
        }
        let normalized = accessor["normalized"].as_bool().unwrap_or(false);
        let (size, read) = component(accessor["componentType"].as_u64(), normalized)
            .ok_or_else(|| self.corrupt(name, accessor["componentType"].to_string(), "5120 to 5123 or 5126"))?;
        let stride = entry(view, "byteStride").unwrap_or(size * width);
        let count = entry(accessor, "count").unwrap_or(0);
        let start = entry(view, "byteOffset").unwrap_or(0) as u128 + entry(accessor, "byteOffset").unwrap_or(0) as u128;
        let end = start + (count.max(1) - 1) as u128 * stride as u128 + (size * width) as u128;
        if stride < size * width || (count > 0 && end > self.bytes.len() as u128) {
            let found = format!("{count} elements of {stride} bytes from byte {start}");
            return Err(self.corrupt(
                name,
                found,
                format!("what lies in the {} bytes of the buffer", self.bytes.len()),
            ));
        }
        let element = |i: usize| {
            let row = &self.bytes[start as usize + i * stride..];
            (0..width).map(move |c| read(&row[c * size..]))
        };
        Ok((0..count).flat_map(element).collect())
    }
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
        (5126, false) => (4, |b| crate::file::codec::f32_at(b, 0)),
        _ => return None,
    })
}
