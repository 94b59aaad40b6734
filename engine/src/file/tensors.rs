//! Files of named tensors: safetensors with SHA-256 checksums, written durably. Models and checkpoints are such files.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use rayon::prelude::*;
use safetensors::tensor::{Metadata, SafeTensors, TensorView};
use serde_json::{Map, Value, json};

use super::checksum;
use super::durable::write_atomic;
use crate::error::{Error, Result};
use crate::gpu::mmap::map_file;

/// Metadata entries that belong to the container: not part of the metadata that callers give and get.
pub const RESERVED: [&str; 4] = ["format", "version", checksum::TENSORS, checksum::HEADER];

/// A tensor to be written.
#[derive(Debug, Clone)]
pub struct NamedTensor<'a> {
    /// Name.
    pub name: Cow<'a, str>,
    /// Element type, as safetensors names it.
    pub dtype: &'static str,
    /// Dimensions, outermost first.
    pub shape: Vec<usize>,
    /// Little-endian elements.
    pub bytes: Cow<'a, [u8]>,
}

/// Writes tensors, durably. Equal tensors and metadata give equal bytes: they are stored in the order of their names.
///
/// # Errors
/// [`Error::Limit`] when the header is longer than the format's readers take; [`Error::Io`].
pub fn write(
    path: &Path,
    format_version: [&str; 2],
    mut tensors: Vec<NamedTensor<'_>>,
    metadata: &BTreeMap<String, String>,
) -> Result<()> {
    tensors.sort_by(|a, b| a.name.cmp(&b.name));
    let header = header(&tensors, format_version, metadata, path)?;
    write_atomic(path, |out| {
        out.write_all(&(header.len() as u64).to_le_bytes())?;
        out.write_all(&header)?;
        tensors.iter().try_for_each(|tensor| out.write_all(&tensor.bytes))
    })
}

/// The JSON header, padded with spaces so that the data are 8-byte aligned.
fn header(
    tensors: &[NamedTensor<'_>],
    [format, version]: [&str; 2],
    metadata: &BTreeMap<String, String>,
    path: &Path,
) -> Result<Vec<u8>> {
    let sums: BTreeMap<&str, String> =
        tensors.par_iter().map(|t| (t.name.as_ref(), checksum::of_bytes(&t.bytes))).collect();
    let sums = json!(sums).to_string();
    let mut metadata: BTreeMap<&str, &str> =
        metadata.iter().map(|(key, value)| (key.as_str(), value.as_str())).collect();
    metadata.retain(|key, _| !RESERVED.contains(key));
    metadata.extend([("format", format), ("version", version), (checksum::TENSORS, sums.as_str())]);

    let mut entries = Map::new();
    let mut descriptions = BTreeMap::new();
    let mut begin = 0;
    for tensor in tensors {
        let offsets = [begin, begin + tensor.bytes.len()];
        begin = offsets[1];
        let texts = [tensor.dtype.into(), format!("{:?}", tensor.shape), format!("{offsets:?}")];
        descriptions.insert(tensor.name.as_ref(), texts);
        let entry = json!({ "dtype": tensor.dtype, "shape": tensor.shape, "data_offsets": offsets });
        entries.insert(tensor.name.to_string(), entry);
    }
    let header_sum = checksum::of_header(&metadata, &descriptions);
    metadata.insert(checksum::HEADER, &header_sum);
    let mut all = Map::from_iter([("__metadata__".to_string(), json!(metadata))]);
    all.append(&mut entries);
    let mut text = Value::Object(all).to_string().into_bytes();
    text.resize(text.len().next_multiple_of(8), b' ');
    // The limit of the format's readers.
    const MAX_HEADER: usize = 100_000_000;
    if text.len() > MAX_HEADER {
        let what = format!("{} (bytes of header and metadata)", path.display());
        return Err(Error::Limit { what, need: text.len() as u128, have: MAX_HEADER as u128 });
    }
    Ok(text)
}

/// A float tensor.
pub fn floats<'a>(name: impl Into<Cow<'a, str>>, shape: Vec<usize>, values: &'a [f32]) -> NamedTensor<'a> {
    let bytes = if cfg!(target_endian = "little") {
        Cow::Borrowed(bytemuck::cast_slice(values))
    } else {
        Cow::Owned(values.iter().flat_map(|v| v.to_le_bytes()).collect())
    };
    NamedTensor { name: name.into(), dtype: "F32", shape, bytes }
}

/// A tensor of unsigned words.
pub fn indices<'a>(name: impl Into<Cow<'a, str>>, shape: Vec<usize>, values: &'a [u32]) -> NamedTensor<'a> {
    let bytes = if cfg!(target_endian = "little") {
        Cow::Borrowed(bytemuck::cast_slice(values))
    } else {
        Cow::Owned(values.iter().flat_map(|v| v.to_le_bytes()).collect())
    };
    NamedTensor { name: name.into(), dtype: "U32", shape, bytes }
}

/// A tensor of the narrowest unsigned integers, of 16 or 32 bits, that hold indices below `count`.
pub fn narrow_indices<'a>(
    name: impl Into<Cow<'a, str>>,
    shape: Vec<usize>,
    values: &'a [u32],
    count: usize,
) -> NamedTensor<'a> {
    if count > 1 << 16 {
        return indices(name, shape, values);
    }
    let bytes = values.iter().flat_map(|&v| (v as u16).to_le_bytes()).collect();
    NamedTensor { name: name.into(), dtype: "U16", shape, bytes: Cow::Owned(bytes) }
}

