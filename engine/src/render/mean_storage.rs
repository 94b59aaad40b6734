//! Centres on the device, `[3][N]`.
//!
//! | `MEAN_STORAGE` | words |
//! |---|---|
//! | 0, f32 | coordinate c of Gaussian g at `c·N + g` |
//! | 1, unorm16 | x and y in the halves of `g`; z in half `g mod 2` of `N + g/2`; after N + ⌈N/2⌉ words, low and step of x, y, z: value = low + level · step. Level 65535 stands for NaN |

use super::quality::Storage;
use super::twin::f32_at;

/// Levels of a coordinate between its least and greatest value; the next one stands for NaN.
const LEVELS: f32 = 65_534.0;
/// Level of a centre that is not finite.
const NOT_FINITE: u32 = 65_535;

/// Value of the specialisation constant.
pub fn constant(storage: Storage) -> u32 {
    u32::from(storage != Storage::F32)
}

/// Bytes per centre.
pub fn bytes(storage: Storage) -> u64 {
    if storage == Storage::F32 { 12 } else { 6 }
}

/// The words of `mean [N,3]`, at most half a step off.
pub fn encode(storage: Storage, mean: &[[f32; 3]]) -> Vec<u32> {
    let n = mean.len();
    if storage == Storage::F32 || n == 0 {
        return (0..3).flat_map(|c| mean.iter().map(move |m| m[c].to_bits())).collect();
    }
    let ranges: [[f32; 2]; 3] = std::array::from_fn(|c| range(mean, c));
    let level = |m: &[f32; 3], c: usize| {
        let [low, step] = ranges[c];
        let finite = m.iter().all(|v| v.is_finite());
        if !finite {
            NOT_FINITE
        } else if step > 0.0 {
            ((m[c] - low) / step).round().clamp(0.0, LEVELS) as u32
        } else {
            0
        }
    };
    let mut words: Vec<u32> = mean.iter().map(|m| level(m, 0) | level(m, 1) << 16).collect();
    words.extend(mean.chunks(2).map(|pair| level(&pair[0], 2) | pair.get(1).map_or(0, |m| level(m, 2)) << 16));
    words.extend(ranges.as_flattened().iter().map(|v| v.to_bits()));
    words
}

/// Low and step of one coordinate over the finite centres.
fn range(mean: &[[f32; 3]], c: usize) -> [f32; 2] {
    let finite = mean.iter().filter(|m| m.iter().all(|v| v.is_finite())).map(|m| m[c]);
    let (low, high) = finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    match low < high {
        true => [low, (high / LEVELS - low / LEVELS).max(f32::MIN_POSITIVE)],
        false => [if low.is_finite() { low } else { 0.0 }, 0.0],
    }
}

/// Centre of Gaussian `g` of `n`: the twin of `read_mean` in `deform_project.comp`.
pub fn centre(words: &[u32], storage: u32, n: usize, g: usize) -> [f32; 3] {
    if storage == 0 {
        return std::array::from_fn(|c| f32_at(words, c * n + g));
    }
    let (xy, z) = (words[g], words[n + g / 2] >> (16 * (g % 2)) & 0xFFFF);
    let levels = [xy & 0xFFFF, xy >> 16, z];
    if levels[0] == NOT_FINITE {
        return [f32::NAN; 3];
    }
    let range = n + n.div_ceil(2);
    std::array::from_fn(|c| f32_at(words, range + 2 * c) + levels[c] as f32 * f32_at(words, range + 2 * c + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centres_come_back_within_half_a_step() {
        for n in [1, 2, 7, 300] {
            let mut mean: Vec<[f32; 3]> =
                (0..n).map(|i| [i as f32 * 0.37 - 4.0, (i * i % 97) as f32 * 1e3, 5.0 - (i % 5) as f32]).collect();
            if n > 2 {
                mean[1] = [1.0, f32::NAN, 2.0];
            }
            for storage in [Storage::F32, Storage::Unorm16] {
                let words = encode(storage, &mean);
                for (g, m) in mean.iter().enumerate() {
                    let back = centre(&words, constant(storage), n, g);
                    for c in 0..3 {
                        let bound = if storage == Storage::F32 { 0.0 } else { 0.51 * range(&mean, c)[1] };
                        if m[1].is_nan() {
                            assert!(back[1].is_nan() && (storage == Storage::F32 || back[0].is_nan()));
                        } else {
                            assert!((back[c] - m[c]).abs() <= bound, "{g}: {m:?} became {back:?}");
                        }
                    }
                }
            }
        }
        assert!(encode(Storage::Unorm16, &[]).is_empty());
        assert!(centre(&encode(Storage::Unorm16, &[[f32::NAN; 3]]), 1, 1, 0)[0].is_nan());
    }

    #[test]
    fn a_plane_and_one_place_are_kept() {
        let words = encode(Storage::Unorm16, &[[3.0, 1.0, -2.0], [3.0, 2.0, -2.0]]);
        assert_eq!(centre(&words, 1, 2, 1), [3.0, 2.0, -2.0]);
    }
}
