//! The `.safetensors` model: every tensor by name, version, checksums.
//!
//! | tensor | shape | meaning |
//! |---|---|---|
//! | `gaussians.mean`, `.log_scale` | `[N,3]` | canonical centres, logs of the standard deviations |
//! | `gaussians.rotation` | `[N,4]` | quaternions w,x,y,z |
//! | `gaussians.opacity_logit` | `[N]` | opacity before the sigmoid |
//! | `gaussians.sh` | `[N,K,3]` | SH coefficients, K = (degree+1)² |
//! | `superpoints.of_gaussian` | `[N]` u32 | the superpoint each Gaussian moves with |
//! | `superpoints.position` | `[M,3]` | canonical superpoint centres |
//! | `superpoints.blend_index`, `superpoints.blend_weight` | `[N,K]` u16 or u32, `[N,K]` f32 or u8 | soft superpoints ([`crate::scene::Blend`]): K ≤ 4, u8 in units of 1/255 |
//! | `motion.times` | `[T]` | strictly increasing key times |
//! | `motion.rotation`, `motion.translation` | `[T,M,3]` | so(3) vectors and translations |
//! | `association.neighbor`, `association.logit` | `[N,K']` u32, `[N,K']` | sparse association matrix |
//! | `deform.linear.{0..7}.{weight,bias}`, `deform.{translation,rotation}.{weight,bias}` | `[out,in]`, `[out]` | network F ([`crate::scene::network`]) |
//! | `field.*` | | deformation field: [`crate::scene::field`] |
//! | `nonrigid.linear.{0..2}.{weight,bias}`, `nonrigid.{translation,rotation,scaling}.{weight,bias}` | `[out,in]`, `[out]` | network G |
//! | any other f32 tensor | any | kept as it is in [`Scene::extra`] |
//!
//! All little-endian f32 unless said. `__metadata__` holds `format` = `spgs`, `version` = `1`, whatever
//! [`Scene::metadata`] holds, and two checksums that are there together or not at all (a file without them is read with a
//! warning):
//!
//! - `checksum`: a JSON object, tensor name → hexadecimal SHA-256 of the tensor's bytes;
//! - `checksum_header`: SHA-256 of the rest of the header as texts, each preceded by its length (u64): key and value of
//!   every metadata entry but this, by key, then per tensor, by name: name, dtype, shape (`[2, 3]`), offsets (`[0, 24]`).
//!
//! Any changed bit is thus found. Equal scenes give equal files, byte for byte.

pub(super) mod deformation;
mod read;
#[cfg(test)]
mod tests;
mod write;

use std::path::Path;

use crate::error::Result;
use crate::file::tensors::parse_header;
use crate::gpu::mmap::map_file;
use crate::scene::Scene;

pub use write::write;

/// Value of the metadata entry `format`.
pub const FORMAT: &str = "spgs";
/// Value of the metadata entry `version`; other versions are refused.
pub const VERSION: &str = "1";
/// Metadata entry: `true` where [`Gaussians::antialiased`](crate::scene::Gaussians::antialiased), else absent.
const ANTIALIASED: &str = "antialiased";

/// A tensor as the header describes it.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct TensorInfo {
    /// Name.
    pub name: String,
    /// Element type, as safetensors names it ("F32").
    pub dtype: String,
    /// Dimensions.
    pub shape: Vec<usize>,
    /// Size.
    pub bytes: usize,
}

/// Reads a model, memory-mapped; checks every shape, type, index and checksum. Parameters of Gaussians are not judged here
/// (see [`crate::file::load`]). Also returns warnings.
///
/// # Errors
/// [`crate::Error::Corrupt`] naming the tensor or metadata entry; [`crate::Error::Io`].
pub fn read(path: &Path) -> Result<(Scene, Vec<String>)> {
    parse(&map_file(path)?, path)
}

/// [`read`] from memory; `path` only names the source in errors.
///
/// # Errors
/// As [`read`].
pub fn parse(bytes: &[u8], path: &Path) -> Result<(Scene, Vec<String>)> {
    read::model(bytes, path)
}

/// The tensors of a file, by offset.
///
/// # Errors
/// [`crate::Error::Corrupt`].
pub fn tensors(bytes: &[u8], path: &Path) -> Result<Vec<TensorInfo>> {
    let (_, header) = parse_header(bytes, path)?;
    let mut infos: Vec<_> = header.tensors().into_iter().collect();
    // Empty tensors share an offset.
    infos.sort_by(|(a, x), (b, y)| x.data_offsets.cmp(&y.data_offsets).then_with(|| a.cmp(b)));
    let described = infos.into_iter().map(|(name, info)| {
        let (begin, end) = info.data_offsets;
        TensorInfo { name, dtype: info.dtype.to_string(), shape: info.shape.clone(), bytes: end - begin }
    });
    Ok(described.collect())
}
