//! A subgroup: its rows, mask and place in the code.

use super::memory::Stamp;
use crate::op::{Orders, Row};

/// Lanes that wait at one point of the structured flow. `a`, `b`: lanes of the other arm and of the arm that is done; or
/// those that broke out and those that continue; or those that returned.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Frame {
    pub(crate) a: u128,
    pub(crate) b: u128,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum State {
    Ready,
    /// At the workgroup barrier before this operation.
    Waiting,
    Done,
}

#[derive(Debug)]
pub(crate) struct Lanes<const L: usize> {
    pub(crate) rows: Vec<[u32; L]>,
    pub(crate) frames: Vec<Frame>,
    pub(crate) pc: usize,
    pub(crate) mask: u128,
    /// Lanes that have an invocation.
    pub(crate) all: u128,
    pub(crate) index: u8,
    pub(crate) state: State,
    /// Subgroup barriers that ordered shared memory and storage.
    pub(crate) shared_epoch: u32,
    pub(crate) storage_epoch: u32,
    /// Of memory barriers since the last barrier.
    pub(crate) also_orders: Orders,
    /// The mask as words of all ones or zeros, and of which mask it is.
    wide: [u32; L],
    wide_of: u128,
}

impl<const L: usize> Lanes<L> {
    pub(crate) fn new(rows: u32, frames: u16, index: u8) -> Self {
        Self {
            rows: vec![[0; L]; rows as usize],
            frames: vec![Frame::default(); usize::from(frames) + 1],
            pc: 0,
            mask: 0,
            all: 0,
            index,
            state: State::Ready,
            shared_epoch: 0,
            storage_epoch: 0,
            also_orders: Orders::default(),
            wide: [0; L],
            wide_of: 0,
        }
    }

    /// Starts a workgroup.
    pub(crate) fn reset(&mut self, all: u128) {
        (self.pc, self.mask, self.all) = (0, all, all);
        self.state = State::Ready;
        (self.shared_epoch, self.storage_epoch) = (0, 0);
        self.also_orders = Orders::default();
    }

    #[inline]
    pub(crate) fn row(&self, row: Row) -> &[u32; L] {
        &self.rows[row as usize]
    }

    #[inline]
    pub(crate) fn set(&mut self, row: Row, value: [u32; L]) {
        self.rows[row as usize] = value;
    }

    /// Lanes whose value is true.
    #[inline]
    pub(crate) fn truth(&self, row: Row) -> u128 {
        let mut bits = 0;
        for (chunk, values) in self.rows[row as usize].chunks(32).enumerate() {
            let word = values.iter().enumerate().fold(0_u32, |w, (i, v)| w | (u32::from(*v != 0) << i));
            bits |= u128::from(word) << (32 * chunk);
        }
        bits
    }

    /// Writes active lanes.
    #[inline]
    pub(crate) fn set_masked(&mut self, row: Row, value: &[u32; L]) {
        if self.mask == self.all {
            self.rows[row as usize] = *value;
            return;
        }
        if self.wide_of != self.mask {
            self.widen();
        }
        let d = &mut self.rows[row as usize];
        for i in 0..L {
            d[i] = (d[i] & !self.wide[i]) | (value[i] & self.wide[i]);
        }
    }

    fn widen(&mut self) {
        for (chunk, wide) in self.wide.chunks_mut(32).enumerate() {
            let word = (self.mask >> (32 * chunk)) as u32;
            for (i, w) in wide.iter_mut().enumerate() {
                *w = 0_u32.wrapping_sub((word >> i) & 1);
            }
        }
        self.wide_of = self.mask;
    }

    /// Active lanes, lowest first.
    #[inline]
    pub(crate) fn active(&self) -> Bits {
        Bits(self.mask)
    }

    /// Whether this lane, if it may read, is active.
    pub(crate) fn is_active(&self, lane: u32) -> bool {
        (lane as usize) < L && (self.mask >> lane) & 1 == 1
    }

    pub(crate) fn stamp(&self, group: u32, epochs: [u32; 2], place: u16) -> Stamp {
        let [epoch, subgroup_epoch] = epochs;
        Stamp { group, epoch, subgroup_epoch, subgroup: self.index, lane: 0, place }
    }
}

/// Bits that are set, lowest first.
pub(crate) struct Bits(pub(crate) u128);

impl Iterator for Bits {
    type Item = usize;

    #[inline]
    fn next(&mut self) -> Option<usize> {
        if self.0 == 0 {
            return None;
        }
        let lane = self.0.trailing_zeros();
        self.0 &= self.0 - 1;
        Some(lane as usize)
    }
}
