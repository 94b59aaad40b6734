//! LPIPS on the device: both pictures through the network, slice by slice. Where a feature map is large, its slice runs in
//! bands of rows, each going straight into the difference and the next pool, so that no map of full size is stored there.

use super::lpips_conv::{LPIPS_CONV, LpipsConvBuffers, LpipsConvConstants, LpipsConvPush};
use super::lpips_difference::{LPIPS_DIFFERENCE, LpipsDifferenceBuffers, LpipsDifferencePush};
use super::lpips_pool::{LPIPS_POOL, LpipsPoolBuffers, LpipsPoolConstants, LpipsPoolPush};
use super::network::{Conv, Slice, pooled_side};
use super::{Network, Range, THREADS, Weights, check_size, input};
use crate::error::Result;
use crate::gpu::interface::{Interface, KernelOf};
use crate::gpu::product::{self, product_groups};
use crate::gpu::{Buffer, Gpu, Groups, Memory, Slice as Bytes};
use crate::metrics::planes::{Planes, same_size};

/// Bytes of a band of features.
const BAND_BYTES: usize = 64 << 20;
/// Products of one submission: seconds on a busy CPU, so that no device's patience ends.
const SUBMISSION_PRODUCTS: usize = 2 << 30;
/// Channels that are not cut further: a tile of the product.
const CHANNEL_STEP: usize = 32;

/// A network with its weights on the device.
#[derive(Debug)]
pub struct Lpips {
    gpu: Gpu,
    network: Network,
    /// One buffer per convolution: weights, then bias.
    convs: Vec<Buffer>,
    heads: Vec<Buffer>,
    band_bytes: usize,
}

/// Feature maps of both pictures, `[channels, height, width]` each.
#[derive(Debug)]
struct Maps {
    width: usize,
    height: usize,
    buffers: [Buffer; 2],
}

/// Rows `first..end` of a map of `height` rows, in a buffer of its own.
#[derive(Debug, Clone)]
struct Band {
    buffer: Buffer,
    width: usize,
    height: usize,
    first: usize,
    end: usize,
}

/// One slice of the network with its place in the list of convolutions.
#[derive(Debug, Clone, Copy)]
struct Stage {
    index: usize,
    slice: &'static Slice,
    first_conv: usize,
    /// Pool of the next slice; `None` for the last.
    next: Option<Option<usize>>,
}

impl Lpips {
    /// Uploads the weights.
    ///
    /// # Errors
    /// Those of allocation and upload.
    pub fn new(gpu: &Gpu, weights: &Weights) -> Result<Self> {
        let upload = |name: &str, values: &Vec<f32>| gpu.buffer_with(name, bytemuck::cast_slice(values));
        let convs = weights.convs.iter().map(|c| upload("lpips parameter", c)).collect::<Result<_>>()?;
        let heads = weights.heads.iter().map(|h| upload("lpips head", h)).collect::<Result<_>>()?;
        Ok(Self { gpu: gpu.clone(), network: weights.network, convs, heads, band_bytes: BAND_BYTES })
    }

    /// Which network.
    pub fn network(&self) -> Network {
        self.network
    }

    /// Sets how many bytes a band of features may take; what is computed does not depend on it.
    pub fn set_band_bytes(&mut self, bytes: usize) {
        self.band_bytes = bytes;
    }

    /// LPIPS of two pictures.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for pictures of different sizes or too small for the network; those of the device,
    /// [`crate::Error::Limit`] among them for pictures whose maps it cannot bind.
    pub fn distance(&self, reference: &Planes, test: &Planes, range: Range) -> Result<f64> {
        same_size(reference, test)?;
        check_size(self.network, reference)?;
        let upload = |planes: &Planes| {
            let values: Vec<f32> = input(planes, range).into_iter().map(|v| v as f32).collect();
            self.gpu.buffer_with("lpips input", bytemuck::cast_slice(&values))
        };
        let buffers = [upload(reference)?, upload(test)?];
        let mut maps = Maps { width: reference.width, height: reference.height, buffers };
        let (mut first_conv, mut total) = (0, 0.0);
        let slices = self.network.slices();
        for (index, slice) in slices.iter().enumerate() {
            let next = slices.get(index + 1).map(|s| s.pool);
            let stage = Stage { index, slice, first_conv, next };
            let (distance, after) = self.slice(stage, &maps)?;
            first_conv += slice.convs.len();
            total += distance;
            if let Some(after) = after {
                maps = after;
            }
        }
        Ok(total)
    }

