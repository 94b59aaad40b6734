//! The image loss (1 − λ)·L1 + λ·(1 − SSIM) and its gradient, in f64.
//!
//! SSIM in its usual form (Wang et al. 2004, eq. 13) with an 11×11 Gaussian window of σ = 1.5 px, zeros outside the image:
//! (2μ_xμ_y + C1)(2σ_xy + C2) / ((μ_x² + μ_y² + C1)(σ_x² + σ_y² + C2)), σ_xy = E\[xy\] − μ_xμ_y, averaged over pixels and
//! channels.

/// 0.01².
const C1: f64 = 1.0e-4;
/// 0.03².
const C2: f64 = 9.0e-4;
const RADIUS: usize = 5;

/// Loss and gradient of one image.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImageLoss {
    /// (1 − λ)·L1 + λ·(1 − SSIM).
    pub loss: f64,
    /// Mean |x − y|.
    pub l1: f64,
    /// Mean SSIM.
    pub ssim: f64,
    /// Mean (x − y)².
    pub mse: f64,
    /// `[H,W,3]` gradient of `loss` by the image.
    pub gradient: Vec<f64>,
}

/// Loss of `image` against `target`, both `[height, width, 3]`.
pub fn image_loss(image: &[f64], target: &[f64], [width, height]: [usize; 2], lambda: f64) -> ImageLoss {
    let values = (3 * width * height) as f64;
    let mut out = ImageLoss { gradient: vec![0.0; image.len()], ..ImageLoss::default() };
    for channel in 0..3 {
        let of = |all: &[f64]| all.iter().skip(channel).step_by(3).copied().collect::<Vec<f64>>();
        let (x, y) = (of(image), of(target));
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>();
        let blur = |v: &[f64]| convolve(v, width, height);
        let (mu_x, mu_y) = (blur(&x), blur(&y));
        let (xx, yy, xy) = (blur(&product(&x, &x)), blur(&product(&y, &y)), blur(&product(&x, &y)));
        let mut by = [vec![0.0; x.len()], vec![0.0; x.len()], vec![0.0; x.len()]];
        for i in 0..x.len() {
            let (ssim, derivatives) = ssim([mu_x[i], mu_y[i], xx[i], yy[i], xy[i]]);
            out.ssim += ssim / values;
            for (map, derivative) in by.iter_mut().zip(derivatives) {
                map[i] = derivative;
            }
        }
        let by = by.map(|map| blur(&map));
        for i in 0..x.len() {
            let d = x[i] - y[i];
            out.l1 += d.abs() / values;
            out.mse += d * d / values;
            let by_ssim = by[0][i] + 2.0 * x[i] * by[1][i] + y[i] * by[2][i];
            let sign = if d == 0.0 { 0.0 } else { d.signum() };
            out.gradient[3 * i + channel] = ((1.0 - lambda) * sign - lambda * by_ssim) / values;
        }
    }
    out.loss = (1.0 - lambda) * out.l1 + lambda * (1.0 - out.ssim);
    out
}

/// SSIM from the moments μ_x, μ_y, E[x²], E[y²], E\[xy\], and its derivatives by μ_x, E[x²] and E\[xy\].
fn ssim([mu_x, mu_y, xx, yy, xy]: [f64; 5]) -> (f64, [f64; 3]) {
    let a_1 = 2.0 * mu_x * mu_y + C1;
    let a_2 = 2.0 * (xy - mu_x * mu_y) + C2;
    let b_1 = mu_x * mu_x + mu_y * mu_y + C1;
    let b_2 = xx - mu_x * mu_x + yy - mu_y * mu_y + C2;
    let ssim = a_1 * a_2 / (b_1 * b_2);
    let by_xx = -ssim / b_2;
    let by_xy = 2.0 * a_1 / (b_1 * b_2);
    // var(x) and cov(x, y) hold −μ_x² and −μ_xμ_y.
    let by_mean = 2.0 * mu_y * a_2 / (b_1 * b_2) - 2.0 * mu_x * ssim / b_1 - 2.0 * mu_x * by_xx - mu_y * by_xy;
    (ssim, [by_mean, by_xx, by_xy])
}

fn convolve(values: &[f64], width: usize, height: usize) -> Vec<f64> {
    let weight = |i: usize| (-(i as f64 - RADIUS as f64).powi(2) / 4.5).exp();
    let sum: f64 = (0..=2 * RADIUS).map(weight).sum();
    let window: Vec<f64> = (0..=2 * RADIUS).map(|i| weight(i) / sum).collect();
    let at = |list: &[f64], x: isize, y: isize| {
        let inside = x >= 0 && y >= 0 && x < width as isize && y < height as isize;
        if inside { list[y as usize * width + x as usize] } else { 0.0 }
    };
    let pass = |list: &[f64], step: [isize; 2]| -> Vec<f64> {
        let pixel = |i: usize| ((i % width) as isize, (i / width) as isize);
        let tap = |i: usize, k: usize| {
            let ((x, y), offset) = (pixel(i), k as isize - RADIUS as isize);
            window[k] * at(list, x + offset * step[0], y + offset * step[1])
        };
        (0..list.len()).map(|i| (0..window.len()).map(|k| tap(i, k)).sum()).collect()
    };
    pass(&pass(values, [1, 0]), [0, 1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::synthetic::Random;

    fn images(size: [usize; 2], seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut random = Random::new(seed);
        let n = 3 * size[0] * size[1];
        let image: Vec<f64> = (0..n).map(|_| random.range(-0.1, 1.2)).collect();
        // Away from the kink of |x − y|.
        let target =
            image.iter().map(|x| x + random.range(0.01, 0.4) * if random.uniform() < 0.5 { -1.0 } else { 1.0 });
        (image.clone(), target.collect())
    }

    #[test]
    fn gradient_equals_central_differences() {
        let mut pairs = 0;
        for (size, seed) in [([9, 7], 1), ([17, 13], 2), ([1, 1], 3), ([1, 12], 4), ([23, 3], 5)] {
            let (image, target) = images(size, seed);
            for lambda in [0.0, 0.2, 1.0] {
                let truth = image_loss(&image, &target, size, lambda).gradient;
                let norm = truth.iter().map(|g| g * g).sum::<f64>().sqrt() / (truth.len() as f64).sqrt();
                for i in (0..image.len()).step_by(5) {
                    let loss = |h: f64| {
                        let mut moved = image.clone();
                        moved[i] += h;
                        image_loss(&moved, &target, size, lambda).loss
                    };
                    // Fourth order, so that h may be large and rounding small.
                    let h = 5e-4;
                    let numeric = (8.0 * (loss(h) - loss(-h)) - (loss(2.0 * h) - loss(-2.0 * h))) / (12.0 * h);
                    let error = (numeric - truth[i]).abs() / truth[i].abs().max(0.1 * norm);
                    assert!(error <= 1e-6, "{size:?} λ {lambda} [{i}]: {numeric} against {}, {error:e}", truth[i]);
                    pairs += 1;
                }
            }
        }
        assert!(pairs >= 500, "{pairs} pairs");
    }

    #[test]
    fn equal_images_have_no_loss() {
        let (image, _) = images([13, 8], 9);
        let out = image_loss(&image, &image, [13, 8], 0.2);
        assert!(out.loss.abs() < 1e-15 && (out.ssim - 1.0).abs() < 1e-14, "{out:?}");
        assert!(out.gradient.iter().all(|g| g.abs() < 1e-14));
    }
}
