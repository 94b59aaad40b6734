//! Which image is trained on at an iteration: every epoch a new order, each image once. A pure function of seed and
//! iteration, so that the data cursor of a checkpoint is the iteration itself.
//!
//! With a time window the first iterations draw from the photos nearest to one time only, and from more and more until all
//! take part: motion that is faster than the objects are large is then followed from a moment where they are known. (The same
//! curriculum as D-NeRF's, Pumarola et al. 2021, which adds photos in order of time.)

use super::rng;

/// Stream of the random numbers that order the images.
const STREAM: u32 = 0x5649_4557;
/// Stream of those that draw from the time window.
const WINDOW_STREAM: u32 = 0x5749_4e44;
/// Photos in the window at its beginning, if there are so many.
const FIRST_IN_WINDOW: u64 = 8;

/// The order of images.
#[derive(Debug, Clone)]
pub struct ViewSampler {
    seed: u64,
    epoch: u64,
    order: Vec<u32>,
    window: Option<Window>,
}

/// Photos by distance in time from the window's centre, and the iterations until all take part.
#[derive(Debug, Clone)]
struct Window {
    nearest: Vec<u32>,
    iterations: u64,
}

impl ViewSampler {
    /// Of `views` images.
    pub fn new(seed: u64, views: usize) -> Self {
        let mut sampler = Self { seed, epoch: 0, order: vec![0; views], window: None };
        sampler.shuffle(0);
        sampler
    }

    /// Draws from a window of times that grows from `centre` (0 the first, 1 the last of `times`) to all over `iterations`.
    #[must_use]
    pub fn with_window(mut self, times: &[f64], centre: f64, iterations: u64) -> Self {
        let [first, last] = times.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], &t| [a.min(t), b.max(t)]);
        let centre = first + (last - first) * centre;
        let mut nearest: Vec<u32> = (0..times.len() as u32).collect();
        nearest.sort_by(|&a, &b| {
            let distance = |i: u32| (times[i as usize] - centre).abs();
            distance(a).total_cmp(&distance(b))
        });
        self.window = (iterations > 0 && last > first).then_some(Window { nearest, iterations });
        self
    }

    /// The image of `iteration` (from 1).
    pub fn view(&mut self, iteration: u64) -> usize {
        if let Some(w) = self.window.as_ref().filter(|w| iteration <= w.iterations) {
            let n = w.nearest.len() as u64;
            let open = (n * iteration).div_ceil(w.iterations).max(FIRST_IN_WINDOW).min(n);
            return w.nearest[(rng::bits(self.seed, WINDOW_STREAM, iteration) % open) as usize] as usize;
        }
        let n = self.order.len().max(1) as u64;
        let (epoch, position) = ((iteration - 1) / n, (iteration - 1) % n);
        if epoch != self.epoch {
            self.shuffle(epoch);
        }
        self.order.get(position as usize).copied().unwrap_or(0) as usize
    }

    /// Images left in the epoch of `iteration`, itself included.
    pub fn remaining(&self, iteration: u64) -> u64 {
        let n = self.order.len().max(1) as u64;
        n - (iteration - 1) % n
    }

    /// Fisher–Yates with one random number per (epoch, place).
    fn shuffle(&mut self, epoch: u64) {
        let n = self.order.len();
        self.epoch = epoch;
        self.order = (0..n as u32).collect();
        for i in (1..n).rev() {
            // The modulus favours small numbers by n / 2^64: nothing.
            let j = rng::bits(self.seed, STREAM, epoch << 32 | i as u64) % (i as u64 + 1);
            self.order.swap(i, j as usize);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_epoch_has_every_image_once_in_another_order() {
        let mut s = ViewSampler::new(3, 20);
        let epoch = |s: &mut ViewSampler, e: u64| (1..=20).map(|i| s.view(20 * e + i)).collect::<Vec<_>>();
        let (first, second) = (epoch(&mut s, 0), epoch(&mut s, 1));
        assert_ne!(first, second);
        for mut order in [first.clone(), second] {
            order.sort_unstable();
            assert_eq!(order, (0..20).collect::<Vec<_>>());
        }
        // Going back gives the same again: the state is the iteration.
        assert_eq!(epoch(&mut s, 0), first);
        assert_eq!((s.remaining(1), s.remaining(20), s.remaining(21)), (20, 1, 20));
    }

    #[test]
    fn a_window_opens_from_its_centre() {
        let times: Vec<f64> = (0..40).map(|i| f64::from(i) / 39.0).collect();
        let mut s = ViewSampler::new(3, 40).with_window(&times, 0.25, 1000);
        let spread = |s: &mut ViewSampler, from: u64| {
            (from..from + 100).map(|i| (times[s.view(i)] - 0.25).abs()).fold(0.0, f64::max)
        };
        let [first, middle, last, after] = [1, 450, 900, 1001].map(|from| spread(&mut s, from));
        assert!(first < 0.12 && first < middle && middle < last, "{first} {middle} {last}");
        assert!((after - 0.75).abs() < 1e-12, "{after}");
        let still = ViewSampler::new(3, 4).with_window(&[0.5; 4], 0.5, 1000);
        assert!(still.window.is_none());
    }

    #[test]
    fn one_image_is_always_itself() {
        let mut s = ViewSampler::new(3, 1);
        assert_eq!([1, 2, 77].map(|i| s.view(i)), [0, 0, 0]);
    }
}
