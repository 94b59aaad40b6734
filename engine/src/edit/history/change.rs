//! What a group of commands changed of a session: what undoes them and then what does them again.

use bytemuck::Pod;
use rayon::prelude::*;

use super::before::{Before, Kept};
use super::columns::{Columns, SH};
use super::splices::Splices;
use crate::edit::masks::{Mask, Masks};
use crate::edit::session::{Seen, Session};
use crate::scene::Scene;

/// What brings a session back to what it was, and there again.
#[derive(Debug)]
pub(super) struct Change {
    numbers: Vec<(&'static str, Splices)>,
    indices: Vec<(&'static str, Splices)>,
    /// The scene without its arrays, if it was another.
    rest: Option<Box<Scene>>,
    masks: Vec<(Mask, Option<Bits>)>,
    seen: Seen,
}

impl Change {
    /// What brings `session` back to what it was.
    pub(super) fn since(before: Before, session: &mut Session) -> Self {
        let mut change = Self { masks: masks_between(&session.masks, &before.masks), ..Self::nothing(before.seen) };
        if let Some(mut scene) = before.scene {
            let kept = before.keeps_gaussians.then(|| Kept::take(&mut session.scene.gaussians));
            let (mut now, mut then) = (Columns::take(&mut session.scene), Columns::take(&mut scene));
            let sh = before.colors.is_some().then(|| (now.numbers.remove(SH), then.numbers.remove(SH)).0).flatten();
            change.numbers = differences(&now.numbers, then.numbers);
            if let (Some(sh), Some(colors)) = (sh, before.colors) {
                if colors.changes(bytemuck::cast_slice(&sh.0)) {
                    change.numbers.push((SH, colors));
                }
                now.numbers.insert(SH, sh);
            }
            change.indices = differences(&now.indices, then.indices);
            change.rest = (scene != session.scene).then(|| Box::new(scene));
            now.put(&mut session.scene);
            if let Some(kept) = kept {
                kept.put(&mut session.scene.gaussians);
            }
        }
        change
    }

    fn nothing(seen: Seen) -> Self {
        Self { numbers: Vec::new(), indices: Vec::new(), rest: None, masks: Vec::new(), seen }
    }

    /// Whether the scene is another.
    pub(super) fn is_of_scene(&self) -> bool {
        !self.numbers.is_empty() || !self.indices.is_empty() || self.rest.is_some()
    }

    /// Makes what was of what is; afterwards the other way round.
    pub(super) fn swap(&mut self, session: &mut Session) {
        std::mem::swap(&mut self.seen, &mut session.seen);
        for (mask, stored) in &mut self.masks {
            let now = session.masks.get(mask).map(Bits::of);
            session.masks.set(mask.clone(), std::mem::replace(stored, now).map(|bits| bits.mask()));
        }
        if !self.is_of_scene() {
            return;
        }
        let mut columns = Columns::take(&mut session.scene);
        if let Some(rest) = &mut self.rest {
            std::mem::swap(&mut **rest, &mut session.scene);
        }
        for (name, splices) in &mut self.numbers {
            splices.swap(&mut columns.numbers.entry(name).or_default().0);
        }
        for (name, splices) in &mut self.indices {
            splices.swap(&mut columns.indices.entry(name).or_default().0);
        }
        columns.put(&mut session.scene);
    }

    /// Memory of what grows with the scene.
    pub(super) fn bytes(&self) -> usize {
        let splices = self.numbers.iter().chain(&self.indices).map(|(_, splices)| splices.bytes());
        splices.chain(self.masks.iter().flat_map(|(_, bits)| bits).map(|bits| bits.words.len() * 8)).sum()
    }
}

type Named<T> = std::collections::BTreeMap<&'static str, (Vec<T>, usize)>;

fn differences<T: Pod + Send + Sync>(now: &Named<T>, mut then: Named<T>) -> Vec<(&'static str, Splices)> {
    for name in now.keys() {
        then.entry(name).or_default();
    }
    let nothing = (Vec::new(), 0);
    let of = |(name, (there, b)): (&'static str, (Vec<T>, usize))| {
        let (here, a) = now.get(name).unwrap_or(&nothing);
        // Rows of other widths have nothing in common.
        let width = if *a == b {
            b
        } else if b.min(*a) == 0 {
            b.max(*a)
        } else {
            1
        };
        let there = bytemuck::try_cast_vec(there).unwrap_or_else(|(_, there)| bytemuck::pod_collect_to_vec(&there));
        Some((name, Splices::between(bytemuck::cast_slice(here), there, width)?))
    };
    then.into_par_iter().filter_map(of).collect()
}

/// Masks that were others.
fn masks_between(now: &Masks, then: &Masks) -> Vec<(Mask, Option<Bits>)> {
    let gone = then.iter().filter(|(mask, values)| now.get(mask) != Some(values.as_slice()));
    let new = now.iter().filter(|(mask, _)| then.get(mask).is_none());
    gone.map(|(mask, values)| (mask.clone(), Some(Bits::of(values))))
        .chain(new.map(|(mask, _)| (mask.clone(), None)))
        .collect()
}

/// A mask with a bit for each Gaussian.
#[derive(Debug)]
struct Bits {
    count: usize,
    words: Vec<u64>,
}

impl Bits {
    fn of(mask: &[bool]) -> Self {
        let word = |bits: &[bool]| bits.iter().enumerate().fold(0, |word, (k, bit)| word | u64::from(*bit) << k);
        Self { count: mask.len(), words: mask.chunks(64).map(word).collect() }
    }

    fn mask(&self) -> Vec<bool> {
        let bits = self.words.iter().flat_map(|word| (0..64).map(move |k| word >> k & 1 == 1));
        bits.take(self.count).collect()
    }
}