    /// Mean distance of one slice's map, and the input of the next slice.
    fn slice(&self, stage: Stage, input: &Maps) -> Result<(f64, Option<Maps>)> {
        let sides = |side| stage.slice.convs.iter().fold(side, |side, conv| conv.output_side(side));
        let (width, height) = (sides(input.width), sides(input.height));
        let channels = stage.slice.convs.last().map_or(0, |c| c.outputs);
        let next = stage.next.map(|pool| self.next_maps(channels, [width, height], pool)).transpose()?;
        let rows = self.band_rows(stage, channels, width).unwrap_or(height).min(height);
        let distance = self.gpu.buffer("lpips distance", (4 * rows * width) as u64, Memory::Device)?;
        let (mut first, mut sum) = (0, 0.0);
        while first < height {
            let end = (first + rows).min(height);
            let mut bands = Vec::with_capacity(2);
            for (i, buffer) in input.buffers.iter().enumerate() {
                let whole = Band {
                    buffer: buffer.clone(),
                    width: input.width,
                    height: input.height,
                    first: 0,
                    end: input.height,
                };
                // Without a pool in between, the whole output is the next slice's input.
                let target = match (&next, stage.next) {
                    (Some(next), Some(None)) => Some(next.buffers[i].clone()),
                    _ => None,
                };
                bands.push(self.convolve(stage, whole, first..end, target)?);
            }
            let pixels = (end - first) * width;
            self.difference(stage.index, &bands, [channels, pixels], &distance)?;
            if let (Some(next), Some(Some(kernel))) = (&next, stage.next) {
                for (band, to) in bands.iter().zip(&next.buffers) {
                    self.pool(kernel, channels, band, [next.width, next.height], to)?;
                }
            }
            let bytes = self.gpu.download(distance.slice(0, 4 * pixels as u64))?;
            let value = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            sum += bytes.chunks_exact(4).map(value).sum::<f64>();
            first = end;
        }
        Ok((sum / (width * height) as f64, next))
    }

    /// Rows of a band; `None` where the slice cannot be cut: it or the next pool steps over several rows unevenly.
    fn band_rows(&self, stage: Stage, channels: usize, width: usize) -> Option<usize> {
        let even = stage.next.is_none_or(|pool| pool == Some(2));
        let cuts = even && stage.slice.convs.iter().all(|c| c.kernel == 3 && c.stride == 1);
        let rows = self.band_bytes / (4 * channels * width).max(1);
        cuts.then(|| (rows / 2 * 2).max(2))
    }

    fn next_maps(&self, channels: usize, [width, height]: [usize; 2], pool: Option<usize>) -> Result<Maps> {
        let side = |side| pool.map_or(side, |kernel| pooled_side(side, kernel));
        let (width, height) = (side(width), side(height));
        let buffer = || self.gpu.buffer("lpips map", (4 * channels * width * height) as u64, Memory::Device);
        Ok(Maps { width, height, buffers: [buffer()?, buffer()?] })
    }

    /// The slice's convolutions for `rows` of its output, which goes to `target` or a new buffer.
    fn convolve(
        &self,
        stage: Stage,
        input: Band,
        rows: std::ops::Range<usize>,
        target: Option<Buffer>,
    ) -> Result<Band> {
        let mut input = input;
        let count = stage.slice.convs.len();
        for (j, conv) in stage.slice.convs.iter().enumerate() {
            let (width, height) = (conv.output_side(input.width), conv.output_side(input.height));
            // Each convolution after this one reaches one row further.
            let reach = count - 1 - j;
            let (first, end) = (rows.start.saturating_sub(reach), (rows.end + reach).min(height));
            let buffer = match &target {
                Some(buffer) if j + 1 == count => buffer.clone(),
                _ => {
                    self.gpu.buffer("lpips band", (4 * conv.outputs * (end - first) * width) as u64, Memory::Device)?
                }
            };
            let output = Band { buffer, width, height, first, end };
            self.conv(conv, &self.convs[stage.first_conv + j], &input, &output)?;
            input = output;
        }
        Ok(input)
    }

