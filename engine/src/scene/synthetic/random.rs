//! A small counter-based random number generator: value k of a stream depends on (seed, k) only.

use glam::{DQuat, DVec3};

/// Random numbers by hashing a counter (the finaliser of SplitMix64).
#[derive(Debug, Clone)]
pub struct Random {
    key: u64,
    counter: u64,
}

/// 2⁶⁴ / golden ratio, odd: successive multiples are spread evenly.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

impl Random {
    /// The stream of `seed`.
    pub fn new(seed: u64) -> Self {
        Self { key: mix(seed.wrapping_add(STEP)), counter: 0 }
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.counter += 1;
        mix(self.key.wrapping_add(self.counter.wrapping_mul(STEP)))
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in 0..count (0 for count 0).
    pub fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Standard normal (Box–Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// Three independent standard normals.
    pub fn normal3(&mut self) -> DVec3 {
        DVec3::new(self.normal(), self.normal(), self.normal())
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> DVec3 {
        self.normal3().normalize_or(DVec3::Z)
    }

    /// Uniform rotation.
    pub fn rotation(&mut self) -> DQuat {
        let q = [self.normal(), self.normal(), self.normal(), self.normal()];
        let q = DQuat::from_array(q);
        if q.length_squared() > 0.0 { q.normalize() } else { DQuat::IDENTITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_and_repeatability() {
        let mut random = Random::new(7);
        let values: Vec<f64> = (0..20_000).map(|_| random.normal()).collect();
        let mean = values.iter().sum::<f64>() / 2.0e4;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / 2.0e4;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
        let (mut a, mut b, mut c) = (Random::new(1), Random::new(1), Random::new(2));
        let first: Vec<u64> = (0..8).map(|_| a.bits()).collect();
        assert_eq!(first, (0..8).map(|_| b.bits()).collect::<Vec<_>>());
        assert_ne!(first, (0..8).map(|_| c.bits()).collect::<Vec<_>>());
        assert!((0..1000).all(|_| a.below(3) < 3) && a.below(0) == 0);
    }
}
