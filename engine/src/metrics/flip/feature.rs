//! Edges and points of luminance: first and second derivatives of a Gaussian (section 4.2.1).

use crate::metrics::filter::{horizontal, replicate_ends, vertical};

/// Width of a feature that an eye is most sensitive to, degrees.
const WIDTH: f64 = 0.082;

/// The one-dimensional filters whose products are the feature detectors.
#[derive(Debug)]
pub(super) struct Features {
    /// Gaussian of sum 1.
    smooth: Vec<f32>,
    /// First derivative; its positive and negative taps sum to ±1.
    edge: Vec<f32>,
    /// Second derivative, scaled in the same way.
    point: Vec<f32>,
}

impl Features {
    pub(super) fn new(pixels_per_degree: f64) -> Self {
        let sigma = 0.5 * WIDTH * pixels_per_degree;
        let radius = (3.0 * sigma).ceil() as i32;
        let taps = |f: fn(f64) -> f64| {
            let gaussian = move |x: f64| (-0.5 * x * x).exp();
            (-radius..=radius)
                .map(move |i| f(f64::from(i) / sigma) * gaussian(f64::from(i) / sigma))
                .collect::<Vec<_>>()
        };
        Self {
            smooth: balanced(&taps(|_| 1.0)),
            edge: balanced(&taps(|x| -x)),
            point: balanced(&taps(|x| x * x - 1.0)),
        }
    }

    /// Strength of the edge and of the point at each pixel of row `y`, from the first plane of YCxCz, into `out`.
    #[inline(always)]
    pub(super) fn row<const FMA: bool>(&self, luminance: &[f32], width: usize, y: usize, out: &mut Vec<[f32; 2]>) {
        let radius = self.smooth.len() / 2;
        // Plain loops: a closure that is not inlined would lose the caller's vector width.
        let mut down = [const { Vec::new() }; 3];
        for (padded, taps) in down.iter_mut().zip([&self.smooth, &self.edge, &self.point]) {
            padded.resize(width + 2 * radius, 0.0);
            vertical::<FMA, f32>(luminance, width, y, taps, &mut padded[radius..radius + width]);
            replicate_ends(padded, radius);
        }
        let across = [(0, &self.edge), (1, &self.smooth), (0, &self.point), (2, &self.smooth)];
        let mut rows = [const { Vec::new() }; 4];
        for (row, (from, taps)) in rows.iter_mut().zip(across) {
            row.resize(width, 0.0);
            horizontal::<FMA, f32>(&down[from], taps, row);
        }
        // Luminance is (Y + 16) / 116; the constant drops out of both derivatives.
        let [edge_x, edge_y, point_x, point_y] = &rows;
        out.resize(width, [0.0; 2]);
        for x in 0..width {
            let edge = (edge_x[x] * edge_x[x] + edge_y[x] * edge_y[x]).sqrt() / 116.0;
            let point = (point_x[x] * point_x[x] + point_y[x] * point_y[x]).sqrt() / 116.0;
            out[x] = [edge, point];
        }
    }
}

/// Positive taps scaled to a sum of 1, negative ones to −1.
fn balanced(taps: &[f64]) -> Vec<f32> {
    let sum = |sign: f64| taps.iter().map(|t| (sign * t).max(0.0)).sum::<f64>().max(f64::MIN_POSITIVE);
    let (positive, negative) = (sum(1.0), sum(-1.0));
    taps.iter().map(|t| (t / if *t > 0.0 { positive } else { negative }) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_has_no_feature_and_a_step_has_an_edge() {
        let features = Features::new(super::super::PIXELS_PER_DEGREE);
        assert_eq!(features.smooth.len(), 19);
        let mut out = Vec::new();
        features.row::<false>(&[50.0; 400], 20, 7, &mut out);
        assert!(out.iter().all(|f| f[0] < 1e-5 && f[1] < 1e-5));
        let step: Vec<f32> = (0..400).map(|i| if i % 20 < 10 { 0.0 } else { 116.0 }).collect();
        features.row::<false>(&step, 20, 7, &mut out);
        assert!(out[9][0] > 0.9 && out[9][0] <= 1.0 + 1e-5 && out[0][0] < 0.1, "{out:?}");
    }
}