    /// One submission per so many channels.
    fn conv(&self, conv: &Conv, parameter: &Buffer, input: &Band, output: &Band) -> Result<()> {
        let rows = output.end - output.first;
        let per_channel = (conv.depth() * rows * output.width).max(1);
        let step = (SUBMISSION_PRODUCTS / per_channel / CHANNEL_STEP).max(1) * CHANNEL_STEP;
        for first in (0..conv.outputs).step_by(step) {
            let push = LpipsConvPush {
                inputs: conv.inputs as u32,
                outputs: conv.outputs as u32,
                in_width: input.width as u32,
                in_height: input.height as u32,
                in_first_row: input.first as u32,
                in_rows: (input.end - input.first) as u32,
                out_width: output.width as u32,
                out_first_row: output.first as u32,
                out_rows: rows as u32,
                first_output: first as u32,
                output_count: step.min(conv.outputs - first) as u32,
            };
            let (stage, lanes) = (product::Stage::of(&self.gpu), self.gpu.subgroup_size_of(&LPIPS_CONV));
            let constants = LpipsConvConstants {
                stage: stage as u32,
                kernel: conv.kernel as u32,
                stride: conv.stride as u32,
                pad: conv.pad as u32,
                threads: stage.threads(lanes),
            };
            let pixels = push.out_rows * push.out_width;
            let groups = product_groups(stage, lanes, push.output_count, pixels, 1);
            let buffers = LpipsConvBuffers {
                feature_input: input.buffer.whole(),
                parameter: parameter.whole(),
                feature_output: output.buffer.whole(),
            };
            self.run(&LPIPS_CONV, constants, push, buffers, groups)?;
        }
        Ok(())
    }

    fn difference(
        &self,
        index: usize,
        bands: &[Band],
        [channels, pixels]: [usize; 2],
        distance: &Buffer,
    ) -> Result<()> {
        let [first, second] = bands else { return Ok(()) };
        let push = LpipsDifferencePush { channels: channels as u32, pixels: pixels as u32 };
        let buffers = LpipsDifferenceBuffers {
            first: first.buffer.whole(),
            second: second.buffer.whole(),
            head: self.heads[index].whole(),
            distance_of_pixel: distance.whole(),
        };
        let groups = (pixels as u64).div_ceil(THREADS.into());
        self.run(&LPIPS_DIFFERENCE, (), push, buffers, groups)
    }

    /// The rows of a pooled map that a band gives.
    fn pool(
        &self,
        kernel: usize,
        channels: usize,
        band: &Band,
        [width, height]: [usize; 2],
        to: &Buffer,
    ) -> Result<()> {
        let (first, end) = (band.first / 2, if band.end == band.height { height } else { band.end / 2 });
        let rows = end.saturating_sub(first);
        if rows == 0 {
            return Ok(());
        }
        let push = LpipsPoolPush {
            channels: channels as u32,
            in_width: band.width as u32,
            in_rows: (band.end - band.first) as u32,
            out_width: width as u32,
            out_height: height as u32,
            out_first_row: first as u32,
            out_rows: rows as u32,
        };
        let groups = ((channels * rows * width) as u64).div_ceil(THREADS.into());
        let buffers = LpipsPoolBuffers { feature_input: band.buffer.whole(), feature_output: to.whole() };
        self.run(&LPIPS_POOL, LpipsPoolConstants { kernel: kernel as u32 }, push, buffers, groups)
    }

    /// Submits one dispatch and waits for it.
    fn run<I: Interface>(
        &self,
        kernel: &'static KernelOf<I>,
        constants: I::Constants,
        push: I::Push,
        buffers: I::Buffers<Bytes>,
        groups: u64,
    ) -> Result<()> {
        let mut r = self.gpu.recorder(kernel.name);
        r.dispatch(kernel, constants, push, buffers, Groups::Direct(groups))?;
        self.gpu.run(r).map(drop)
    }
}
