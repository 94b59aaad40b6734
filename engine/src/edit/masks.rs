//! What a session says of each Gaussian: whether it is selected, has a name, is hidden or locked.

use std::collections::BTreeMap;

use crate::error::{Error, Result};

/// One mask of a session.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Mask {
    Selected,
    Hidden,
    Locked,
    Named(String),
}

/// Masks `[N]`. None is there before something was selected, named, hidden or locked.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Masks(BTreeMap<Mask, Vec<bool>>);

impl Masks {
    pub(super) fn get(&self, mask: &Mask) -> Option<&[bool]> {
        self.0.get(mask).map(Vec::as_slice)
    }

    pub(super) fn set(&mut self, mask: Mask, values: Option<Vec<bool>>) {
        match values {
            Some(values) => drop(self.0.insert(mask, values)),
            None => drop(self.0.remove(&mask)),
        }
    }

    /// What there is.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&Mask, &Vec<bool>)> {
        self.0.iter()
    }

    /// Names, in order.
    pub(super) fn names(&self) -> impl Iterator<Item = (&str, &[bool])> {
        self.0.iter().filter_map(|(mask, values)| match mask {
            Mask::Named(name) => Some((name.as_str(), values.as_slice())),
            _ => None,
        })
    }

    /// What is selected.
    ///
    /// # Errors
    /// [`Error::Usage`] before the first selection.
    pub(super) fn selected(&self) -> Result<&[bool]> {
        self.get(&Mask::Selected).ok_or_else(|| Error::usage("selection", "none so far", "a `select` before this"))
    }

    /// What was given this name.
    ///
    /// # Errors
    /// [`Error::Usage`] for a name that nothing has.
    pub(super) fn named(&self, name: &str) -> Result<&[bool]> {
        self.get(&Mask::Named(name.to_owned())).ok_or_else(|| {
            let known: Vec<&str> = self.names().map(|(name, _)| name).collect();
            let expected = if known.is_empty() { "`name` before this".into() } else { known.join(", ") };
            Error::usage("selection", format!("no name `{name}`"), expected)
        })
    }

    /// Whether a Gaussian is neither hidden nor locked: what is can be neither selected nor changed.
    pub(super) fn is_free(&self, i: usize) -> bool {
        [Mask::Hidden, Mask::Locked].iter().all(|mask| !self.get(mask).is_some_and(|values| values[i]))
    }

    /// Selects those of `found` that are neither hidden nor locked.
    pub(super) fn select(&mut self, mut found: Vec<bool>) {
        found.iter_mut().enumerate().filter(|(_, m)| **m).for_each(|(i, m)| *m = self.is_free(i));
        self.0.insert(Mask::Selected, found);
    }

    /// Hides or locks the Gaussians of `of`, which are then not selected; or, with `on` false, no longer.
    pub(super) fn mark(&mut self, mask: Mask, of: &[bool], on: bool) {
        let mut values = self.0.remove(&mask).unwrap_or_else(|| vec![false; of.len()]);
        values.iter_mut().zip(of).filter(|(_, of)| **of).for_each(|(value, _)| *value = on);
        if values.contains(&true) {
            self.0.insert(mask, values);
        }
        if let Some(selected) = self.0.remove(&Mask::Selected) {
            self.select(selected);
        }
    }

    /// Keeps the Gaussians of a mask.
    pub(super) fn keep(&mut self, mask: &[bool]) {
        for values in self.0.values_mut() {
            let mut kept = mask.iter();
            values.retain(|_| kept.next().copied().unwrap_or(false));
        }
    }

    /// Selects the last `count` of `n` Gaussians, which are new: no other mask has them.
    pub(super) fn select_last(&mut self, n: usize, count: usize) {
        self.0.values_mut().for_each(|values| values.resize(n, false));
        self.0.insert(Mask::Selected, (0..n).map(|i| i + count >= n).collect());
    }
}
