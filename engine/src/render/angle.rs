//! Twin of `glsl/lib/angle.glsl`, line by line: sine and cosine with f32 accuracy for large arguments.

const HALF_PI_HIGH: f32 = 1.570_312_5;
const HALF_PI_MIDDLE: f32 = 0.000_483_751_3;
const HALF_PI_LOW: f32 = 7.549_79e-8;
const TWO_OVER_PI: f32 = std::f32::consts::FRAC_2_PI;

/// (sin x, cos x), about 1e-7 absolute for |x| up to 12,000.
pub fn sin_cos(x: f32) -> [f32; 2] {
    let k = (x * TWO_OVER_PI + 0.5).floor();
    let r = ((x - k * HALF_PI_HIGH) - k * HALF_PI_MIDDLE) - k * HALF_PI_LOW;
    let r = r.clamp(-0.8, 0.8);
    let z = r * r;
    let s = r + r * z * (-1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * (1.0 / 362_880.0))));
    let c = 1.0 + z * (-0.5 + z * (1.0 / 24.0 + z * (-1.0 / 720.0 + z * (1.0 / 40_320.0 - z * (1.0 / 3_628_800.0)))));
    let turns = k - 4.0 * (k * 0.25).floor();
    let odd = turns == 1.0 || turns == 3.0;
    let sine = if odd { c } else { s };
    let cosine = if odd { s } else { c };
    [if turns >= 2.0 { -sine } else { sine }, if turns == 1.0 || turns == 2.0 { -cosine } else { cosine }]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_f64_up_to_12000() {
        let mut worst = 0.0_f64;
        for i in -120_000..=120_000 {
            let x = i as f32 * 0.1 + (i as f32 * 0.37).fract() * 0.1;
            let [s, c] = sin_cos(x);
            let (s64, c64) = f64::from(x).sin_cos();
            worst = worst.max((f64::from(s) - s64).abs()).max((f64::from(c) - c64).abs());
        }
        assert!(worst < 1.5e-7, "{worst:e}");
    }

    #[test]
    fn constants_split_half_pi_exactly() {
        let sum = f64::from(HALF_PI_HIGH) + f64::from(HALF_PI_MIDDLE) + f64::from(HALF_PI_LOW);
        assert!((sum - std::f64::consts::FRAC_PI_2).abs() < 1e-14);
        assert_eq!((HALF_PI_HIGH * 128.0).fract(), 0.0);
        assert_eq!((HALF_PI_MIDDLE * 4_194_304.0).fract(), 0.0);
    }

    #[test]
    fn stays_bounded_for_absurd_arguments() {
        for x in [1e5_f32, -1e8, 1e20, 3e38] {
            let [s, c] = sin_cos(x);
            assert!(s.abs() <= 1.1 && c.abs() <= 1.1, "{x} {s} {c}");
        }
    }
}
