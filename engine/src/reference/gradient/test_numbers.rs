//! Random numbers and the comparison with central differences for the gradients' tests.

use glam::DVec3;

/// A small generator, so that tests do not depend on a crate's stream.
pub(super) struct Numbers(pub u64);

impl Numbers {
    /// In -1..1.
    pub(super) fn signed(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    pub(super) fn vector(&mut self) -> DVec3 {
        DVec3::new(self.signed(), self.signed(), self.signed())
    }

    /// Central differences of steps h and h/2 extrapolated: error of order h⁴, so that h can be large against rounding.
    pub(super) fn richardson(mut difference: impl FnMut(f64) -> f64) -> f64 {
        let h = 2e-3;
        let (coarse, fine, finest) = (difference(h), difference(h / 2.0), difference(h / 4.0));
        let first = (4.0 * fine - coarse) / 3.0;
        let second = (4.0 * finest - fine) / 3.0;
        (16.0 * second - first) / 15.0
    }
}

/// A quaternion of a length between about 0.3 and 3.
pub(super) fn quaternion(rng: &mut Numbers) -> [f64; 4] {
    let q = [0; 4].map(|_| rng.signed());
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    q.map(|x| x / length * (0.3 + 2.7 * rng.signed().abs()))
}

/// `count` pairs (analytic, difference): relative error ≤ 1e-6, measured against the pair or, where the gradient nearly
/// vanishes, against a hundredth of the root mean square of all.
pub(super) fn check(kind: &str, count: usize, pair: impl FnMut(usize) -> (f64, f64)) {
    let pairs: Vec<(f64, f64)> = (0..count).map(pair).collect();
    let scale = (pairs.iter().map(|p| p.0 * p.0).sum::<f64>() / count as f64).sqrt();
    assert!(scale > 0.0, "{kind}: every gradient is 0");
    let error = |(a, b): &(f64, f64)| (a - b).abs() / a.abs().max(0.01 * scale);
    let worst = pairs.iter().map(error).fold(0.0, f64::max);
    assert!(worst <= 1e-6, "{kind}: {worst:e} over {count} pairs");
}
