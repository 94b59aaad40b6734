//! Twin of `glsl/lib/splat.glsl`: how a projected splat is stored. `packing` is the specialisation constant: 0 f32, 1 with
//! colour and opacity in f16.

use super::half;
use super::twin::{f32_at, vec4_at};

/// A projected splat: (mean px, l11, l12), (l22, log2 opacity, z, 0), (r, g, b, 0).
pub type Splat = [[f32; 4]; 3];

/// Words per splat.
pub fn splat_words(packing: u32) -> usize {
    if packing == 1 { 8 } else { 12 }
}

/// The opacity as it will be read back.
pub fn round_opacity(packing: u32, log2_opacity: f32) -> f32 {
    let [rounded, _] = half::unpack(half::pack([log2_opacity, 0.0]));
    if packing == 1 { rounded } else { log2_opacity }
}

/// The words of a splat; the first [`splat_words`] count.
pub fn pack_splat(packing: u32, [first, second, colour]: Splat) -> [u32; 12] {
    let mut words = [0; 12];
    words[..4].copy_from_slice(&first.map(f32::to_bits));
    words[4..7].copy_from_slice(&[second[0], second[1], second[2]].map(f32::to_bits));
    if packing == 1 {
        let [r, g, b, _] = colour.map(|v| v.min(half::HALF_MAX));
        words[5] = half::pack([r, g]);
        words[7] = half::pack([b, second[1]]);
    } else {
        words[8..11].copy_from_slice(&[colour[0], colour[1], colour[2]].map(f32::to_bits));
    }
    words
}

/// Splat `index` of a buffer.
pub fn unpack_splat(packing: u32, words: &[u32], index: usize) -> Splat {
    let w = &words[splat_words(packing) * index..];
    let (first, mut second) = (vec4_at(w, 0), vec4_at(w, 1));
    second[3] = 0.0;
    if packing == 1 {
        let ([r, g], [b, log2_opacity]) = (half::unpack(w[5]), half::unpack(w[7]));
        second[1] = log2_opacity;
        return [first, second, [r, g, b, 0.0]];
    }
    [first, second, [f32_at(w, 8), f32_at(w, 9), f32_at(w, 10), 0.0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_packings_keep_what_they_promise() {
        let splat = [[512.3, -17.25, 0.7, -0.31], [0.9, -0.4, 3.7, 0.0], [0.2, 0.75, 0.999, 0.0]];
        for (packing, words, limit) in [(0, 12, 0.0), (1, 8, 5e-4)] {
            assert_eq!(splat_words(packing), words);
            let log2_opacity = round_opacity(packing, splat[1][1]);
            let rounded = [splat[0], [splat[1][0], log2_opacity, splat[1][2], 0.0], splat[2]];
            let mut buffer = vec![u32::MAX; words];
            buffer.extend(&pack_splat(packing, rounded)[..words]);
            let back = unpack_splat(packing, &buffer, 1);
            assert_eq!(back[..2], rounded[..2], "{packing}: counting and drawing see the same ellipse");
            assert!((log2_opacity - splat[1][1]).abs() <= limit);
            for (a, b) in back[2].iter().zip(splat[2]) {
                assert!((a - b).abs() <= limit, "{packing}: {back:?}");
            }
        }
    }

    #[test]
    fn extremes_stay_finite() {
        let splat = [[0.0; 4], [0.0; 4], [1e9, 0.0, 2.0, 0.0]];
        assert_eq!(unpack_splat(1, &pack_splat(1, splat), 0)[2], [half::HALF_MAX, 0.0, 2.0, 0.0]);
    }
}
