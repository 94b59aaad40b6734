//! Photos on the device: those that stay there, and a place for every step in flight for the others.
//!
//! A photo that stays is uploaded when it is first needed. Uploads are submissions of their own, before the step's, and
//! nothing waits for them.

use crate::data::dataset::View;
use crate::data::pixels::{LEFT_OUT, Pixels};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Commands, Gpu, Memory};

/// Of the device's budget, photos take at most one part in this many.
const SHARE: u64 = 8;
/// Most words that 32 bits count.
const MOST_BYTES: u64 = 4 * u32::MAX as u64;

/// Which word each photo begins at.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Plan {
    /// Of photos that stay; `None`: the photo is uploaded for each of its steps.
    own: Vec<Option<u32>>,
    /// Of the places for the others, one per step in flight; none when all stay.
    ring: Vec<u32>,
    /// Of all places.
    bytes: u64,
}

impl Plan {
    /// Places for photos of `sizes` bytes: as many as fit into `budget` stay. `limit`: of all places; there are at most
    /// `steps` of those that are used in turn, fewer where the limit wants it.
    fn new(sizes: &[u64], steps: usize, budget: u64, limit: u64) -> Result<Self> {
        let largest = sizes.iter().copied().max().unwrap_or(0);
        let total: u64 = sizes.iter().sum();
        if largest > limit {
            let what = "bytes of a photo in one binding (maxStorageBufferRange)".to_owned();
            return Err(Error::Limit { what, need: largest.into(), have: limit.into() });
        }
        let places = if total <= budget.min(limit) { 0 } else { (steps.max(1) as u64).min(limit / largest.max(1)) };
        let room = budget.min(limit - places * largest);
        let mut end = 0;
        let mut place = |bytes: u64| {
            let first = (end / 4) as u32;
            end += bytes;
            first
        };
        let mut left = room;
        let own = sizes.iter().map(|&bytes| {
            left = left.checked_sub(bytes)?;
            Some(bytes)
        });
        let own = own.map(|bytes| bytes.map(&mut place)).collect();
        let ring = (0..places).map(|_| place(largest)).collect();
        Ok(Self { own, ring, bytes: end })
    }
}

/// What a step in flight uploads with.
#[derive(Debug, Default)]
struct Lane {
    /// What the host writes.
    staging: Option<Buffer>,
    /// The last upload: first word, bytes.
    copy: Option<([u64; 2], Commands)>,
}

/// The photos of a run.
#[derive(Debug)]
pub(super) struct Photos {
    /// Premultiplied RGBA8, one word per pixel, of all places.
    pub(super) buffer: Buffer,
    plan: Plan,
    /// Which of the photos that stay have been uploaded.
    filled: Vec<bool>,
    /// Share of each photo's pixels that takes part, as it was uploaded last.
    share: Vec<f64>,
    lanes: Vec<Lane>,
    largest: u64,
}

impl Photos {
    /// Places for the photos of `views`, of which at most `budget` bytes stay on the device, and for at most `steps` steps in
    /// flight.
    ///
    /// # Errors
    /// `Limit` for a photo that one binding cannot hold; `OutOfMemory`.
    pub(super) fn new(gpu: &Gpu, views: &[View], budget: u64, steps: usize) -> Result<Self> {
        let bytes = |v: &View| 4 * u64::from(v.camera.width) * u64::from(v.camera.height);
        let sizes: Vec<u64> = views.iter().map(bytes).collect();
        let c = &gpu.info().capabilities;
        let limit = c.max_storage_buffer_range.min(c.max_allocation_bytes).min(MOST_BYTES);
        let plan = Plan::new(&sizes, steps, budget.min(gpu.memory_used().1 / SHARE), limit)?;
        let steps = if plan.ring.is_empty() { steps.max(1) } else { plan.ring.len() };
        Ok(Self {
            buffer: gpu.buffer("photos", plan.bytes, Memory::Device)?,
            filled: vec![false; views.len()],
            share: vec![1.0; views.len()],
            lanes: (0..steps).map(|_| Lane::default()).collect(),
            largest: sizes.iter().copied().max().unwrap_or(0),
            plan,
        })
    }

