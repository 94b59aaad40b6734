//! 3DGS `.ply` models: read in any of the forms found in the wild, written in the one that every program reads.
//!
//! Layout (Kerbl et al. 2023, `gaussian_model.py`): element `vertex`, properties `x y z nx ny nz f_dc_0..2 f_rest_*
//! opacity scale_0..2 rot_0..3`, values before activation. `f_rest` is channel-major: `f_rest[c·(K−1) + k−1]` is channel
//! c of SH coefficient k; [`Gaussians::sh`] is `[N,K,3]`, so it is transposed here.
//!
//! Why a parser of our own: the PLY crates that exist (`ply-rs` and its successors) build a hash map per element, about a
//! hundred times slower than the disk, and their errors cannot name the byte. The format is small.

mod compressed;
mod compressed_write;
mod header;
mod read;
#[cfg(test)]
mod tests;
mod write;

use std::path::Path;

use crate::error::{Error, Result};
use crate::scene::Gaussians;

pub use compressed_write::write_compressed;
pub use write::write;

/// Reads a 3DGS `.ply`: ascii, binary little- or big-endian, any property order and types, SH degree 0–3 by the number of
/// `f_rest_*`, further properties and elements skipped; or a compressed one, as PlayCanvas and SuperSplat write it. Values are not judged here (see [`crate::file::load`]).
///
/// # Errors
/// [`Error::Corrupt`] naming the byte (ascii: the line), what was found and what was expected; [`Error::Io`].
pub fn read(path: &Path) -> Result<Gaussians> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    parse(&bytes, path)
}

/// [`read`] from memory; `path` only names the source in errors.
///
/// # Errors
/// As [`read`].
pub fn parse(bytes: &[u8], path: &Path) -> Result<Gaussians> {
    let header = header::parse(bytes, path)?;
    if compressed::is_compressed(&header) {
        return compressed::body(bytes, &header, path);
    }
    read::body(bytes, &header, path)
}

/// What of a file [`read`] does not take, one name each: further properties and elements, and normals that are not 0.
///
/// # Errors
/// As [`read`].
pub fn unread(path: &Path) -> Result<Vec<String>> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    let header = header::parse(&bytes, path)?;
    let (known, mut unread) = if compressed::is_compressed(&header) {
        (&["chunk", "vertex", "sh"][..], compressed::unread(&header))
    } else {
        (&["vertex"][..], read::unread(&bytes, &header, path)?)
    };
    let elements = header.elements.iter().filter(|e| !known.contains(&e.name.as_str()) && e.count > 0);
    unread.extend(elements.map(|e| format!("element `{}`", e.name)));
    Ok(unread)
}

/// Whether the beginning of a file is that of a compressed `.ply`.
pub(crate) fn is_compressed(head: &[u8]) -> bool {
    let end = head.windows(10).position(|w| w == b"end_header").unwrap_or(head.len());
    let name = compressed::PACKED[0].as_bytes();
    head[..end].windows(name.len()).any(|w| w == name)
}

/// The values `[N,F]` of the properties of vertices whose names are `prefix` and 0, 1, … F − 1, of a binary file.
///
/// # Errors
/// As [`read`].
pub(crate) fn numbered(path: &Path, prefix: &str) -> Result<Vec<f32>> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    read::numbered(&bytes, &header::parse(&bytes, path)?, prefix, path)
}

/// Names of the properties of the vertex element, in file order (for `inspect`).
///
/// # Errors
/// As [`read`], for the header only.
pub fn properties(bytes: &[u8], path: &Path) -> Result<Vec<String>> {
    let header = header::parse(bytes, path)?;
    Ok(header.elements[header.vertex].properties.iter().map(|p| p.name.clone()).collect())
}
