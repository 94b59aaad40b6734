//! SHA-256 of tensors and header.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use rayon::prelude::*;
use safetensors::tensor::Metadata;
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};

/// Metadata entry with the tensors' checksums.
pub(super) const TENSORS: &str = "checksum";
/// Metadata entry with the header's checksum.
pub(super) const HEADER: &str = "checksum_header";

fn hex(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// SHA-256 of a tensor's bytes, hexadecimal.
pub(super) fn of_bytes(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// What the header says of a tensor, as texts: dtype, shape, offsets.
pub(super) type Description = [String; 3];

/// SHA-256 of the header's content but for its own entry.
pub(super) fn of_header(metadata: &BTreeMap<&str, &str>, tensors: &BTreeMap<&str, Description>) -> String {
    let mut hash = Sha256::new();
    let mut text = |t: &str| {
        hash.update((t.len() as u64).to_le_bytes());
        hash.update(t);
    };
    for (key, value) in metadata.iter().filter(|(key, _)| **key != HEADER) {
        text(key);
        text(value);
    }
    for (name, description) in tensors {
        text(name);
        description.iter().for_each(|t| text(t));
    }
    hex(&hash.finalize())
}

/// Compares the checksums of a file with its content. `Ok(false)`: the file has none.
pub(super) fn verify(metadata: &HashMap<String, String>, header: &Metadata, data: &[u8], path: &Path) -> Result<bool> {
    let entry = |key: &str| format!("metadata entry `{key}`");
    let (tensor_sums, header_sum) = match (metadata.get(TENSORS), metadata.get(HEADER)) {
        (None, None) => return Ok(false),
        (Some(tensors), Some(header)) => (tensors, header),
        (Some(_), None) => return Err(Error::corrupt(path, entry(HEADER), "nothing", "it beside `checksum`")),
        (None, Some(_)) => return Err(Error::corrupt(path, entry(TENSORS), "nothing", "it beside `checksum_header`")),
    };
    let entries = metadata.iter().map(|(k, v)| (k.as_str(), v.as_str())).collect();
    let infos = header.tensors();
    let descriptions = infos.iter().map(|(name, info)| {
        let (begin, end) = info.data_offsets;
        (name.as_str(), [info.dtype.to_string(), format!("{:?}", info.shape), format!("{:?}", [begin, end])])
    });
    let found = of_header(&entries, &descriptions.collect());
    if found != *header_sum {
        let expected = format!("the header's SHA-256 to be {}", shown(header_sum));
        return Err(Error::corrupt(path, entry(HEADER), format!("{found} (the header was changed)"), expected));
    }
    let sums: BTreeMap<String, String> = serde_json::from_str(tensor_sums)
        .map_err(|e| Error::corrupt(path, entry(TENSORS), e.to_string(), "a JSON object of tensor name → SHA-256"))?;
    if sums.len() != infos.len() {
        let found = format!("{} checksums", sums.len());
        return Err(Error::corrupt(
            path,
            entry(TENSORS),
            found,
            format!("one for each of the {} tensors", infos.len()),
        ));
    }
    infos.par_iter().try_for_each(|(name, info)| {
        let (begin, end) = info.data_offsets;
        let found = of_bytes(data.get(begin..end).unwrap_or(&[]));
        match sums.get(name) {
            Some(sum) if *sum == found => Ok(()),
            sum => {
                let at = format!("tensor `{name}` (bytes {begin} to {end} of the data)");
                let expected = sum.map_or("an entry in `checksum`".into(), |s| format!("SHA-256 {}", shown(s)));
                Err(Error::corrupt(path, at, format!("SHA-256 {found}"), expected))
            }
        }
    })?;
    Ok(true)
}

/// A stored checksum may be any text.
fn shown(sum: &str) -> String {
    sum.chars().take(64).collect()
}
