//! glTF with `KHR_gaussian_splatting`, as binary `.glb`.
//!
//! One primitive of points: `POSITION`, and `KHR_gaussian_splatting:` `ROTATION` (x,y,z,w), `SCALE` (standard deviations),
//! `OPACITY` (0 to 1), `SH_DEGREE_l_COEF_n` (red, green, blue). glTF's axes are right, up, back; ours right, down, front:
//! the node that holds the points turns them by 180° about x, so that values stay as they are.

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
/// Component type: f32.
const FLOAT: u64 = 5126;
/// Quaternion x,y,z,w of the node that turns our axes into glTF's.
const TURN: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
