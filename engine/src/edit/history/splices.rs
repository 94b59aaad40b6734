//! How an array differs from what it was: the rows that are others, no longer there or new.

use bytemuck::Pod;

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
#[derive(Debug, Clone)]
pub(super) struct Splices {
    /// Words of a row.
    width: usize,
    runs: Vec<Run>,
    stored: Vec<u32>,
}

impl Splices {
    /// What makes `there` of `here`, both of rows of `width` words; `None` of equal arrays. Rows that were only added, only taken
    /// away or only changed are found one by one; else everything between the first and the last difference is stored.
    pub(super) fn between(here: &[u32], there: &[u32], width: usize) -> Option<Self> {
        if here == there {
            return None;
        }
        let runs = match here.len().cmp(&there.len()) {
            std::cmp::Ordering::Equal => Some(changed(here, there, width)),
            std::cmp::Ordering::Less => additional(here, there, width),
            std::cmp::Ordering::Greater => additional(there, here, width).map(inverse),
        };
        let runs = runs.unwrap_or_else(|| middle(here, there, width));
        let (mut at, mut stored) = (0, Vec::new());
        for run in &runs {
            at += run.same as usize * width;
            let end = at + run.there as usize * width;
            stored.extend_from_slice(&there[at..end]);
            at = end;
        }
        Some(Self { width, runs, stored })
    }

    /// Makes the other array of `values`, which is the one that this belongs to; and belongs to the other one from then on.
    pub(super) fn swap<T: Pod>(&mut self, values: &mut Vec<T>) {
        if self.runs.iter().all(|run| run.here == run.there) {
            return self.swap_in_place(bytemuck::cast_slice_mut(values));
        }
        let old: &[u32] = bytemuck::cast_slice(values);
        let (mut at, mut from) = (0, 0);
        let (mut made, mut stored) = (Vec::with_capacity(old.len()), Vec::new());
        for run in &self.runs {
            let [same, here, there] = [run.same, run.here, run.there].map(|rows| rows as usize * self.width);
            made.extend_from_slice(&old[at..at + same]);
            made.extend_from_slice(&self.stored[from..from + there]);
            stored.extend_from_slice(&old[at + same..at + same + here]);
            (at, from) = (at + same + here, from + there);
        }
        made.extend_from_slice(&old[at..]);
        *values = bytemuck::pod_collect_to_vec(&made);
        (self.runs, self.stored) = (inverse(std::mem::take(&mut self.runs)), stored);
    }

    fn swap_in_place(&mut self, values: &mut [u32]) {
        let (mut at, mut from) = (0, 0);
        for run in &self.runs {
            let (start, count) = (at + run.same as usize * self.width, run.here as usize * self.width);
            values[start..start + count].swap_with_slice(&mut self.stored[from..from + count]);
            (at, from) = (start + count, from + count);
        }
    }

    /// Memory that it takes.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.runs.as_slice()) + size_of_val(self.stored.as_slice())
    }
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
            let mut splices = Splices::between(a, b, 2).unwrap();
            sizes.push(splices.stored.len());
            let mut values = a.clone();
            for expected in [b, a, b, a] {
                splices.swap(&mut values);
                assert_eq!(&values, expected);
            }
        }
        // Only what differs is stored.
        assert_eq!(sizes[..3], [0, 14, 6]);
        assert!(Splices::between(&long, &long, 2).is_none());
        // Bits count, not values.
        let zeros = [0.0_f32, -0.0].map(f32::to_bits);
        let mut signs = Splices::between(&zeros, &[0, 0], 1).unwrap();
        let mut values = vec![0.0_f32, -0.0];
        signs.swap(&mut values);
        assert!(values.iter().all(|v| v.is_sign_positive()));
    }
}
