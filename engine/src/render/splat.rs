//! Twin of `glsl/lib/splat.glsl`: how a projected splat is stored. `packing` is the specialisation constant: colour + 4 ·
//! conic; colour 0 f32, 1 f16, 2 unorm8; conic 0 f32, 1 f16.

use super::half;
use super::twin::{f32_at, vec4_at};

/// Smallest root of a conic that is kept in half precision: the smallest normal half.
const MIN_CONIC_F16: f32 = 6.103_515_6e-5;

/// A projected splat: (mean px, l11, l12), (l22, log2 opacity, z, 0), (r, g, b, 0).
pub type Splat = [[f32; 4]; 3];

/// Words per splat.
pub fn splat_words(packing: u32) -> usize {
    if packing >= 4 || packing & 3 == 2 { 8 } else { 12 }
}

/// The conic (l11, l12, l22) and the opacity as they will be read back.
pub fn round_conic(packing: u32, conic: [f32; 3], log2_opacity: f32) -> ([f32; 3], f32) {
    if packing < 4 {
        return (conic, log2_opacity);
    }
    let [l11, l12] = half::unpack(half::pack([conic[0].max(MIN_CONIC_F16), conic[1]]));
    let [l22, log2_opacity] = half::unpack(half::pack([conic[2].max(MIN_CONIC_F16), log2_opacity]));
    ([l11, l12, l22], log2_opacity)
}

/// The words of a splat; the first [`splat_words`] count.
pub fn pack_splat(packing: u32, [first, second, colour]: Splat) -> [u32; 12] {
    let format = packing & 3;
    let bits = |v: f32| v.to_bits();
    let [r, g, b, _] = colour;
    let packed = match format {
        0 => [bits(r), bits(g), bits(b)],
        1 => {
            let [r, g, b] = [r, g, b].map(|v| v.min(half::HALF_MAX));
            [half::pack([r, g]), half::pack([b, 0.0]), 0]
        }
        _ => {
            let level = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round_ties_even() as u32;
            [level(r) | level(g) << 8 | level(b) << 16, 0, 0]
        }
    };
    let mut words = [0; 12];
    words[..4].copy_from_slice(&first.map(bits));
    words[4..7].copy_from_slice(&[second[0], second[1], second[2]].map(bits));
    if packing >= 4 {
        words[2] = half::pack([first[2], first[3]]);
        words[3] = half::pack([second[0], second[1]]);
        words[4..8].copy_from_slice(&[packed[0], packed[1], bits(second[2]), packed[2]]);
    } else if format == 2 {
        words[7] = packed[0];
    } else if format == 1 {
        let [r, g] = half::unpack(packed[0]);
        words[8..11].copy_from_slice(&[r, g, half::unpack(packed[1])[0]].map(bits));
    } else {
        words[8..11].copy_from_slice(&packed);
    }
    words
}

/// Splat `index` of a buffer.
pub fn unpack_splat(packing: u32, words: &[u32], index: usize) -> Splat {
    let at = splat_words(packing) * index;
    let w = &words[at..];
    let (mut first, mut second) = (vec4_at(w, 0), vec4_at(w, 1));
    second[3] = 0.0;
    let unorm8 = |word: u32| [0, 8, 16].map(|shift| (word >> shift & 255) as f32 / 255.0);
    let colour = match (packing >= 4, packing & 3) {
        (false, 2) => unorm8(w[7]),
        (false, _) => [f32_at(w, 8), f32_at(w, 9), f32_at(w, 10)],
        (true, 0) => [f32_at(w, 4), f32_at(w, 5), f32_at(w, 7)],
        (true, 1) => {
            let [r, g] = half::unpack(w[4]);
            [r, g, half::unpack(w[5])[0]]
        }
        (true, _) => unorm8(w[4]),
    };
    if packing >= 4 {
        [first[2], first[3]] = half::unpack(w[2]);
        [second[0], second[1]] = half::unpack(w[3]);
    }
    [first, second, [colour[0], colour[1], colour[2], 0.0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_packing_keeps_what_it_promises() {
        let splat = [[512.3, -17.25, 0.7, -0.31], [0.9, -0.4, 3.7, 0.0], [0.2, 0.75, 0.999, 0.0]];
        for (packing, words, conic, colour) in [
            (0, 12, 0.0, 0.0),
            (1, 12, 0.0, 5e-4),
            (2, 8, 0.0, 2e-3),
            (4, 8, 5e-4, 0.0),
            (5, 8, 5e-4, 5e-4),
            (6, 8, 5e-4, 2e-3),
        ] {
            assert_eq!(splat_words(packing), words);
            let (conic_values, log2_opacity) =
                round_conic(packing, [splat[0][2], splat[0][3], splat[1][0]], splat[1][1]);
            let rounded = [
                [splat[0][0], splat[0][1], conic_values[0], conic_values[1]],
                [conic_values[2], log2_opacity, splat[1][2], 0.0],
                splat[2],
            ];
            let mut buffer = vec![u32::MAX; words];
            buffer.extend(&pack_splat(packing, rounded)[..words]);
            let back = unpack_splat(packing, &buffer, 1);
            assert_eq!(back[0], rounded[0], "{packing}: counting and drawing see the same ellipse");
            assert_eq!(back[1], rounded[1], "{packing}");
            for (limit, range) in [(conic, 0..2), (colour, 2..3)] {
                for i in range {
                    for (a, b) in back[i].iter().zip(splat[i]) {
                        assert!((a - b).abs() <= limit, "{packing}: {back:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn extremes_stay_finite_and_drawable() {
        let (conic, _) = round_conic(4, [1e-12, 0.0, 1e-30], -3.0);
        assert!(conic[0] > 0.0 && conic[2] > 0.0);
        let splat = [[0.0; 4], [0.0; 4], [1e9, 0.0, 2.0, 0.0]];
        let f16 = unpack_splat(5, &pack_splat(5, splat), 0)[2];
        let unorm = unpack_splat(6, &pack_splat(6, splat), 0)[2];
        assert_eq!((f16, unorm), ([half::HALF_MAX, 0.0, 2.0, 0.0], [1.0, 0.0, 1.0, 0.0]));
    }
}
