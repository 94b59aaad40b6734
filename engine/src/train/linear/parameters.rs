//! Weights of a chain of dense layers in device memory, with Adam's moments.

use super::Shape;
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Memory, Slice};

/// Floats that a layer's parameters are padded to: slices of a buffer start at multiples of 256 bytes.
const ALIGNMENT: u32 = 64;

/// Weights and moments of a chain of layers. In each of the three buffers every layer has a slice: its weights
/// `[outputs, inputs]`, then its bias `[outputs]`, then padding to 64 floats.
#[derive(Debug)]
pub struct Parameters {
    gpu: Gpu,
    shapes: Vec<Shape>,
    value: Buffer,
    moment_1: Buffer,
    moment_2: Buffer,
    /// Running mean of the values, where one is kept.
    mean: Option<Buffer>,
}

impl Parameters {
    /// `layers` holds each layer's weights followed by its bias; the moments start at 0.
    pub fn new(gpu: &Gpu, name: &str, shapes: &[Shape], layers: &[Vec<f32>]) -> Result<Self> {
        let words: u32 = shapes.iter().map(padded).sum();
        let buffer = |part: &str| gpu.buffer(&format!("{name}.{part}"), u64::from(words) * 4, Memory::Device);
        let (value, moment_1, moment_2) = (buffer("parameter")?, buffer("moment_1")?, buffer("moment_2")?);
        let made = Self { gpu: gpu.clone(), shapes: shapes.to_vec(), value, moment_1, moment_2, mean: None };
        made.upload(layers)?;
        let zero: Vec<Vec<f32>> = shapes.iter().map(|s| vec![0.0; s.parameters() as usize]).collect();
        made.upload_moments([&zero, &zero])?;
        Ok(made)
    }

    /// Shape of each layer.
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// Number of the first weight of layer `i`, counting the padding, as reports count.
    pub fn first_index(&self, i: usize) -> u32 {
        self.shapes[..i].iter().map(padded).sum()
    }

    /// Floats of layer `i` with padding.
    pub fn padded(&self, i: usize) -> u32 {
        padded(&self.shapes[i])
    }

    /// Layer and position within its weights and bias of a reported index.
    pub fn locate(&self, index: u32) -> Option<(usize, u32)> {
        let found = (0..self.shapes.len()).rev().find(|&i| self.first_index(i) <= index)?;
        let at = index - self.first_index(found);
        (at < self.shapes[found].parameters()).then_some((found, at))
    }

    /// Value, first and second moment of layer `i`.
    pub(in crate::train) fn slices(&self, i: usize) -> [Slice; 3] {
        let (start, bytes) = (u64::from(self.first_index(i)) * 4, u64::from(self.padded(i)) * 4);
        [&self.value, &self.moment_1, &self.moment_2].map(|b| b.slice(start, bytes))
    }

    /// Values, first and second moments of all layers, with the padding.
    pub(in crate::train) fn all(&self) -> [Slice; 3] {
        [&self.value, &self.moment_1, &self.moment_2].map(Slice::from)
    }

    /// Keeps a running mean of the weights from now on, which starts from them as they are.
    pub fn keep_mean(&mut self, name: &str) -> Result<()> {
        let mean = self.gpu.buffer(&format!("{name}.mean"), self.value.bytes(), Memory::Device)?;
        self.write(&mean, &self.download()?)?;
        self.mean = Some(mean);
        Ok(())
    }

    /// The mean of layer `i`; its values where none is kept.
    pub(in crate::train) fn mean(&self, i: usize) -> Slice {
        let [value, ..] = self.slices(i);
        self.mean.as_ref().map_or(value.clone(), |mean| mean.slice(value.start, value.bytes))
    }

    /// The mean of all layers, with the padding.
    pub(in crate::train) fn all_means(&self) -> Option<Slice> {
        self.mean.as_ref().map(Slice::from)
    }

    /// Replaces the mean; does nothing where none is kept.
    pub fn upload_mean(&self, layers: &[Vec<f32>]) -> Result<()> {
        self.mean.as_ref().map_or(Ok(()), |mean| self.write(mean, layers))
    }

    /// Mean weights and bias of each layer; `None` where no mean is kept.
    pub fn download_mean(&self) -> Result<Option<Vec<Vec<f32>>>> {
        self.mean.as_ref().map(|mean| self.read(mean)).transpose()
    }

    /// Replaces the weights.
    pub fn upload(&self, layers: &[Vec<f32>]) -> Result<()> {
        self.write(&self.value, layers)
    }

    /// Weights and bias of each layer.
    pub fn download(&self) -> Result<Vec<Vec<f32>>> {
        self.read(&self.value)
    }

    /// Replaces the moments.
    pub fn upload_moments(&self, moments: [&[Vec<f32>]; 2]) -> Result<()> {
        self.write(&self.moment_1, moments[0])?;
        self.write(&self.moment_2, moments[1])
    }

    /// First and second moments of each layer.
    pub fn download_moments(&self) -> Result<[Vec<Vec<f32>>; 2]> {
        Ok([self.read(&self.moment_1)?, self.read(&self.moment_2)?])
    }

    /// Bytes of device memory.
    pub fn bytes(&self) -> u64 {
        self.value.bytes() + self.moment_1.bytes() + self.moment_2.bytes() + self.mean.as_ref().map_or(0, Buffer::bytes)
    }

    fn write(&self, buffer: &Buffer, layers: &[Vec<f32>]) -> Result<()> {
        let found: Vec<usize> = layers.iter().map(Vec::len).collect();
        let expected: Vec<usize> = self.shapes.iter().map(|s| s.parameters() as usize).collect();
        if found != expected {
            return Err(Error::usage(
                format!("{}, parameters per layer", buffer.name()),
                format!("{found:?}"),
                format!("{expected:?}"),
            ));
        }
        let mut words = Vec::new();
        for (shape, layer) in self.shapes.iter().zip(layers) {
            words.extend_from_slice(layer);
            words.resize(words.len() + (padded(shape) - shape.parameters()) as usize, 0.0);
        }
        self.gpu.upload(buffer, bytemuck::cast_slice(&words))
    }

    fn read(&self, buffer: &Buffer) -> Result<Vec<Vec<f32>>> {
        Ok(self.split(&bytemuck::pod_collect_to_vec(&self.gpu.download(buffer)?)))
    }

    /// Values laid out as the parameters, by layer and without the padding.
    pub(in crate::train) fn split(&self, words: &[f32]) -> Vec<Vec<f32>> {
        let layer = |i: usize| {
            let first = self.first_index(i) as usize;
            words[first..first + self.shapes[i].parameters() as usize].to_vec()
        };
        (0..self.shapes.len()).map(layer).collect()
    }
}

fn padded(shape: &Shape) -> u32 {
    shape.parameters().next_multiple_of(ALIGNMENT)
}
