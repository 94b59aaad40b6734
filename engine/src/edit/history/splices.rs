//! How an array differs from what it was: the rows that are others, no longer there or new.

use bytemuck::Pod;
use rayon::prelude::*;

use super::words::Words;
use crate::edit::rows::pick_into;

/// Words that a thread copies at a time.
const PIECE: usize = 1 << 16;

/// Rows that are the same in both arrays, then rows that are not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Run {
    same: u32,
    /// Rows of this array only.
    here: u32,
    /// Rows of the other array only: those that are stored.
    there: u32,
}

/// What makes another array of one, and then what makes the first one again. Arrays are of 32-bit words, compared bit by bit.
#[derive(Debug)]
pub(super) struct Splices {
    /// Words of a row.
    width: usize,
    runs: Vec<Run>,
    stored: Words,
}

impl Splices {
    /// What makes `there` of `here`, both of rows of `width` words; `None` of equal arrays. Rows that were only added, only taken
    /// away or only changed are found one by one; else everything between the first and the last difference is stored.
    pub(super) fn between(here: &[u32], there: Vec<u32>, width: usize) -> Option<Self> {
        if *here == there {
            return None;
        }
        let runs = match here.len().cmp(&there.len()) {
            std::cmp::Ordering::Equal => Some(changed(here, &there, width)),
            std::cmp::Ordering::Less => additional(here, &there, width),
            std::cmp::Ordering::Greater => additional(&there, here, width).map(inverse),
        };
        let runs = runs.unwrap_or_else(|| middle(here, &there, width));
        let made = Self { width, runs, stored: Words::default() };
        let count = made.words(|run| run.there);
        if count == there.len() {
            return Some(Self { stored: there.into(), ..made });
        }
        let (mut at, mut stored) = (0, Vec::with_capacity(count));
        for run in &made.runs {
            at += run.same as usize * width;
            let end = at + run.there as usize * width;
            stored.extend_from_slice(&there[at..end]);
            at = end;
        }
        Some(Self { stored: stored.into(), ..made })
    }

    /// What brings back rows of `now` that a change is about to overwrite.
    pub(super) fn overwritten(now: &[u32], width: usize, mask: &[bool]) -> Self {
        Self { stored: rows_of(now, width, mask), runs: runs_of(mask, Run { same: 0, here: 1, there: 1 }), width }
    }

    /// What brings back rows of `now` that are about to be taken away.
    pub(super) fn removed(now: &[u32], width: usize, mask: &[bool]) -> Self {
        Self { stored: rows_of(now, width, mask), runs: runs_of(mask, Run { same: 0, here: 0, there: 1 }), width }
    }

    /// What takes away `count` rows that are about to be added after `rows` others.
    pub(super) fn added(rows: usize, width: usize, count: usize) -> Self {
        let run = Run { same: rows as u32, here: count as u32, there: 0 };
        Self { stored: Words::default(), runs: Vec::from_iter((count > 0).then_some(run)), width }
    }

    /// Makes the other array of `values`, which is the one that this belongs to; and belongs to the other one from then on.
    pub(super) fn swap<T: Pod>(&mut self, values: &mut Vec<T>) {
        if self.runs.iter().all(|run| run.here == run.there) {
            return self.swap_in_place(bytemuck::cast_slice_mut(values));
        }
        // New arrays cost more than their copies: all their pages are new.
        if self.runs.iter().all(|run| run.there == 0) {
            return self.take_away(values);
        }
        if self.runs.iter().all(|run| run.here == 0) {
            return self.put_in(values);
        }
        let old: &[u32] = bytemuck::cast_slice(values);
        let words = |rows: u32| rows as usize * self.width;
        let gone = self.words(|run| run.here);
        let (mut made, mut stored) = (vec![0; old.len() - gone + self.stored.len()], Words::zeros(gone));
        let (mut pieces, mut to, mut out) = (Vec::new(), made.as_mut_slice(), &mut *stored);
        let (mut at, mut from) = (0, 0);
        for run in &self.runs {
            let [same, here, there] = [run.same, run.here, run.there].map(words);
            copy(&mut pieces, &mut to, &old[at..at + same]);
            copy(&mut pieces, &mut to, &self.stored[from..from + there]);
            copy(&mut pieces, &mut out, &old[at + same..at + same + here]);
            (at, from) = (at + same + here, from + there);
        }
        copy(&mut pieces, &mut to, &old[at..]);
        pieces.into_par_iter().for_each(|(to, from)| to.copy_from_slice(from));
        *values = bytemuck::try_cast_vec(made).unwrap_or_else(|(_, made)| bytemuck::pod_collect_to_vec(&made));
        (self.runs, self.stored) = (inverse(std::mem::take(&mut self.runs)), stored);
    }

