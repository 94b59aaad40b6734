//! Writes a compressed `.ply` (layout: [`super::compressed`]).

use std::io::{self, Write};
use std::path::Path;

use super::compressed::{BOUNDS, CHUNK, PACKED};
use crate::error::Result;
use crate::file::check;
use crate::file::codec::{SH_C0, bounds, morton_order, sigmoid, smallest_three, to_byte, unit};
use crate::file::durable::write_atomic;
use crate::scene::Gaussians;

/// Log scales are clamped to ±this, as every writer of the format does: a bound of infinity would spoil its chunk.
const MAX_LOG_SCALE: f32 = 20.0;

/// Writes a compressed `.ply`, durably: Gaussians in Morton order, so that chunks are small and their fields precise.
///
/// # Errors
/// [`crate::Error::Usage`] when the arrays' lengths disagree; [`crate::Error::Io`].
pub fn write_compressed(path: &Path, gaussians: &Gaussians) -> Result<()> {
    check::gaussians(gaussians).map_err(|problem| problem.usage(path))?;
    let order = morton_order(&gaussians.mean);
    let chunks: Vec<Chunk> = order.chunks(CHUNK).map(|indices| Chunk::new(gaussians, indices)).collect();
    write_atomic(path, |out| {
        out.write_all(header(gaussians).as_bytes())?;
        let numbers = chunks.iter().flat_map(|c| c.bounds.iter().flatten().flatten());
        numbers.into_iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))?;
        for (chunk, indices) in chunks.iter().zip(order.chunks(CHUNK)) {
            indices.iter().try_for_each(|&i| out.write_all(&chunk.pack(gaussians, i)))?;
        }
        spherical_harmonics(out, gaussians, &order)
    })
}

fn header(g: &Gaussians) -> String {
    let list = |kind: &str, names: &mut dyn Iterator<Item = String>| -> String {
        names.map(|name| format!("property {kind} {name}\n")).collect()
    };
    let n = g.len();
    let mut text = format!(
        "ply\nformat binary_little_endian 1.0\nelement chunk {}\n{}element vertex {n}\n{}",
        n.div_ceil(CHUNK),
        list("float", &mut BOUNDS.iter().map(ToString::to_string)),
        list("uint", &mut PACKED.iter().map(ToString::to_string)),
    );
    if g.sh_degree > 0 {
        let names = &mut (0..3 * (g.sh_coefficients() - 1)).map(|i| format!("f_rest_{i}"));
        text += &format!("element sh {n}\n{}", list("uchar", names));
    }
    text + "end_header\n"
}

/// Bounds of centre, log scale and colour: lows, then highs.
struct Chunk {
    bounds: [[[f32; 3]; 2]; 3],
}

fn log_scale(g: &Gaussians, i: usize) -> [f32; 3] {
    g.log_scale[i].map(|s| s.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE))
}

fn color(g: &Gaussians, i: usize) -> [f32; 3] {
    let sh = &g.sh[i * g.sh_coefficients() * 3..];
    std::array::from_fn(|c| (0.5 + SH_C0 * f64::from(sh[c])) as f32)
}

impl Chunk {
    fn new(g: &Gaussians, indices: &[usize]) -> Self {
        let of = |value: &dyn Fn(usize) -> [f32; 3]| {
            let values: Vec<[f32; 3]> = indices.iter().map(|&i| value(i)).collect();
            let bounds = bounds(&values);
            [0, 1].map(|end| bounds.map(|b| b[end] as f32))
        };
        Self { bounds: [of(&|i| g.mean[i]), of(&|i| log_scale(g, i)), of(&|i| color(g, i))] }
    }

    /// The share of each component between the bounds.
    fn share(&self, attribute: usize, value: [f32; 3]) -> [f64; 3] {
        let [low, high] = self.bounds[attribute].map(|b| b.map(f64::from));
        std::array::from_fn(
            |a| {
                if high[a] > low[a] { (f64::from(value[a]) - low[a]) / (high[a] - low[a]) } else { 0.0 }
            },
        )
    }

    fn pack(&self, g: &Gaussians, i: usize) -> [u8; 16] {
        let [red, green, blue] = self.share(2, color(g, i)).map(to_byte);
        let fields = [
            pack_11_10_11(self.share(0, g.mean[i])),
            pack_rotation(unit(g.rotation[i])),
            pack_11_10_11(self.share(1, log_scale(g, i))),
            u32::from_be_bytes([red, green, blue, to_byte(sigmoid(g.opacity_logit[i]))]),
        ];
        let mut bytes = [0; 16];
        bytes.chunks_exact_mut(4).zip(fields).for_each(|(place, f)| place.copy_from_slice(&f.to_le_bytes()));
        bytes
    }
}

/// A share in so many bits.
fn bits(share: f64, bits: u32) -> u32 {
    (share.clamp(0.0, 1.0) * f64::from((1u32 << bits) - 1)).round() as u32
}

fn pack_11_10_11([x, y, z]: [f64; 3]) -> u32 {
    bits(x, 11) << 21 | bits(y, 10) << 11 | bits(z, 11)
}

fn pack_rotation(q: [f64; 4]) -> u32 {
    let (largest, rest) = smallest_three(q);
    let [a, b, c] = rest.map(|v| bits(v / std::f64::consts::SQRT_2 + 0.5, 10));
    (largest as u32) << 30 | a << 20 | b << 10 | c
}

fn spherical_harmonics(out: &mut dyn Write, g: &Gaussians, order: &[usize]) -> io::Result<()> {
    let k = g.sh_coefficients();
    let mut row = vec![0; 3 * (k - 1)];
    for &i in order {
        let sh = &g.sh[i * k * 3..(i + 1) * k * 3];
        for (j, byte) in row.iter_mut().enumerate() {
            let value = f64::from(sh[(1 + j % (k - 1)) * 3 + j / (k - 1)]);
            *byte = ((value / 8.0 + 0.5) * 256.0).floor().clamp(0.0, 255.0) as u8;
        }
        out.write_all(&row)?;
    }
    Ok(())
}
