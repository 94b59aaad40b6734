//! A sort by itself, for measuring.

use std::time::Instant;

use super::SortPlan;
use super::record::{SortSlices, record};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Commands, Gpu, Groups, Memory};
use crate::render::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers};

/// Keys and values on the device that can be sorted again and again.
#[derive(Debug)]
pub struct DeviceSort {
    gpu: Gpu,
    commands: Commands,
    sorted: [Buffer; 2],
}

impl DeviceSort {
    /// Uploads `keys`, whose values are their positions, and records a sort of their lowest `key_bits` bits.
    ///
    /// # Errors
    /// `Usage`, `Limit` (see [`SortPlan::new`]), `OutOfMemory`, `DeviceLost`.
    pub fn new(gpu: &Gpu, keys: &[u32], key_bits: u32) -> Result<Self> {
        Self::with_plan(gpu, keys, &SortPlan::for_device(gpu, keys.len() as u32, key_bits)?)
    }

    /// The same by a plan for as many keys.
    ///
    /// # Errors
    /// As [`DeviceSort::new`]; `Usage` for a plan of other capacity.
    pub fn with_plan(gpu: &Gpu, keys: &[u32], plan: &SortPlan) -> Result<Self> {
        let count = keys.len() as u32;
        if plan.capacity != count {
            return Err(Error::usage("keys to sort", count.to_string(), format!("{} as planned", plan.capacity)));
        }
        let positions: Vec<u32> = (0..count).collect();
        let unsorted = [
            gpu.buffer_with("keys", bytemuck::cast_slice(keys))?,
            gpu.buffer_with("values", bytemuck::cast_slice(&positions))?,
        ];
        let counters = gpu.buffer_with("counters", bytemuck::cast_slice(&[count; 8]))?;
        let pair = |name: &str| -> Result<[Buffer; 2]> {
            let make = || gpu.buffer(name, 4 * u64::from(count.max(1)), Memory::Device);
            Ok([make()?, make()?])
        };
        let (key, value) = (pair("sort keys")?, pair("sort values")?);
        let histogram = |_| gpu.buffer("sort histogram", plan.histogram_bytes(), Memory::Device);
        let histograms = (0..plan.digits.len()).map(histogram).collect::<Result<Vec<Buffer>>>()?;
        let mut r = gpu.recorder("sort").with_timestamps(true);
        r.copy(&unsorted[0], &key[0])?;
        r.copy(&unsorted[1], &value[0])?;
        if !plan.counted_apart {
            histograms[1..].iter().try_for_each(|later| r.fill(later, 0))?;
        }
        let buffers =
            SortHistogramBuffers { counters: counters.whole(), keys: key[0].whole(), histogram: histograms[0].whole() };
        let groups = || Groups::Direct(plan.partitions.into());
        r.dispatch(&SORT_HISTOGRAM, (), plan.histogram_push(0, 0), buffers, groups())?;
        let slices = SortSlices {
            counters: counters.whole(),
            count_word: 0,
            keys: [0, 1].map(|i: usize| key[i].whole()),
            values: [0, 1].map(|i: usize| value[i].whole()),
            histograms: histograms.iter().map(Buffer::whole).collect(),
        };
        record(&mut r, "keys", plan, &slices, groups)?;
        let last = plan.result_in();
        Ok(Self { gpu: gpu.clone(), commands: r.finish()?, sorted: [key[last].clone(), value[last].clone()] })
    }

    /// Sorts what was uploaded; device time of its dispatches, or the host's where there are no timestamps, microseconds.
    ///
    /// # Errors
    /// `DeviceLost`, `TimedOut`.
    pub fn run(&mut self) -> Result<f64> {
        let start = Instant::now();
        let submission = self.gpu.submit(&mut self.commands)?;
        self.gpu.wait(submission)?;
        let host_us = start.elapsed().as_secs_f64() * 1e6;
        let timings = self.commands.timings()?;
        let us = timings.iter().filter(|t| t.label.starts_with("sort_")).map(|t| t.us).sum();
        Ok(if us > 0.0 { us } else { host_us })
    }

    /// Dispatches of a run.
    pub fn dispatches(&self) -> usize {
        self.commands.dispatches()
    }

    /// Keys and values after a run.
    ///
    /// # Errors
    /// `DeviceLost`.
    pub fn download(&self) -> Result<[Vec<u32>; 2]> {
        let words =
            |buffer: &Buffer| -> Result<Vec<u32>> { Ok(bytemuck::pod_collect_to_vec(&self.gpu.download(buffer)?)) };
        Ok([words(&self.sorted[0])?, words(&self.sorted[1])?])
    }
}
