//! Which photos take part while a run learns to follow what moves: a window of times that opens as far as motion is followed.
//!
//! What moves by more than its size between two photos is lost when all of them take part at once: most photos do not show it
//! where it was. From a moment where it is known it can be followed, photo by photo. (D-NeRF, Pumarola et al. 2021, adds photos in
//! order of time by the clock; here each end of the window waits until its newest photos are fitted about as well as the others,
//! and opens by more at a time as long as they are, so that a scene that is easy to follow is soon there as a whole.)

use super::kept_aside::KeptAside;
use super::rng;
use super::saved::Saved;
use crate::error::{Error, Result};

/// Stream of the random numbers that draw photos.
const STREAM: u32 = 0x5749_4e44;
/// Photos that take part at the beginning, if there are so many.
const FIRST: usize = 8;
/// Photos at each end that count as its newest.
const NEWEST: usize = 3;
/// Draws of each of them before they are judged.
const DRAWS: u32 = 2;
/// They are followed when their mean L1 loss is at most this many times the median of all that take part.
const FOLLOWED: f32 = 1.2;
/// By what an end opens more each time that they are.
const ACCELERATION: f32 = 1.5;
/// Iterations from one look at the newest photos to the next.
const INTERVAL: u64 = 16;
/// Weight of a photo's last loss beside its earlier ones.
const LAST: f32 = 0.5;

/// A window of times.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TimeWindow {
    /// Photos in order of time.
    order: Vec<u32>,
    /// First and one past the last place of `order` that takes part: at the beginning, and now.
    first: [usize; 2],
    open: [usize; 2],
    /// Photos by which each end opens next.
    stride: [f32; 2],
    /// By photo: running mean of its L1 loss, and draws.
    loss: Vec<f32>,
    draws: Vec<u32>,
    /// Iterations from which it opens, and by which it is open.
    opens: [u64; 2],
}

