//! Contrast-sensitivity filters: what detail an eye sees at a viewing distance, by channel.

use super::color::adapted;
use crate::metrics::filter::filtered_row;

/// Terms `√(π/b)·a·exp(−π² r²/b)`, r in degrees, as a and b (table 1 of the paper): achromatic, red-green, and the two of
/// blue-yellow. (The second terms of the first two channels have a = 0.)
const TERMS: [[f64; 2]; 4] = [[1.0, 0.0047], [1.0, 0.0053], [34.1, 0.04], [13.5, 0.025]];
/// Taps below this share of the middle one change no f32 result.
const NEGLIGIBLE: f64 = 1.0e-8;

/// The filters of a viewing condition.
#[derive(Debug)]
pub(super) struct Sensitivity {
    /// One-dimensional taps of each term, of sum 1.
    taps: [Vec<f32>; 4],
    /// Weight of the two blue-yellow terms.
    share: [f32; 2],
}

impl Sensitivity {
    pub(super) fn new(pixels_per_degree: f64) -> Self {
        use std::f64::consts::PI;
        let widest = TERMS.iter().map(|t| t[1]).fold(0.0, f64::max);
        // Three standard deviations of the widest filter, for all of them.
        let radius = (3.0 * (widest / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as i32;
        let all =
            |b: f64| (-radius..=radius).map(move |i| (-(PI * f64::from(i) / pixels_per_degree).powi(2) / b).exp());
        let sum = |b: f64| all(b).sum::<f64>();
        let taps = TERMS.map(|[_, b]| all(b).filter(|t| *t >= NEGLIGIBLE).map(|t| (t / sum(b)) as f32).collect());
        // The two-dimensional sum of a term is the square of its one-dimensional one.
        let mass = |[a, b]: [f64; 2]| a * (PI / b).sqrt() * sum(b).powi(2);
        let (first, second) = (mass(TERMS[2]), mass(TERMS[3]));
        let share = [first, second].map(|m| (m / (first + second)) as f32);
        Self { taps, share }
    }

    /// Row `y` of a YCxCz picture, filtered and adapted: L*a*b* with Hunt's effect, into `out`.
    #[inline(always)]
    pub(super) fn row<const FMA: bool>(&self, planes: &[Vec<f32>; 3], width: usize, y: usize, out: &mut Vec<[f32; 3]>) {
        // Plain loops: a closure that is not inlined would lose the caller's vector width.
        let [lightness, red_green, wide, narrow] = &self.taps;
        let lightness = filtered_row::<FMA, f32>(&planes[0], width, y, lightness, lightness);
        let red_green = filtered_row::<FMA, f32>(&planes[1], width, y, red_green, red_green);
        let wide = filtered_row::<FMA, f32>(&planes[2], width, y, wide, wide);
        let narrow = filtered_row::<FMA, f32>(&planes[2], width, y, narrow, narrow);
        out.resize(width, [0.0; 3]);
        for x in 0..width {
            let blue_yellow = self.share[0] * wide[x] + self.share[1] * narrow[x];
            out[x] = adapted([lightness[x], red_green[x], blue_yellow]);
        }
    }
}
