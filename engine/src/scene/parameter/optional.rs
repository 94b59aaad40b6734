//! The optional parameters of some Gaussians.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::{PARAMETERS, Parameter, Present, REQUIRED, transposed};
use crate::scene::gaussians::{repeat_chunks, retain_chunks};

/// The optional parameters that some Gaussians have, `[N,width]` each.
#[derive(Debug, Clone, PartialEq)]
pub struct Optional<T = f32>(BTreeMap<usize, Vec<T>>);

impl<T> Default for Optional<T> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl<T: Copy> Optional<T> {
    /// Values of a parameter, where the Gaussians have it.
    pub fn get(&self, parameter: usize) -> Option<&[T]> {
        self.0.get(&parameter).map(Vec::as_slice)
    }

    /// Values of a parameter of Gaussian `i`.
    pub fn row(&self, parameter: usize, i: usize) -> Option<&[T]> {
        let width = PARAMETERS[parameter].width as usize;
        self.get(parameter)?.get(i * width..(i + 1) * width)
    }

    /// Takes a parameter away from the Gaussians; what it was.
    pub fn take(&mut self, parameter: usize) -> Option<Vec<T>> {
        self.0.remove(&parameter)
    }

    /// Gives the Gaussians a parameter.
    pub fn set(&mut self, parameter: usize, values: Vec<T>) {
        self.0.insert(parameter, values);
    }

    /// What there is: place in [`PARAMETERS`] and values.
    pub fn iter(&self) -> impl Iterator<Item = (usize, &[T])> {
        self.0.iter().map(|(parameter, values)| (*parameter, values.as_slice()))
    }

    /// Which there are.
    pub fn present(&self) -> Present {
        Present(self.0.keys().fold(0, |bits, parameter| bits | 1 << (parameter - REQUIRED)))
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Those of the Gaussians at these indices, in this order.
    #[must_use]
    pub fn selected(&self, indices: &[usize]) -> Self {
        let of =
            |parameter| indices.iter().flat_map(|&i| self.row(parameter, i).unwrap_or_default()).copied().collect();
        Self(self.0.keys().map(|&parameter| (parameter, of(parameter))).collect())
    }

    /// Every number, one parameter after another.
    pub fn numbers(&self) -> impl Iterator<Item = T> {
        self.0.values().flatten().copied()
    }

    /// Every number, to be changed.
    pub fn numbers_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.0.values_mut().flatten()
    }

    /// The same in another type.
    pub fn map<U>(&self, to: impl Fn(T) -> U) -> Optional<U> {
        Optional(
            self.0.iter().map(|(parameter, values)| (*parameter, values.iter().map(|v| to(*v)).collect())).collect(),
        )
    }
}

impl Optional {
    /// Gives `n` Gaussians those of these parameters that they lack, as parameters start.
    pub(crate) fn add(&mut self, present: Present, n: usize) {
        for parameter in present.iter() {
            self.0.entry(parameter).or_insert_with(|| PARAMETERS[parameter].start.repeat(n));
        }
    }

    /// Keeps those of the Gaussians for which `keep` holds.
    pub(crate) fn retain(&mut self, keep: &[bool]) {
        self.0.iter_mut().for_each(|(parameter, v)| retain_chunks(v, PARAMETERS[*parameter].width as usize, keep));
    }

    /// Adds copies of those of the Gaussians at `indices`.
    pub(crate) fn repeat(&mut self, indices: &[usize]) {
        self.0.iter_mut().for_each(|(parameter, v)| repeat_chunks(v, PARAMETERS[*parameter].width as usize, indices));
    }

    /// Adds those of `other` in `range` after the `own` Gaussians there are. Who lacks a parameter of the other gets what it
    /// starts with.
    pub(crate) fn append(&mut self, own: usize, other: &Self, range: Range<usize>) {
        let present: BTreeSet<usize> = self.0.keys().chain(other.0.keys()).copied().collect();
        for parameter in present {
            let Parameter { width, start, .. } = PARAMETERS[parameter];
            let width = width as usize;
            let values = self.0.entry(parameter).or_insert_with(|| start.repeat(own));
            match other.get(parameter) {
                Some(more) => values.extend_from_slice(&more[range.start * width..range.end * width]),
                None => values.extend(start.repeat(range.len())),
            }
        }
    }

    /// `[planes][N]` of all of them, as the device has them.
    pub fn to_device(&self) -> Vec<f32> {
        self.iter().flat_map(|(parameter, values)| transposed(values, PARAMETERS[parameter].width as usize)).collect()
    }
}
