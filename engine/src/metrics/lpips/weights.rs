//! Weights of the networks and heads, from the user's file.

use std::collections::BTreeMap;
use std::path::Path;

use super::network::{Conv, Network};
use crate::error::{Error, Result};
use crate::file::tensors::{self, StoredTensor};

/// Weights of one network.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// Which one.
    pub network: Network,
    /// Per convolution, in order: `[outputs, inputs, kernel, kernel]`, then the bias `[outputs]`.
    pub convs: Vec<Vec<f32>>,
    /// Per feature map: weight of each channel.
    pub heads: [Vec<f32>; 5],
}

/// The networks that a file holds: one or both.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WeightsFile {
    /// AlexNet.
    pub alex: Option<Weights>,
    /// VGG-16.
    pub vgg: Option<Weights>,
}

impl Weights {
    /// All zero: for what does not depend on them.
    pub fn zero(network: Network) -> Self {
        let slices = network.slices();
        let length = |c: &Conv| c.outputs * (c.inputs * c.kernel * c.kernel + 1);
        let convs = slices.iter().flat_map(|s| s.convs).map(|c| vec![0.0; length(c)]).collect();
        let heads = std::array::from_fn(|i| vec![0.0; slices[i].convs.last().map_or(0, |c| c.outputs)]);
        Self { network, convs, heads }
    }
}

impl WeightsFile {
    /// Reads the weights of one or both networks (names and layout: see [`super`]).
    ///
    /// # Errors
    /// [`Error::Corrupt`] naming the tensor; [`Error::Io`].
    pub fn read(path: &Path) -> Result<Self> {
        let tensors = tensors::read_plain(path)?;
        let mut file = Self::default();
        for network in Network::ALL {
            let prefix = format!("{}.", network.name());
            if let Some(prefix) = [prefix.as_str(), ""].into_iter().find(|p| holds(&tensors, p, network)) {
                let weights = Source { tensors: &tensors, prefix, path }.weights(network)?;
                match network {
                    Network::Alex => file.alex = Some(weights),
                    Network::Vgg => file.vgg = Some(weights),
                }
            }
        }
        if file == Self::default() {
            let found = match tensors.get("net.slice1.0.weight").or_else(|| tensors.get("features.0.weight")) {
                Some(t) => format!("a first convolution of shape {:?}", t.shape),
                None => "none".to_owned(),
            };
            let expected = "net.slice1.0.weight of shape [64, 3, 11, 11] (AlexNet) or [64, 3, 3, 3] (VGG-16)";
            return Err(Error::corrupt(path, "tensors of LPIPS", found, expected));
        }
        Ok(file)
    }

    /// Adds what another file holds; its weights win.
    pub fn merge(&mut self, other: Self) {
        self.alex = other.alex.or(self.alex.take());
        self.vgg = other.vgg.or(self.vgg.take());
    }

    /// The weights of a network, if there.
    pub fn get(&self, network: Network) -> Option<&Weights> {
        match network {
            Network::Alex => self.alex.as_ref(),
            Network::Vgg => self.vgg.as_ref(),
        }
    }
}

/// Whether the first convolution of a network is there.
fn holds(tensors: &BTreeMap<String, StoredTensor>, prefix: &str, network: Network) -> bool {
    let first = &network.slices()[0].convs[0];
    let shape = [first.outputs, first.inputs, first.kernel, first.kernel];
    let names = [format!("{prefix}net.slice1.0.weight"), format!("{prefix}features.0.weight")];
    names.iter().any(|name| tensors.get(name).is_some_and(|t| t.shape == shape))
}

struct Source<'a> {
    tensors: &'a BTreeMap<String, StoredTensor>,
    prefix: &'a str,
    path: &'a Path,
}

impl Source<'_> {
    fn weights(&self, network: Network) -> Result<Weights> {
        let mut convs = Vec::new();
        let mut heads: [Vec<f32>; 5] = Default::default();
        for (i, slice) in network.slices().iter().enumerate() {
            for conv in slice.convs {
                convs.push(self.conv(i + 1, conv)?);
            }
            let channels = slice.convs.last().map_or(0, |c| c.outputs);
            let names = [format!("lins.{i}.model.1.weight"), format!("lin{i}.model.1.weight")];
            heads[i] = self.tensor(&names, &[1, channels, 1, 1])?;
        }
        Ok(Weights { network, convs, heads })
    }

    fn conv(&self, slice: usize, conv: &Conv) -> Result<Vec<f32>> {
        let names =
            |kind: &str| [format!("net.slice{slice}.{}.{kind}", conv.layer), format!("features.{}.{kind}", conv.layer)];
        let mut all = self.tensor(&names("weight"), &[conv.outputs, conv.inputs, conv.kernel, conv.kernel])?;
        all.extend(self.tensor(&names("bias"), &[conv.outputs])?);
        Ok(all)
    }

    /// The first of `names` that is there.
    fn tensor(&self, names: &[String; 2], shape: &[usize]) -> Result<Vec<f32>> {
        let find = |name: &String| self.tensors.get_key_value(&format!("{}{name}", self.prefix));
        let expected = format!("F32 of shape {shape:?}");
        let Some((name, tensor)) = names.iter().find_map(find) else {
            let at = format!("tensor `{}{}`", self.prefix, names[0]);
            return Err(Error::corrupt(self.path, at, "nothing", expected));
        };
        if tensor.dtype != "F32" || tensor.shape != shape {
            let found = format!("{} of shape {:?}", tensor.dtype, tensor.shape);
            return Err(Error::corrupt(self.path, format!("tensor `{name}`"), found, expected));
        }
        let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        let values: Vec<f32> = tensor.bytes.chunks_exact(4).map(value).collect();
        match values.iter().position(|v| !v.is_finite()) {
            None => Ok(values),
            Some(i) => {
                let at = format!("tensor `{name}` element {i}");
                Err(Error::corrupt(self.path, at, values[i].to_string(), "a finite number"))
            }
        }
    }
}
