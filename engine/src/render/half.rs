//! IEEE half-precision floats, as `packHalf2x16` and `unpackHalf2x16` know them.

/// Largest finite half.
pub const HALF_MAX: f32 = 65_504.0;

/// Bits of the half nearest to `x`, ties to even; infinity past [`HALF_MAX`], a quiet NaN for NaN.
pub fn from_f32(x: f32) -> u32 {
    let magnitude = x.abs();
    let sign = if x.is_sign_negative() { 0x8000 } else { 0 };
    if x.is_nan() {
        return 0x7E00 | sign;
    }
    if magnitude >= 65_520.0 {
        return 0x7C00 | sign;
    }
    if magnitude < 6.103_515_6e-5 {
        // Subnormal: a multiple of 2^-24.
        return (magnitude * 16_777_216.0).round_ties_even() as u32 | sign;
    }
    let b = magnitude.to_bits();
    (((b + 0xFFF + ((b >> 13) & 1)) >> 13) - (112 << 10)) | sign
}

/// Value of the half in the low 16 bits.
pub fn to_f32(bits: u32) -> f32 {
    let (exponent, mantissa) = ((bits >> 10) & 31, bits & 0x3FF);
    let magnitude = match exponent {
        0 => mantissa as f32 / 16_777_216.0,
        31 => f32::from_bits(0x7F80_0000 | mantissa << 13),
        _ => f32::from_bits((exponent + 112) << 23 | mantissa << 13),
    };
    if bits & 0x8000 == 0 { magnitude } else { -magnitude }
}

/// Two halves in a word, the first one low.
pub fn pack(v: [f32; 2]) -> u32 {
    from_f32(v[0]) | from_f32(v[1]) << 16
}

/// The two halves of a word.
pub fn unpack(word: u32) -> [f32; 2] {
    [to_f32(word & 0xFFFF), to_f32(word >> 16)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_half_survives_and_rounding_goes_to_the_nearest() {
        for bits in 0..=0xFFFF_u32 {
            let value = to_f32(bits);
            if value.is_nan() {
                assert!(to_f32(from_f32(value)).is_nan());
            } else {
                assert_eq!(from_f32(value), bits, "{value}");
            }
        }
        for x in [1.0 + 1.0 / 2048.0, 0.1, 3.3e-5, 1e-8, 65_519.0, 1e9, -7.994_353_4] {
            let error = (to_f32(from_f32(x)).min(HALF_MAX) - x.min(HALF_MAX)).abs();
            assert!(error <= x.abs() / 2048.0 || error <= 3e-8, "{x}");
        }
        assert_eq!(unpack(pack([0.5, -2.0])), [0.5, -2.0]);
    }
}
