//! Counter-based random numbers without state: a value depends on (seed, stream, index, draw) only, so results do not
//! depend on order or thread count. The integers equal those of `glsl/lib/random.glsl`.
//!
//! Hash: the four-word one of Jarzynski and Olano, "Hash Functions for GPU Rendering" (JCGT 2020), applied to the seed and
//! stream and then to its result combined with index and draw.

use std::f32::consts::TAU;

use crate::render::angle::sin_cos;

/// One application of the four-word hash.
fn hash(v: [u32; 4]) -> [u32; 4] {
    let [mut x, mut y, mut z, mut w] = v.map(|c| c.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    for round in 0..2 {
        x = x.wrapping_add(y.wrapping_mul(w));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        w = w.wrapping_add(y.wrapping_mul(z));
        if round == 0 {
            [x, y, z, w] = [x, y, z, w].map(|c| c ^ (c >> 16));
        }
    }
    [x, y, z, w]
}

/// 128 random bits; twin of `random_words`.
pub fn words(seed: u64, stream: u32, index: [u32; 2], draw: u32) -> [u32; 4] {
    let key = hash([seed as u32, (seed >> 32) as u32, stream, 0]);
    hash([key[0] ^ index[0], key[1] ^ index[1], key[2] ^ draw, key[3]])
}

/// 64 random bits.
pub fn bits(seed: u64, stream: u32, index: u64) -> u64 {
    let [low, high, ..] = words(seed, stream, [index as u32, (index >> 32) as u32], 0);
    u64::from(low) | u64::from(high) << 32
}

/// Uniform in [0, 1), in f64.
pub fn uniform(seed: u64, stream: u32, index: u64) -> f64 {
    (bits(seed, stream, index) >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// Standard normal (Box and Muller), in f64.
pub fn normal(seed: u64, stream: u32, index: u64) -> f64 {
    let [a, b, c, d] = words(seed, stream, [index as u32, (index >> 32) as u32], 1);
    let unit =
        |low: u32, high: u32| ((u64::from(low) | u64::from(high) << 32) >> 11) as f64 * (1.0 / (1_u64 << 53) as f64);
    (-2.0 * (1.0 - unit(a, b)).ln()).sqrt() * (std::f64::consts::TAU * unit(c, d)).cos()
}

/// Uniform in [0, 1), a multiple of 2⁻²⁴; twin of `random_uniform`.
pub fn uniform_f32(word: u32) -> f32 {
    (word >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Two standard normals from two words; twin of `random_normals`.
pub fn normals_f32(a: u32, b: u32) -> [f32; 2] {
    let radius = (-2.0 * (1.0 - uniform_f32(a)).ln()).sqrt();
    let [sine, cosine] = sin_cos(TAU * uniform_f32(b));
    [radius * cosine, radius * sine]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_independence_and_repeatability() {
        let n = 40_000;
        let moments = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            (mean, values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len() as f64)
        };
        let normals: Vec<f64> = (0..n).map(|i| normal(7, 1, i)).collect();
        let (mean, variance) = moments(&normals);
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
        let uniforms: Vec<f64> = (0..n).map(|i| uniform(7, 1, i)).collect();
        let (mean, variance) = moments(&uniforms);
        assert!((mean - 0.5).abs() < 0.005 && (variance - 1.0 / 12.0).abs() < 0.002, "{mean} {variance}");
        // Neighbours in index, stream and seed are not correlated.
        let shifts: [&dyn Fn(u64) -> f64; 3] =
            [&|i| uniform(7, 1, i + 1), &|i| uniform(7, 2, i), &|i| uniform(8, 1, i)];
        for other in shifts {
            let products: Vec<f64> = (0..n).map(|i| (uniforms[i as usize] - 0.5) * (other(i) - 0.5)).collect();
            assert!(moments(&products).0.abs() < 0.002, "{}", moments(&products).0);
        }
        assert_eq!(words(7, 1, [3, 4], 5), words(7, 1, [3, 4], 5));
        assert_ne!(words(7, 1, [3, 4], 5), words(7, 1, [4, 3], 5));
        let pairs: Vec<f64> = (0..n as u32)
            .flat_map(|i| {
                let [a, b, ..] = words(1, 2, [i, 0], 0);
                normals_f32(a, b).map(f64::from)
            })
            .collect();
        let (mean, variance) = moments(&pairs);
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
    }
}
