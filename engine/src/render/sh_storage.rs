//! SH coefficients on the device: one buffer per band, planes of N (plane = (k − b²)·3 + channel of coefficient k).
//!
//! | `SH_STORAGE` | words |
//! |---|---|
//! | 0, f32 | plane p of Gaussian g at `p·N + g` |
//! | 1, f16 | planes 2w and 2w + 1 in the halves of `w·N + g` |
//! | 2, u8 | planes 4w … 4w + 3 in the bytes of `w·N + g`; after ⌈planes/4⌉·N words, low and step of each plane: value = low + level · step. Band 0 is stored as f16 |

use super::half;
use super::quality::Storage;
use super::twin::f32_at;

/// The storage that a band has: band 0 is never coarser than f16.
fn of_band(storage: u32, band: usize) -> u32 {
    if band == 0 { storage.min(1) } else { storage }
}

/// Words of a band from its f32 planes (`[planes][n]`).
pub fn encode(storage: Storage, band: usize, values: &[f32], n: usize) -> Vec<u32> {
    if n == 0 || values.is_empty() {
        return Vec::new();
    }
    let planes = values.len() / n;
    let at = |p: usize, g: usize| if p < planes { values[p * n + g] } else { 0.0 };
    match of_band(storage.constant(), band) {
        0 => values.iter().map(|v| v.to_bits()).collect(),
        1 => {
            let limited = |p, g| at(p, g).clamp(-half::HALF_MAX, half::HALF_MAX);
            let word = |w: usize, g| half::pack([limited(2 * w, g), limited(2 * w + 1, g)]);
            (0..planes.div_ceil(2)).flat_map(|w| (0..n).map(move |g| word(w, g))).collect()
        }
        _ => {
            let ranges: Vec<[f32; 2]> = values.chunks_exact(n).map(range).collect();
            let level = |p: usize, g: usize| -> u32 {
                let Some([low, step]) = ranges.get(p) else { return 0 };
                if *step > 0.0 { ((at(p, g) - low) / step).round().clamp(0.0, 255.0) as u32 } else { 0 }
            };
            let word = |w: usize, g| (0..4).map(|i| level(4 * w + i, g) << (8 * i)).sum();
            let mut words: Vec<u32> =
                (0..planes.div_ceil(4)).flat_map(|w| (0..n).map(move |g| (w, g))).map(|(w, g)| word(w, g)).collect();
            words.extend(ranges.iter().flatten().map(|v| v.to_bits()));
            words
        }
    }
}

/// Low and step of 256 levels over the finite values of a plane.
fn range(values: &[f32]) -> [f32; 2] {
    let finite = values.iter().filter(|v| v.is_finite());
    let (low, high) = finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    if low < high {
        [low, (high / 255.0 - low / 255.0).max(f32::MIN_POSITIVE)]
    } else {
        [if low.is_finite() { low } else { 0.0 }, 0.0]
    }
}

/// Plane `p` of Gaussian `g` in a band's buffer: the twin of `SH_COEFFICIENT` in `deform_project.comp`.
pub fn coefficient(words: &[u32], storage: u32, band: usize, p: usize, n: usize, g: usize) -> f32 {
    match of_band(storage, band) {
        0 => f32_at(words, p * n + g),
        1 => half::unpack(words[p / 2 * n + g])[p % 2],
        _ => {
            let range = (3 * (2 * band + 1)).div_ceil(4) * n + 2 * p;
            let level = words[p / 4 * n + g] >> (8 * (p % 4)) & 255;
            f32_at(words, range) + level as f32 * f32_at(words, range + 1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_storage_gives_back_within_half_a_step() {
        let n = 5;
        for band in 0..4_usize {
            let planes = 3 * (2 * band + 1);
            let values: Vec<f32> =
                (0..planes * n).map(|i| ((i * 37 % 101) as f32 / 50.0 - 1.0) * (1 + i / n) as f32).collect();
            for storage in [Storage::F32, Storage::F16, Storage::Bits8] {
                let words = encode(storage, band, &values, n);
                for (i, value) in values.iter().enumerate() {
                    let (p, g) = (i / n, i % n);
                    let [_, step] = range(&values[p * n..][..n]);
                    let bound = match of_band(storage.constant(), band) {
                        0 => 0.0,
                        1 => value.abs() / 2048.0,
                        _ => 0.5001 * step,
                    };
                    let back = coefficient(&words, storage.constant(), band, p, n, g);
                    assert!((back - value).abs() <= bound, "{storage:?} band {band} plane {p}: {value} became {back}");
                }
            }
        }
    }

    #[test]
    fn constant_and_missing_planes_are_kept() {
        assert!(encode(Storage::Bits8, 1, &[], 3).is_empty());
        let words = encode(Storage::Bits8, 1, &[0.25; 18], 2);
        assert_eq!(coefficient(&words, 2, 1, 8, 2, 1), 0.25);
        let spoilt = encode(Storage::Bits8, 1, &[f32::NAN; 18], 2);
        assert_eq!(coefficient(&spoilt, 2, 1, 0, 2, 0), 0.0);
    }
}
