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
    pub(super) fn row(&self, luminance: &[f32], width: usize, y: usize, out: &mut Vec<[f32; 2]>) {
        let radius = self.smooth.len() / 2;
        let down = [&self.smooth, &self.edge, &self.point].map(|taps| {
            let mut padded = vec![0.0; width + 2 * radius];
            vertical(luminance, width, y, taps, &mut padded[radius..radius + width]);
            replicate_ends(&mut padded, radius);
            padded
        });
        let across = |down: &[f32], taps: &[f32]| {
            let mut row = vec![0.0; width];
            horizontal(down, taps, &mut row);
            row
        };
        let (edge_x, edge_y) = (across(&down[0], &self.edge), across(&down[1], &self.smooth));
        let (point_x, point_y) = (across(&down[0], &self.point), across(&down[2], &self.smooth));
        // Luminance is (Y + 16) / 116; the constant drops out of both derivatives.
        let length = |a: f32, b: f32| (a * a + b * b).sqrt() / 116.0;
        out.clear();
        out.extend((0..width).map(|x| [length(edge_x[x], edge_y[x]), length(point_x[x], point_y[x])]));
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
        features.row(&[50.0; 400], 20, 7, &mut out);
        assert!(out.iter().all(|f| f[0] < 1e-5 && f[1] < 1e-5));
        let step: Vec<f32> = (0..400).map(|i| if i % 20 < 10 { 0.0 } else { 116.0 }).collect();
        features.row(&step, 20, 7, &mut out);
        assert!(out[9][0] > 0.9 && out[9][0] <= 1.0 + 1e-5 && out[0][0] < 0.1, "{out:?}");
    }
}