    /// Stores the rows of this array only, and moves the others together.
    fn take_away<T: Pod>(&mut self, values: &mut Vec<T>) {
        let (mut at, mut to, mut stored) = (0, 0, Words::zeros(self.words(|run| run.here)));
        let mut out = &mut *stored;
        for run in &self.runs {
            let [same, here] = [run.same, run.here].map(|rows| rows as usize * self.width);
            values.copy_within(at..at + same, to);
            front(&mut out, here).copy_from_slice(bytemuck::cast_slice(&values[at + same..at + same + here]));
            (at, to) = (at + same + here, to + same);
        }
        values.copy_within(at.., to);
        values.truncate(to + values.len() - at);
        (self.runs, self.stored) = (inverse(std::mem::take(&mut self.runs)), stored);
    }

    /// Makes room for the rows that are stored, from the last one on, and puts them in.
    fn put_in<T: Pod>(&mut self, values: &mut Vec<T>) {
        let same = self.words(|run| run.same);
        let (mut end, mut from) = (values.len(), self.stored.len());
        values.reserve_exact(from);
        values.resize(end + from, T::zeroed());
        let mut to = values.len();
        values.copy_within(same..end, same + from);
        (to, end) = (to - (end - same), same);
        for run in self.runs.iter().rev() {
            let [same, there] = [run.same, run.there].map(|rows| rows as usize * self.width);
            (to, from) = (to - there, from - there);
            values[to..to + there].copy_from_slice(bytemuck::cast_slice(&self.stored[from..from + there]));
            (to, end) = (to - same, end - same);
            values.copy_within(end..end + same, to);
        }
        (self.runs, self.stored) = (inverse(std::mem::take(&mut self.runs)), Words::default());
    }

    fn words(&self, of: impl Fn(&Run) -> u32) -> usize {
        self.runs.iter().map(|run| of(run) as usize * self.width).sum()
    }

    fn swap_in_place(&mut self, values: &mut [u32]) {
        let (mut values, mut stored, mut pieces) = (values, &mut *self.stored, Vec::new());
        for run in &self.runs {
            let [same, count] = [run.same, run.here].map(|rows| rows as usize * self.width);
            let a = front(&mut values, same + count).split_at_mut(same).1;
            let b = front(&mut stored, count);
            pieces.extend(a.chunks_mut(PIECE).zip(b.chunks_mut(PIECE)));
        }
        pieces.into_par_iter().for_each(|(a, b)| a.swap_with_slice(b));
    }

    /// Brings back rows that were overwritten; does nothing where others were to be added or taken away.
    pub(super) fn restore<T: Pod>(&mut self, values: &mut [T]) {
        if self.runs.iter().all(|run| run.here == run.there) {
            self.swap_in_place(bytemuck::cast_slice_mut(values));
        }
    }

    /// Whether it makes another array of `values`.
    pub(super) fn changes(&self, values: &[u32]) -> bool {
        if self.runs.iter().any(|run| run.here != run.there) {
            return true;
        }
        let (mut at, mut from, mut pieces) = (0, 0, Vec::new());
        for run in &self.runs {
            let [same, count] = [run.same, run.here].map(|rows| rows as usize * self.width);
            let (a, b) = (&values[at + same..at + same + count], &self.stored[from..from + count]);
            pieces.extend(a.chunks(PIECE).zip(b.chunks(PIECE)));
            (at, from) = (at + same + count, from + count);
        }
        pieces.into_par_iter().any(|(a, b)| a != b)
    }

    /// Memory that it takes.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.runs.as_slice()) + size_of_val(&*self.stored)
    }
}

/// A run for all neighbours in a mask, `one` for each of them.
fn runs_of(mask: &[bool], one: Run) -> Vec<Run> {
    let mut runs = Collector::default();
    mask.iter().for_each(|&is_other| if is_other { runs.other(one.here, one.there) } else { runs.same() });
    runs.finish()
}

fn rows_of(values: &[u32], width: usize, mask: &[bool]) -> Words {
    let indices: Vec<usize> = (0..mask.len()).filter(|&i| mask[i]).collect();
    let mut rows = Words::zeros(indices.len() * width);
    pick_into(&mut rows, values, width, &indices);
    rows
}

/// Takes a slice's front off.
fn front<'a>(slice: &mut &'a mut [u32], count: usize) -> &'a mut [u32] {
    let (front, rest) = std::mem::take(slice).split_at_mut(count);
    *slice = rest;
    front
}

/// Notes that `from` is to be copied to the front of `to`, which is taken off.
fn copy<'a>(pieces: &mut Vec<(&'a mut [u32], &'a [u32])>, to: &mut &'a mut [u32], from: &'a [u32]) {
    pieces.extend(front(to, from.len()).chunks_mut(PIECE).zip(from.chunks(PIECE)));
}

fn inverse(runs: Vec<Run>) -> Vec<Run> {
    runs.into_iter().map(|run| Run { here: run.there, there: run.here, ..run }).collect()
}

