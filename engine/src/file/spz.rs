//! `.spz` of Niantic: about a tenth of a `.ply`. Versions 2 and 3 are one gzip stream, version 4 has a plain header and a
//! zstd stream per attribute.
//!
//! Header (versions 2 and 3, unpacked): u32 magic `NGSP`, u32 version, u32 N, u8 SH degree, u8 fractional bits, u8 flags,
//! u8 0. Version 4: the same 15 bytes, u8 number of streams, u32 offset of the table (from 32, after extension records),
//! 12 reserved bytes; the table holds (u64 packed, u64 unpacked) sizes. Attributes in order, each for all Gaussians:
//!
//! | attribute | bytes | value |
//! |---|---|---|
//! | centre | 3·3 | 24-bit integers / 2^(fractional bits) |
//! | opacity | 1 | after the sigmoid, ·255 |
//! | colour | 3 | 0.5 + 0.15·coefficient, ·255 |
//! | log scale | 3 | (s + 10)·16 |
//! | rotation | 3 (version 2), 4 | x, y, z with w ≥ 0; or the index of the largest of x,y,z,w and the others in 10 bits |
//! | SH | 3·(K − 1) | coefficient-major, 128 + 128·value |
//!
//! Its axes are right, up, back (RUB); ours and the `.ply` family's are right, down, front, so y and z change sign, in the
//! quaternions and in the odd SH functions too, as in Niantic's own converters.
//!
//! Where flag 2 is set, extension records lie before the table (version 4) or after the attributes (2 and 3): u32 type, u32
//! length, as many bytes (<https://github.com/nianticlabs/spz/blob/main/extensions/README.md>). The one that says other axes
//! is followed; the rest cannot change how a scene looks, and are named and skipped.

mod extensions;
mod read;
#[cfg(test)]
mod tests;
mod write;

use crate::scene::Gaussians;

pub use read::parse;
pub use write::{Version, write};

/// `NGSP`.
pub(crate) const MAGIC: [u8; 4] = *b"NGSP";
/// Begins a gzip stream.
pub(crate) const GZIP: [u8; 2] = [0x1f, 0x8b];
/// Scale of colours: wider than the range of colours, so that SH degree 0 may leave it.
const COLOR_SCALE: f64 = 0.15;
/// Bytes of the header in a gzip stream.
const HEADER: usize = 16;
/// Bytes of the header of version 4.
const HEADER_4: usize = 32;
/// Flag: trained with the antialiased rasteriser.
const ANTIALIASED: u8 = 1;
/// Flag: there are extension records.
const HAS_EXTENSIONS: u8 = 2;
/// Largest magnitude of a stored part of a quaternion: 9 bits for 0 to 1/√2.
const PART_MAX: f64 = 511.0;
/// SH functions that change sign with y and z: those odd in y plus z together, degrees 1 to 3 without 0.
const ODD_IN_YZ: [bool; 15] =
    [true, true, false, true, false, false, true, false, true, false, true, true, false, true, false];

/// Turns axes right-up-back into right-down-front, or back: the same operation.
pub(crate) fn flip_axes(g: &mut Gaussians) {
    for (mean, q) in g.mean.iter_mut().zip(&mut g.rotation) {
        *mean = [mean[0], -mean[1], -mean[2]];
        *q = [q[0], q[1], -q[2], -q[3]];
    }
    let k = g.sh_coefficients();
    for sh in g.sh.chunks_exact_mut(3 * k) {
        let odd = sh[3..].chunks_exact_mut(3).zip(ODD_IN_YZ).filter(|(_, odd)| *odd);
        odd.for_each(|(c, _)| c.iter_mut().for_each(|v| *v = -*v));
    }
}
