//! Named arrays of a checkpoint: what models of motion write and read.

use std::collections::BTreeMap;

use super::config::Config;
use super::parameters::ParameterState;
use crate::error::{Error, Result};
use crate::file::tensors::{NamedTensor, StoredTensor, floats, indices};
use crate::scene::{DeformNetwork, DeformSize, NonrigidNetwork};

/// A network's weights and moments, flat.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NetworkState {
    /// Weights and biases, layer by layer.
    pub weights: Vec<f32>,
    /// First moments.
    pub moment_1: Vec<f32>,
    /// Second moments.
    pub moment_2: Vec<f32>,
}

impl NetworkState {
    /// Network F with these weights.
    ///
    /// # Errors
    /// [`Error::Usage`] for another number of weights.
    pub fn deform(&self, size: DeformSize) -> Result<DeformNetwork> {
        DeformNetwork::from_flat(&self.weights, size)
    }

    /// Network G with these weights.
    ///
    /// # Errors
    /// [`Error::Usage`] for another number of weights.
    pub fn nonrigid(&self) -> Result<NonrigidNetwork> {
        NonrigidNetwork::from_flat(&self.weights)
    }
}

/// What a model of motion goes on from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stored<'a> {
    /// The run's configuration, as given.
    pub(super) config: &'a Config,
    /// The Gaussians.
    pub(super) parameters: &'a ParameterState,
    /// Its own arrays.
    pub(super) saved: &'a Saved,
}

/// Arrays by name. Errors name the array; whoever reads a file adds the file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Saved(pub(super) BTreeMap<String, StoredTensor>);

impl Saved {
    /// Whether there is an array of this name.
    pub fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    fn bytes(&self, name: &str, dtype: &str, count: Option<usize>) -> Result<&[u8]> {
        let expected = || count.map_or(format!("{dtype} values"), |c| format!("{c} {dtype} values"));
        match self.0.get(name) {
            None => Err(Error::usage(name, "nothing", expected())),
            Some(t) if t.dtype != dtype || count.is_some_and(|c| t.bytes.len() != 4 * c) => {
                Err(Error::usage(name, format!("{} {:?}", t.dtype, t.shape), expected()))
            }
            Some(t) => Ok(&t.bytes),
        }
    }

    /// Floats, `count` of them where that is known.
    ///
    /// # Errors
    /// `Usage` naming the array when it is not there, of another type or another length.
    pub fn floats(&self, name: &str, count: Option<usize>) -> Result<Vec<f32>> {
        Ok(self.bytes(name, "F32", count)?.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
    }

    /// Unsigned words, `count` of them where that is known.
    ///
    /// # Errors
    /// As [`Saved::floats`].
    pub fn indices(&self, name: &str, count: Option<usize>) -> Result<Vec<u32>> {
        Ok(self.bytes(name, "U32", count)?.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect())
    }

    /// Floats of this shape, where sides are known.
    ///
    /// # Errors
    /// As [`Saved::floats`].
    pub(super) fn shaped(&self, name: &str, shape: &[Option<usize>]) -> Result<Vec<f32>> {
        let fits = |f: &[usize]| f.len() == shape.len() && f.iter().zip(shape).all(|(f, s)| s.is_none_or(|s| s == *f));
        if let Some(found) = self.0.get(name).map(|t| &t.shape).filter(|found| !fits(found)) {
            let sides: Vec<String> = shape.iter().map(|s| s.map_or("any".into(), |n| n.to_string())).collect();
            return Err(Error::usage(name, format!("{found:?}"), format!("F32 [{}]", sides.join(", "))));
        }
        self.floats(name, None)
    }

    fn put(&mut self, tensor: NamedTensor<'_>) {
        let NamedTensor { name, dtype, shape, bytes } = tensor;
        self.0.insert(name.into_owned(), StoredTensor { dtype: dtype.into(), shape, bytes: bytes.into_owned() });
    }

    /// Adds floats.
    pub fn put_floats(&mut self, name: &str, shape: Vec<usize>, values: &[f32]) {
        self.put(floats(name, shape, values));
    }

    /// Adds unsigned words.
    pub fn put_indices(&mut self, name: &str, shape: Vec<usize>, values: &[u32]) {
        self.put(indices(name, shape, values));
    }

    /// Weights and moments of a network.
    ///
    /// # Errors
    /// As [`Saved::floats`].
    pub fn network(&self, name: &str) -> Result<NetworkState> {
        let weights = self.floats(&format!("{name}.weights"), None)?;
        let count = Some(weights.len());
        let moment_1 = self.floats(&format!("{name}.moment_1"), count)?;
        Ok(NetworkState { weights, moment_1, moment_2: self.floats(&format!("{name}.moment_2"), count)? })
    }

    /// Adds a network's weights and moments.
    pub fn put_network(&mut self, name: &str, network: &NetworkState) {
        let parts = [("weights", &network.weights), ("moment_1", &network.moment_1), ("moment_2", &network.moment_2)];
        for (part, values) in parts {
            self.put_floats(&format!("{name}.{part}"), vec![values.len()], values);
        }
    }

    /// All arrays, as files hold them.
    pub(super) fn tensors(&self) -> impl Iterator<Item = NamedTensor<'_>> {
        self.0.iter().map(|(name, t)| NamedTensor {
            name: name.as_str().into(),
            dtype: if t.dtype == "U32" { "U32" } else { "F32" },
            shape: t.shape.clone(),
            bytes: t.bytes.as_slice().into(),
        })
    }
}