impl TimeWindow {
    /// Of photos at these times without those `aside`, around `centre` (0: the first time, 1: the last). It opens from the first of the
    /// iterations `opens` on, and is open after the second. `None` where that is nothing, or there is one time.
    pub(super) fn new(times: &[f64], aside: KeptAside, centre: f64, opens: [u64; 2]) -> Option<Self> {
        let [first, last] = times.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], &t| [a.min(t), b.max(t)]);
        let mut order: Vec<u32> = (0..times.len() as u32).filter(|&photo| !aside.has(photo as usize)).collect();
        if opens[1] == 0 || order.len() <= FIRST || first >= last {
            return None;
        }
        order.sort_by(|&a, &b| times[a as usize].total_cmp(&times[b as usize]));
        let middle = order.partition_point(|&i| times[i as usize] < first + (last - first) * centre);
        let low = middle.saturating_sub(FIRST / 2).min(order.len() - FIRST);
        let first = [low, low + FIRST];
        let (loss, draws) = (vec![0.0; times.len()], vec![0; times.len()]);
        Some(Self { order, first, open: first, stride: [1.0; 2], loss, draws, opens })
    }

    /// Whether all photos take part.
    pub(super) fn is_open(&self) -> bool {
        self.open == [0, self.order.len()]
    }

    /// The photo of `iteration`; half of them are among the newest.
    pub(super) fn draw(&self, seed: u64, iteration: u64) -> usize {
        let bits = rng::bits(seed, STREAM, iteration);
        let newest: Vec<usize> = (0..2).filter(|&end| self.closed(end) > 0).flat_map(|end| self.newest(end)).collect();
        let among_newest = bits >> 63 == 0 && iteration >= self.opens[0] && !newest.is_empty();
        let below = |n: usize| ((bits & u64::from(u32::MAX)) % n as u64) as usize;
        let place =
            if among_newest { newest[below(newest.len())] } else { self.open[0] + below(self.open[1] - self.open[0]) };
        self.order[place] as usize
    }

    /// Takes note of the L1 loss of a photo that was drawn.
    pub(super) fn note(&mut self, photo: usize, loss: f64) {
        let (mean, draws) = (&mut self.loss[photo], &mut self.draws[photo]);
        *mean = if *draws == 0 { loss as f32 } else { *mean + LAST * (loss as f32 - *mean) };
        *draws = draws.saturating_add(1);
    }

    /// Whether it is looked at before `iteration`: a matter of the iteration alone.
    pub(super) fn looks_at(&self, iteration: u64) -> bool {
        !self.is_open() && (iteration.is_multiple_of(INTERVAL) || iteration == self.opens[1])
    }

    /// Opens the ends whose newest photos are followed, or whose time has come. Called between two steps, with none in flight.
    pub(super) fn widen(&mut self, iteration: u64) {
        if self.is_open() || iteration < self.opens[0] {
            return;
        }
        let typical = self.typical_loss();
        for end in 0..2 {
            let more = self.followed(end, typical).max(self.due(end, iteration)).min(self.closed(end));
            if end == 0 { self.open[0] -= more } else { self.open[1] += more }
        }
    }

    /// Photos beyond an end.
    fn closed(&self, end: usize) -> usize {
        if end == 0 { self.open[0] } else { self.order.len() - self.open[1] }
    }

    /// Places of the newest photos of an end.
    fn newest(&self, end: usize) -> std::ops::Range<usize> {
        let [low, high] = self.open;
        if end == 0 { low..(low + NEWEST).min(high) } else { high.saturating_sub(NEWEST).max(low)..high }
    }

    /// Median loss of the photos that were drawn.
    fn typical_loss(&self) -> f32 {
        let photos = self.order[self.open[0]..self.open[1]].iter().map(|&i| i as usize);
        let mut losses: Vec<f32> = photos.filter(|&i| self.draws[i] > 0).map(|i| self.loss[i]).collect();
        losses.sort_by(f32::total_cmp);
        losses.get(losses.len() / 2).copied().unwrap_or(0.0)
    }

    /// Photos by which an end opens because its newest are followed.
    fn followed(&mut self, end: usize, typical: f32) -> usize {
        let newest = self.newest(end);
        let photos: Vec<usize> = self.order[newest].iter().map(|&i| i as usize).collect();
        if photos.iter().any(|&i| self.draws[i] < DRAWS) {
            return 0;
        }
        let mean = photos.iter().map(|&i| self.loss[i]).sum::<f32>() / photos.len() as f32;
        if mean > FOLLOWED * typical {
            self.stride[end] = 1.0;
            return 0;
        }
        let now = self.stride[end];
        self.stride[end] = (now * ACCELERATION).min(self.order.len() as f32);
        now as usize
    }

    /// Photos by which an end opens because it must be open in time: in proportion to the iterations.
    fn due(&self, end: usize, iteration: u64) -> usize {
        let [from, until] = self.opens;
        let share = (iteration - from) as f64 / until.saturating_sub(from).max(1) as f64;
        let whole = if end == 0 { self.first[0] } else { self.order.len() - self.first[1] };
        let wanted = (share.min(1.0) * whole as f64).ceil() as usize;
        wanted.saturating_sub(whole - self.closed(end))
    }

    /// Adds its state to a checkpoint.
    pub(super) fn save(&self, saved: &mut Saved) {
        saved.put_indices("window.open", vec![2], &self.open.map(|p| p as u32));
        saved.put_floats("window.stride", vec![2], &self.stride);
        saved.put_floats("window.loss", vec![self.loss.len()], &self.loss);
        saved.put_indices("window.draws", vec![self.draws.len()], &self.draws);
    }

    /// Takes its state from a checkpoint of `iteration`; where that has none, from an earlier version, it is as open as it must be.
    ///
    /// # Errors
    /// `Usage` naming the array that does not fit.
    pub(super) fn restore(&mut self, saved: &Saved, iteration: u64) -> Result<()> {
        if !saved.has("window.open") {
            self.widen(iteration);
            return Ok(());
        }
        let (n, photos) = (self.order.len(), self.loss.len());
        let open = saved.indices("window.open", Some(2))?;
        let open = [open[0] as usize, open[1] as usize];
        if open[0] > self.first[0] || open[1] < self.first[1] || open[1] > n {
            let expected = format!("a range of photos around {} to {} of {n}", self.first[0], self.first[1]);
            return Err(Error::usage("window.open", format!("{} to {}", open[0], open[1]), expected));
        }
        let stride = saved.floats("window.stride", Some(2))?;
        self.loss = saved.floats("window.loss", Some(photos))?;
        self.draws = saved.indices("window.draws", Some(photos))?;
        (self.open, self.stride) = (open, [stride[0], stride[1]]);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
