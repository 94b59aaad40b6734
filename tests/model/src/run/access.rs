//! Loads, stores, atomics and image stores: bounds, values before the first write, races.

use rspirv::spirv::ImageFormat;

use super::POISON;
use super::lanes::Lanes;
use super::memory::{Kind, Memory, Stamp};
use super::step::World;
use crate::error::{ModelError, Result};
use crate::op::{Atomic, NO_ROW, Place, Row, Space};

impl World<'_> {
    fn memory(&mut self, space: Space) -> &mut Memory {
        match space {
            Space::Shared => self.shared,
            Space::Buffer(binding) => &mut self.buffers[usize::from(binding)],
        }
    }

    fn stamp<const L: usize>(&self, lanes: &Lanes<L>, pc: usize, space: Space) -> Stamp {
        let epochs = match space {
            Space::Shared => [self.shared_epoch, lanes.shared_epoch],
            Space::Buffer(_) => [self.storage_epoch, lanes.storage_epoch],
        };
        lanes.stamp(self.group, epochs, self.place(pc))
    }

    /// Name of the memory that a word belongs to, and where that begins.
    fn named(&self, space: Space, word: u32) -> (String, u32) {
        match space {
            Space::Shared => {
                let found = self.code.shared.iter().rev().find(|s| s.first <= word);
                found.map_or_else(|| ("shared".to_owned(), 0), |s| (s.name.clone(), s.first))
            }
            Space::Buffer(b) => (self.code.buffers.get(&b.into()).map_or_else(String::new, |i| i.name.clone()), 0),
        }
    }

    fn past_the_end(&self, pc: usize, space: Space, word: u32, length: u32) -> ModelError {
        let (memory, first) = self.named(space, word);
        ModelError::OutOfBounds { memory, index: word - first, length: length - first, place: self.place_name(pc) }
    }

    fn note(&mut self, pc: usize, space: Space, word: u32, kind: Kind, stamp: &Stamp) -> Result<()> {
        let places = &self.code.places;
        let conflict = match space {
            Space::Shared => self.shared.note(word, kind, stamp, places),
            Space::Buffer(b) => self.buffers[usize::from(b)].note(word, kind, stamp, places),
        };
        if let Some((first, second)) = conflict {
            let (memory, start) = self.named(space, word);
            return Err(ModelError::Race { memory, word: word - start, first, second });
        }
        if space == Space::Shared && kind != Kind::Write && !self.shared.was_written(word) {
            return Err(self.never_written(pc, space, word));
        }
        Ok(())
    }

    fn never_written(&self, pc: usize, space: Space, word: u32) -> ModelError {
        let (memory, first) = self.named(space, word);
        ModelError::NeverWritten { memory, word: word - first, place: self.place_name(pc) }
    }

    /// First word that a lane uses, checked.
    fn address<const L: usize>(&mut self, lanes: &Lanes<L>, pc: usize, place: Place, lane: usize) -> Result<u32> {
        let at = if place.at == NO_ROW { 0 } else { lanes.row(place.at)[lane] };
        let first = place.base.saturating_add(at);
        let length = self.memory(place.space).words.len() as u32;
        if first.saturating_add(place.count.into()) > length {
            return Err(self.past_the_end(pc, place.space, first.max(length), length));
        }
        Ok(first)
    }

    pub(super) fn load<const L: usize>(&mut self, lanes: &mut Lanes<L>, pc: usize, d: Row, place: Place) -> Result<()> {
        let Some(lowest) = lanes.active().next() else { return Ok(()) };
        let traced = self.memory(place.space).is_traced();
        let mut stamp = self.stamp(lanes, pc, place.space);
        let uniform = place.at == NO_ROW || {
            let at = lanes.row(place.at);
            let first = at[lowest];
            at.iter().all(|a| *a == first)
        };
        if uniform {
            let first = self.address(lanes, pc, place, lowest)?;
            for k in 0..u32::from(place.count) {
                if traced {
                    stamp.lane = if lanes.mask.count_ones() > 1 { Stamp::SEVERAL_LANES } else { lowest as u8 };
                    self.note(pc, place.space, first + k, Kind::Read, &stamp)?;
                }
                let value = self.memory(place.space).words[(first + k) as usize];
                lanes.set(d + k, [value; L]);
            }
            return Ok(());
        }
        for lane in lanes.active() {
            let first = self.address(lanes, pc, place, lane)?;
            stamp.lane = lane as u8;
            for k in 0..u32::from(place.count) {
                if traced {
                    self.note(pc, place.space, first + k, Kind::Read, &stamp)?;
                }
                let value = self.memory(place.space).words[(first + k) as usize];
                lanes.rows[(d + k) as usize][lane] = value;
            }
        }
        Ok(())
    }

    pub(super) fn store<const L: usize>(&mut self, lanes: &Lanes<L>, pc: usize, a: Row, place: Place) -> Result<()> {
        let mut stamp = self.stamp(lanes, pc, place.space);
        for lane in lanes.active() {
            let first = self.address(lanes, pc, place, lane)?;
            stamp.lane = lane as u8;
            for k in 0..u32::from(place.count) {
                self.note(pc, place.space, first + k, Kind::Write, &stamp)?;
                self.memory(place.space).words[(first + k) as usize] = lanes.row(a + k)[lane];
            }
        }
        Ok(())
    }

    /// Lanes take their turns from a random one on.
    pub(super) fn atomic<const L: usize>(
        &mut self,
        lanes: &mut Lanes<L>,
        pc: usize,
        op: Atomic,
        [d, a, b]: [Row; 3],
        place: Place,
    ) -> Result<()> {
        let mut stamp = self.stamp(lanes, pc, place.space);
        let start = self.random.below(L);
        for lane in (start..L).chain(0..start) {
            if !lanes.is_active(lane as u32) {
                continue;
            }
            let word = self.address(lanes, pc, place, lane)?;
            stamp.lane = lane as u8;
            self.note_atomic(pc, place.space, word, op, &stamp)?;
            let operand = |row: Row| if row == NO_ROW { 0 } else { lanes.row(row)[lane] };
            let (value, comparator) = (operand(a), operand(b));
            let target = &mut self.memory(place.space).words[word as usize];
            let before = *target;
            *target = updated(op, before, value, comparator);
            if d != NO_ROW {
                lanes.rows[d as usize][lane] = before;
            }
        }
        Ok(())
    }

    /// An exchange may be the first write of a shared word; other updates need a value to begin with.
    fn note_atomic(&mut self, pc: usize, space: Space, word: u32, op: Atomic, stamp: &Stamp) -> Result<()> {
        let sets = matches!(op, Atomic::Exchange | Atomic::Store);
        if space == Space::Shared && !sets && !self.shared.was_written(word) {
            return Err(self.never_written(pc, space, word));
        }
        self.note(pc, space, word, Kind::Atomic, stamp)
    }

    pub(super) fn image<const L: usize>(
        &mut self,
        lanes: &Lanes<L>,
        pc: usize,
        binding: u8,
        [x, y]: [Row; 2],
        texel: Row,
    ) -> Result<()> {
        let Some(image) = self.images.get(usize::from(binding)).copied().flatten() else {
            return Err(ModelError::Unsupported("a store to an image that was not given".to_owned()));
        };
        let space = Space::Buffer(binding);
        let mut stamp = self.stamp(lanes, pc, space);
        for lane in lanes.active() {
            let (x, y) = (lanes.row(x)[lane], lanes.row(y)[lane]);
            let texel = std::array::from_fn(|k| f32::from_bits(lanes.row(texel + k as u32)[lane]));
            let words = packed(image.format, texel);
            let first = (u64::from(y) * u64::from(image.width) + u64::from(x)) * words.len() as u64;
            let length = self.memory(space).words.len();
            // Vulkan drops stores outside an image.
            if x >= image.width || first + words.len() as u64 > length as u64 {
                continue;
            }
            stamp.lane = lane as u8;
            for (k, value) in (first as u32..).zip(words) {
                self.note(pc, space, k, Kind::Write, &stamp)?;
                self.memory(space).words[k as usize] = value;
            }
        }
        Ok(())
    }
}