/// Collects rows into runs.
#[derive(Default)]
struct Collector {
    runs: Vec<Run>,
    open: Option<Run>,
    same: u32,
}

impl Collector {
    fn same(&mut self) {
        self.runs.extend(self.open.take());
        self.same += 1;
    }

    fn other(&mut self, here: u32, there: u32) {
        let same = std::mem::take(&mut self.same);
        let run = self.open.get_or_insert(Run { same, here: 0, there: 0 });
        run.here += here;
        run.there += there;
    }

    fn finish(mut self) -> Vec<Run> {
        self.runs.extend(self.open.take());
        self.runs
    }
}

/// Arrays of equal length, row by row.
fn changed(here: &[u32], there: &[u32], width: usize) -> Vec<Run> {
    let mut runs = Collector::default();
    for (a, b) in here.chunks(width).zip(there.chunks(width)) {
        if a == b { runs.same() } else { runs.other(1, 1) }
    }
    runs.finish()
}

/// Rows that `there` has beside all those of `here`, in their order; `None` when some of these are not in it.
fn additional(here: &[u32], there: &[u32], width: usize) -> Option<Vec<Run>> {
    let mut runs = Collector::default();
    let mut left = here.chunks(width).peekable();
    for row in there.chunks(width) {
        if left.next_if(|next| *next == row).is_some() { runs.same() } else { runs.other(0, 1) }
    }
    left.next().is_none().then(|| runs.finish())
}

/// Everything between the first and the last difference.
fn middle(here: &[u32], there: &[u32], width: usize) -> Vec<Run> {
    let rows = |words: &[u32]| words.len() / width;
    let least = rows(here).min(rows(there));
    let same = |pairs: &mut dyn Iterator<Item = (&[u32], &[u32])>| pairs.take_while(|(a, b)| a == b).count();
    let first = same(&mut here.chunks(width).zip(there.chunks(width)));
    let last = same(&mut here.rchunks(width).zip(there.rchunks(width))).min(least - first);
    let between = |words: &[u32]| (rows(words) - first - last) as u32;
    vec![Run { same: first as u32, here: between(here), there: between(there) }]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// So many rows that what is kept of them has pages of its own.
    #[test]
    fn long_arrays_come_back() {
        let before: Vec<u32> = (0..3_000_000).collect();
        let mask: Vec<bool> = (0..1_000_000).map(|row| row % 7 > 0).collect();
        let mut overwritten = Splices::overwritten(&before, 3, &mask);
        assert!(matches!(overwritten.stored, Words::Many(_)));
        let mut values = before.clone();
        values.chunks_mut(3).zip(&mask).filter(|(_, m)| **m).for_each(|(row, _)| row.fill(9));
        let after = values.clone();
        assert!(overwritten.changes(&values));
        for expected in [&before, &after, &before] {
            overwritten.swap(&mut values);
            assert!(values == *expected, "rows that were overwritten");
        }
        assert!(!overwritten.changes(&after));
        let mut removed = Splices::removed(&before, 3, &mask);
        let kept = before.chunks(3).zip(&mask).filter(|(_, m)| !**m).flat_map(|(row, _)| row.to_vec());
        let short: Vec<u32> = kept.collect();
        let mut values = short.clone();
        for expected in [&before, &short, &before] {
            removed.swap(&mut values);
            assert!(values == *expected, "rows that were taken away");
        }
    }

    #[test]
    fn arrays_are_made_of_each_other() {
        let long: Vec<u32> = (0..40).collect();
        let cut: Vec<u32> =
            long.chunks(2).enumerate().filter(|(i, _)| i % 3 != 1).flat_map(|(_, r)| r.to_vec()).collect();
        let patched: Vec<u32> =
            long.iter().map(|&v| if (10..14).contains(&v) || v == 30 { v + 100 } else { v }).collect();
        let other: Vec<u32> = (35..75).rev().chain([1, 2]).collect();
        let mut sizes = Vec::new();
        for (a, b) in
            [(&long, &cut), (&cut, &long), (&long, &patched), (&cut, &patched), (&other, &long), (&long, &vec![])]
        {
            let mut splices = Splices::between(a, b.clone(), 2).unwrap();
            sizes.push(splices.stored.len());
            let mut values = a.clone();
            for expected in [b, a, b, a] {
                splices.swap(&mut values);
                assert_eq!(&values, expected);
            }
        }
        // Only what differs is stored.
        assert_eq!(sizes[..3], [0, 14, 6]);
        assert!(Splices::between(&long, long.clone(), 2).is_none());
        // Bits count, not values.
        let zeros = [0.0_f32, -0.0].map(f32::to_bits);
        let mut signs = Splices::between(&zeros, vec![0, 0], 1).unwrap();
        let mut values = vec![0.0_f32, -0.0];
        signs.swap(&mut values);
        assert!(values.iter().all(|v| v.is_sign_positive()));
    }
}