/// A tensor that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredTensor {
    /// Element type, as safetensors names it.
    pub dtype: String,
    /// Dimensions, outermost first.
    pub shape: Vec<usize>,
    /// Little-endian elements.
    pub bytes: Vec<u8>,
}

/// Tensors by name, and the metadata.
pub type TensorFile = (BTreeMap<String, StoredTensor>, BTreeMap<String, String>);

/// Reads a file that [`write()`] made with the same format and version; checksums must be there and right.
///
/// # Errors
/// [`Error::Corrupt`] naming the tensor or metadata entry; [`Error::Io`].
pub fn read(path: &Path, format_version: [&str; 2]) -> Result<TensorFile> {
    let bytes = &*map_file(path)?;
    let (data_begin, header) = parse_header(bytes, path)?;
    let empty = HashMap::new();
    let metadata = header.metadata().as_ref().unwrap_or(&empty);
    check_format(metadata, format_version, path)?;
    if !checksum::verify(metadata, &header, &bytes[data_begin..], path)? {
        return Err(Error::corrupt(path, "metadata entry `checksum`", "nothing", "checksums of the tensors"));
    }
    Ok((stored(bytes, path)?, own_metadata(metadata)))
}

/// Reads the tensors of any safetensors file, whoever wrote it.
///
/// # Errors
/// [`Error::Corrupt`] for a file that is not safetensors; [`Error::Io`].
pub fn read_plain(path: &Path) -> Result<BTreeMap<String, StoredTensor>> {
    let bytes = &*map_file(path)?;
    parse_header(bytes, path)?;
    stored(bytes, path)
}

fn stored(bytes: &[u8], path: &Path) -> Result<BTreeMap<String, StoredTensor>> {
    let parsed = SafeTensors::deserialize(bytes)
        .map_err(|e| Error::corrupt(path, "byte 0 (header)", e.to_string(), "a safetensors header"))?;
    let tensor = |(name, view): (String, TensorView<'_>)| {
        let (dtype, shape, bytes) = (view.dtype().to_string(), view.shape().to_vec(), view.data().to_vec());
        (name, StoredTensor { dtype, shape, bytes })
    };
    Ok(parsed.tensors().into_iter().map(tensor).collect())
}

/// Parses the header; returns where the data begin.
pub(super) fn parse_header(bytes: &[u8], path: &Path) -> Result<(usize, Metadata)> {
    let (length, header) = SafeTensors::read_metadata(bytes).map_err(|e| {
        let length = bytes.first_chunk().map(|b| u64::from_le_bytes(*b));
        let found = match length {
            Some(length) => format!("{e} (header of {length} bytes in a file of {})", bytes.len()),
            None => format!("{e} (a file of {} bytes)", bytes.len()),
        };
        Error::corrupt(path, "byte 0 (header)", found, "a safetensors header that covers the file exactly")
    })?;
    Ok((8 + length, header))
}

/// Whether the file says that it is of this format and version.
pub(super) fn check_format(
    metadata: &HashMap<String, String>,
    [format, version]: [&str; 2],
    path: &Path,
) -> Result<()> {
    for (key, expected) in [("format", format), ("version", version)] {
        let found = metadata.get(key);
        if found.is_none_or(|f| f != expected) {
            let found = found.map_or("nothing".into(), |f| format!("{key} `{f}`"));
            let at = format!("metadata entry `{key}`");
            return Err(Error::corrupt(path, at, found, format!("{key} `{expected}`")));
        }
    }
    Ok(())
}

/// The metadata without the container's own entries.
pub(super) fn own_metadata(metadata: &HashMap<String, String>) -> BTreeMap<String, String> {
    let own = metadata.iter().filter(|(key, _)| !RESERVED.contains(&key.as_str()));
    own.map(|(key, value)| (key.clone(), value.clone())).collect()
}