    /// Steps that may be in flight.
    pub(super) fn lanes(&self) -> usize {
        self.lanes.len()
    }

    /// Whether these photos are on the device to stay: none of them is decoded or uploaded any more.
    pub(super) fn are_there(&self, mut views: std::ops::Range<usize>) -> bool {
        self.plan.ring.is_empty() && views.all(|view| self.filled[view])
    }

    /// Where a photo begins that is on the device to stay.
    pub(super) fn find(&self, view: usize) -> Option<u32> {
        self.plan.own[view].filter(|_| self.filled[view])
    }

    /// Whether a photo stays once it was uploaded.
    pub(super) fn stays(&self, view: usize) -> bool {
        self.plan.own[view].is_some()
    }

    /// All photos are uploaded again before they are used.
    pub(super) fn forget(&mut self) {
        self.filled.fill(false);
    }

    /// Share of a photo's pixels that its mask does not leave out; 1 of one that was not uploaded.
    pub(super) fn share(&self, view: usize) -> f64 {
        self.share[view]
    }

    /// Uploads a photo for the step in `lane`, whose last step has finished; where it begins.
    ///
    /// # Errors
    /// `OutOfMemory`, `DeviceLost`.
    pub(super) fn upload(&mut self, gpu: &Gpu, lane: usize, view: usize, photo: &Pixels) -> Result<u32> {
        let first = self.plan.own[view].unwrap_or_else(|| self.plan.ring[lane]);
        let lane = &mut self.lanes[lane];
        let staging = match &lane.staging {
            Some(staging) => staging.clone(),
            None => lane.staging.insert(gpu.buffer("photo upload", self.largest, Memory::Upload)?).clone(),
        };
        if let Some((_, copy)) = &lane.copy {
            // Its step has finished, unless that was never submitted.
            gpu.wait_for(copy)?;
        }
        staging.write(0, bytemuck::cast_slice(&photo.rgba))?;
        let key = [u64::from(first), 4 * photo.rgba.len() as u64];
        if lane.copy.as_ref().is_none_or(|(recorded, _)| *recorded != key) {
            let mut r = gpu.recorder("photo");
            r.copy(staging.slice(0, key[1]), self.buffer.slice(4 * key[0], key[1]))?;
            lane.copy = Some((key, r.finish()?));
        }
        if let Some((_, copy)) = &mut lane.copy {
            gpu.submit(copy)?;
        }
        self.filled[view] = self.plan.own[view].is_some();
        let used = photo.rgba.iter().filter(|pixel| **pixel != LEFT_OUT).count();
        self.share[view] = used as f64 / photo.rgba.len().max(1) as f64;
        Ok(first)
    }

    /// Bytes on the device.
    pub(super) fn bytes(&self) -> u64 {
        self.buffer.bytes() + self.lanes.iter().flat_map(|lane| &lane.staging).map(Buffer::bytes).sum::<u64>()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn all_stay_when_there_is_room_for_them() {
        let plan = Plan::new(&[400, 80, 400], 3, 880, 1000).unwrap();
        assert_eq!(plan, Plan { own: vec![Some(0), Some(100), Some(120)], ring: vec![], bytes: 880 });
    }

    #[test]
    fn what_does_not_fit_takes_turns() {
        let plan = Plan::new(&[400, 80, 400, 400], 3, 500, 4000).unwrap();
        let own = vec![Some(0), Some(100), None, None];
        assert_eq!(plan, Plan { own, ring: vec![120, 220, 320], bytes: 480 + 1200 });
        let none = Plan::new(&[400; 2], 2, 0, 4000).unwrap();
        assert_eq!(none, Plan { own: vec![None; 2], ring: vec![0, 100], bytes: 800 });
    }

    #[test]
    fn a_binding_s_limit_comes_first() {
        let plan = Plan::new(&[400; 4], 3, 1 << 30, 1000).unwrap();
        assert_eq!(plan, Plan { own: vec![None; 4], ring: vec![0, 100], bytes: 800 });
        assert!(matches!(Plan::new(&[400; 4], 3, 0, 300), Err(Error::Limit { need: 400, have: 300, .. })));
    }
}
