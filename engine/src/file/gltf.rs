//! glTF with `KHR_gaussian_splatting`: binary `.glb`, or `.gltf` with its buffers in other files or within.
//!
//! Primitives of points: `POSITION`, and `KHR_gaussian_splatting:` `ROTATION` (x,y,z,w), `SCALE` (standard deviations),
//! `OPACITY` (0 to 1), `SH_DEGREE_l_COEF_n` (red, green, blue). glTF's axes are right, up, back; ours right, down, front:
//! what is written is held by a node that turns it by 180° about x, so that values stay as they are. All primitives of the
//! default scene are read, each under the transforms of its nodes.
//!
//! Instead of the attributes there may be a [`.spz`](super::spz) in a buffer view: `KHR_gaussian_splatting_compression_spz_2`
//! (a draft, <https://github.com/KhronosGroup/glTF/pull/2531>; earlier `…_spz`) within the extension, or alone the
//! `KHR_spz_gaussian_splats_compression` that it was before (<https://github.com/KhronosGroup/glTF/pull/2490>). Both drafts
//! say to unpack it in left-up-front axes, which are half a turn about y from those of the file. `CesiumJS`, for which the
//! drafts' files were made, takes the numbers as they are stored (`UNSPECIFIED` in its `GltfSpzLoader.js`): so do we, unless
//! the extension has the `kernel` that it has required since it was completed.

mod document;
mod nodes;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub use read::parse;
pub use write::write;

/// Begins a `.glb`.
pub(crate) const MAGIC: [u8; 4] = *b"glTF";
/// Kind of the chunk with the description.
const JSON: u32 = 0x4e4f_534a;
/// Kind of the chunk with the numbers.
const BIN: u32 = 0x004e_4942;
/// Name of the extension, and prefix of its attributes.
const EXTENSION: &str = "KHR_gaussian_splatting";
/// Extensions within it that hold a `.spz`.
const SPZ: [&str; 2] = ["KHR_gaussian_splatting_compression_spz_2", "KHR_gaussian_splatting_compression_spz"];
/// The same before there was the other.
const SPZ_ALONE: &str = "KHR_spz_gaussian_splats_compression";
/// Component type: f32.
const FLOAT: u64 = 5126;
/// Quaternion x,y,z,w of the node that turns our axes into glTF's.
const TURN: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
