//! Which image is trained on at an iteration: every epoch a new order, each image once. A pure function of seed and
//! iteration, so that the data cursor of a checkpoint is the iteration itself.

use super::rng;

/// Stream of the random numbers that order the images.
const STREAM: u32 = 0x5649_4557;

/// The order of images.
#[derive(Debug, Clone)]
pub struct ViewSampler {
    seed: u64,
    epoch: u64,
    order: Vec<u32>,
}

impl ViewSampler {
    /// Of `views` images.
    pub fn new(seed: u64, views: usize) -> Self {
        let mut sampler = Self { seed, epoch: 0, order: vec![0; views] };
        sampler.shuffle(0);
        sampler
    }

    /// The image of `iteration` (from 1).
    pub fn view(&mut self, iteration: u64) -> usize {
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
    fn one_image_is_always_itself() {
        let mut s = ViewSampler::new(3, 1);
        assert_eq!([1, 2, 77].map(|i| s.view(i)), [0, 0, 0]);
    }
}
