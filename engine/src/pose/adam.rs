//! Adam in f64 (Kingma and Ba 2015). The moments are kept from one iteration, and from one size of the photos, to the next.

/// Decay of the first moment.
const BETA_1: f64 = 0.9;
/// Decay of the second moment: it has to follow a gradient that falls from pixels to hundredths of a pixel in some hundred steps.
const BETA_2: f64 = 0.98;
const EPSILON: f64 = 1e-12;

/// Moments of some numbers.
#[derive(Debug, Clone, Default)]
pub(super) struct Adam {
    first: Vec<f64>,
    second: Vec<f64>,
    steps: i32,
}

impl Adam {
    /// For `count` numbers.
    pub(super) fn new(count: usize) -> Self {
        Self { first: vec![0.0; count], second: vec![0.0; count], steps: 0 }
    }

    /// The change of each number at this gradient; about `rate` while the gradient keeps its sign.
    pub(super) fn step(&mut self, gradient: &[f64], rate: f64) -> Vec<f64> {
        self.step_blocks::<1>(gradient, |_| [rate, f64::INFINITY])
    }

    /// The same for vectors of six numbers, in which the function has a curvature of about 1. They share a second moment: their
    /// direction stays, and a vector moves by its own `rate` altogether, but not further than a step of Newton's method.
    pub(super) fn step_vectors(&mut self, gradient: &[f64], rate: impl Fn(usize) -> f64) -> Vec<f64> {
        self.step_blocks::<6>(gradient, |block| [rate(block), 1.0])
    }

    fn step_blocks<const B: usize>(&mut self, gradient: &[f64], rate: impl Fn(usize) -> [f64; 2]) -> Vec<f64> {
        self.steps += 1;
        let [one, two] = [BETA_1, BETA_2].map(|beta: f64| 1.0 - beta.powi(self.steps));
        let blocks = self.first.chunks_exact_mut(B).zip(self.second.chunks_exact_mut(B)).zip(gradient.chunks_exact(B));
        let mut steps = Vec::with_capacity(gradient.len());
        for (block, ((first, second), g)) in blocks.enumerate() {
            let square: f64 = g.iter().map(|g| g * g).sum();
            let [rate, most] = rate(block);
            for ((first, second), g) in first.iter_mut().zip(second).zip(g) {
                *first = BETA_1 * *first + (1.0 - BETA_1) * g;
                *second = BETA_2 * *second + (1.0 - BETA_2) * square;
                let factor = (rate / ((*second / two).sqrt() + EPSILON)).min(most);
                steps.push(-factor * *first / one);
            }
        }
        steps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_has_the_length_of_the_rate_and_numbers_come_home() {
        let mut adam = Adam::new(2);
        assert!(adam.step(&[3.0, 0.0], 0.5).iter().zip([-0.5, 0.0]).all(|(a, b)| (a - b).abs() < 1e-9));
        let (mut adam, mut x) = (Adam::new(1), 4.0);
        for k in 0..200 {
            x += adam.step(&[f64::signum(x)], 0.2 * 0.97_f64.powi(k))[0];
        }
        assert!(x.abs() < 0.02, "{x}");
        let mut vectors = Adam::new(12);
        let gradient: Vec<f64> = [3.0, 4.0, 0.0, 0.0, 0.0, 0.0].into_iter().chain([0.01; 6]).collect();
        let step = vectors.step_vectors(&gradient, |_| 0.5);
        assert!((step[0] + 0.3).abs() < 1e-9 && (step[1] + 0.4).abs() < 1e-9, "{step:?}");
        assert!((step[6] + 0.01).abs() < 1e-9, "no further than Newton's: {step:?}");
    }
}