fn updated(op: Atomic, before: u32, value: u32, comparator: u32) -> u32 {
    match op {
        Atomic::AddInt => before.wrapping_add(value),
        Atomic::Add => (f32::from_bits(before) + f32::from_bits(value)).to_bits(),
        Atomic::MinUint => before.min(value),
        Atomic::MaxUint => before.max(value),
        Atomic::And => before & value,
        Atomic::Or => before | value,
        Atomic::Xor => before ^ value,
        Atomic::Exchange | Atomic::Store => value,
        Atomic::CompareExchange if before == comparator => value,
        Atomic::CompareExchange | Atomic::Load => before,
    }
}

/// A texel as the words of a picture in memory.
fn packed(format: ImageFormat, texel: [f32; 4]) -> Vec<u32> {
    let half = |x: f32| u32::from(half::f16::from_f32(x).to_bits());
    match format {
        ImageFormat::Rgba8 => {
            let byte = |x: f32| (x.clamp(0.0, 1.0) * 255.0).round_ties_even() as u32;
            vec![(0..4).fold(0, |word, k| word | (byte(texel[k]) << (8 * k)))]
        }
        ImageFormat::Rgba16f => {
            vec![half(texel[0]) | (half(texel[1]) << 16), half(texel[2]) | (half(texel[3]) << 16)]
        }
        ImageFormat::Rgba32f => texel.map(f32::to_bits).to_vec(),
        _ => vec![POISON],
    }
}
