//! A pass of density control: decide, select within the budget, find the new rows, move every array.

use super::density_decide::{DENSITY_DECIDE, DensityDecideBuffers, DensityDecidePush, TOTAL_WORDS};
use super::density_emit::{DENSITY_EMIT, DensityEmitBuffers, DensityEmitPush};
use super::density_histogram::{DENSITY_HISTOGRAM, DensityHistogramBuffers, DensityHistogramPush, HISTOGRAM_WORDS};
use super::density_scan::{DENSITY_SCAN, DensityScanBuffers, DensityScanPush};
use super::gather_rows::{GATHER_ROWS, GatherRowsBuffers, GatherRowsPush};
use super::split_children::{SPLIT_CHILDREN, SplitChildrenBuffers, SplitChildrenPush};
use super::{DENSITY_BLOCK, SOURCE_ROW, logit};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Gpu, Groups, Memory};
use crate::scene::parameter::{LOG_SCALE, MEAN, NewRows, OPACITY_LOGIT, ROTATION};

/// Limits of one pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityOptions {
    /// Mean screen-gradient norm from which a Gaussian grows (3DGS: 2e-4), in the unit of `density`; infinite for no growth.
    pub gradient_threshold: f32,
    /// Smallest opacity that stays (3DGS: 0.005), in (0, 1).
    pub min_opacity: f64,
    /// Share of `extent` up to which a Gaussian is cloned, above which it is split (3DGS: 0.01).
    pub percent_dense: f64,
    /// Scene extent, world units (1.1 times the largest distance of a camera from their mean).
    pub extent: f64,
    /// Share of `extent` above which a Gaussian's largest scale prunes it (3DGS: 0.1, once opacities have been reset); `None`:
    /// no limit.
    pub world_size: Option<f64>,
    /// Largest screen radius of a Gaussian that does not grow, px (`None`: no limit).
    pub max_screen_radius: Option<f32>,
    /// Growth never takes the count above this.
    pub max_gaussians: u32,
    /// Seed of the children's positions.
    pub seed: u64,
    /// Iteration: the stream of random numbers.
    pub iteration: u32,
}

impl Default for DensityOptions {
    fn default() -> Self {
        Self {
            gradient_threshold: 2e-4,
            min_opacity: 0.005,
            percent_dense: 0.01,
            extent: 1.0,
            world_size: None,
            max_screen_radius: None,
            max_gaussians: SOURCE_ROW,
            seed: 0,
            iteration: 0,
        }
    }
}

/// An array with a row per Gaussian: word plane·N·width + row·width + component.
#[derive(Debug, Clone)]
pub struct RowArray {
    /// Its content, 32-bit words.
    pub buffer: Buffer,
    /// Planes; with 0 the buffer is passed on as it is.
    pub planes: u32,
    /// Words per row and plane.
    pub width: u32,
    /// What new rows hold.
    pub new_rows: NewRows,
}

/// Everything with a row per Gaussian. A pass takes the buffers and gives new ones back; memory stays near one copy of them
/// if the caller keeps no other handles (recorded commands hold handles too).
#[derive(Debug, Clone)]
pub struct DensityBuffers {
    /// Those of [`PARAMETERS`](crate::scene::parameter::PARAMETERS), in that order.
    pub parameters: Vec<RowArray>,
    /// `float[2][N]`: sum of screen-gradient norms, number of views. New buffer of zeros afterwards.
    pub density: Buffer,
    /// `float[N]` largest screen radius, px. New buffer of zeros afterwards.
    pub max_radius: Buffer,
    /// Every other array, in any order, given back in the same order: moments, superpoints, association.
    pub rows: Vec<RowArray>,
}

/// Result of a pass.
#[derive(Debug, Clone)]
pub struct DensityOutcome {
    /// Number of Gaussians now; may be 0.
    pub new_count: u32,
    /// Copied.
    pub cloned: u32,
    /// Replaced by two children.
    pub split: u32,
    /// Removed (without parents of splits).
    pub pruned: u32,
    /// Would have grown, but for the budget.
    pub refused: u32,
    /// The arrays with `new_count` rows.
    pub buffers: DensityBuffers,
}

/// Density control on one device.
#[derive(Debug, Clone)]
pub struct Density {
    gpu: Gpu,
}

/// What `density_decide` leaves for the rest of the pass.
struct Decision {
    action: Buffer,
    row_block: Buffer,
    /// Pruned, kept, cloned, split, refused, zeros.
    totals: [u32; TOTAL_WORDS],
}

fn log_of(x: f64) -> f32 {
    x.ln() as f32
}

fn blocks(rows: u32) -> u32 {
    rows.div_ceil(DENSITY_BLOCK)
}

impl Density {
    /// Density control on this device.
    pub fn new(gpu: &Gpu) -> Self {
        Self { gpu: gpu.clone() }
    }

    /// One pass over `gaussians` rows; waits for the device. After an error the given buffers are lost.
    pub fn run(&self, buffers: DensityBuffers, gaussians: u32, options: &DensityOptions) -> Result<DensityOutcome> {
        if gaussians > SOURCE_ROW {
            let what = "Gaussians in density control".into();
            return Err(Error::Limit { what, need: gaussians.into(), have: SOURCE_ROW.into() });
        }
        if gaussians == 0 {
            return Ok(DensityOutcome { new_count: 0, cloned: 0, split: 0, pruned: 0, refused: 0, buffers });
        }
        let mut push = decide_push(options, gaussians);
        let mut decision = self.decide(&buffers, &push)?;
        let [_, kept, cloned, split, ..] = decision.totals;
        let room = options.max_gaussians.saturating_sub(kept + cloned + split);
        if cloned + split > room {
            let [key, index] = self.select(&buffers, &decision, gaussians, room)?;
            (push.accept_key, push.accept_index) = (key, index);
            decision = self.decide(&buffers, &push)?;
        }
        let [pruned, kept, cloned, split, refused, ..] = decision.totals;
        let new_count = kept + 2 * (cloned + split);
        let source = self.source(&decision, gaussians, new_count)?;
        drop(decision);
        let buffers = self.move_rows(buffers, &source, gaussians, new_count, options)?;
        Ok(DensityOutcome { new_count, cloned, split, pruned, refused, buffers })
    }

    fn decide(&self, buffers: &DensityBuffers, push: &DensityDecidePush) -> Result<Decision> {
        let n = u64::from(push.gaussians);
        let action = self.gpu.buffer("action", 4 * n, Memory::Device)?;
        let row_block = self.gpu.buffer("row_block", 4 * u64::from(blocks(push.gaussians)), Memory::Device)?;
        let totals = self.gpu.buffer("totals", 4 * TOTAL_WORDS as u64, Memory::Device)?;
        let mut r = self.gpu.recorder("density decide");
        r.fill(&totals, 0)?;
        let bound = DensityDecideBuffers {
            log_scale: buffers.parameters[LOG_SCALE].buffer.whole(),
            opacity_logit: buffers.parameters[OPACITY_LOGIT].buffer.whole(),
            density: buffers.density.whole(),
            max_radius: buffers.max_radius.whole(),
            action: action.whole(),
            row_block: row_block.whole(),
            totals: totals.whole(),
        };
        let groups = Groups::Direct(blocks(push.gaussians).into());
        r.dispatch(&DENSITY_DECIDE, (), *push, bound, groups)?;
        self.gpu.run(r)?;
        let words = self.words(&totals, TOTAL_WORDS)?;
        Ok(Decision { action, row_block, totals: std::array::from_fn(|i| words[i]) })
    }

    fn words(&self, buffer: &Buffer, count: usize) -> Result<Vec<u32>> {
        let bytes = self.gpu.download(buffer.slice(0, 4 * count as u64))?;
        Ok(bytemuck::pod_collect_to_vec(&bytes))
    }

    /// The key and index up to which exactly `room` of the growing Gaussians are accepted.
    fn select(&self, buffers: &DensityBuffers, decision: &Decision, n: u32, room: u32) -> Result<[u32; 2]> {
        if room == 0 {
            // Above every finite gradient's bits.
            return Ok([u32::MAX, 0]);
        }
        let (key, before, equal) = self.select_key(buffers, decision, n, room, None)?;
        if room - before == equal {
            return Ok([key, u32::MAX]);
        }
        let (inverted, ..) = self.select_key(buffers, decision, n, room - before, Some(key))?;
        Ok([key, !inverted])
    }

    /// The `rank`-th largest key, how many are larger, and how many equal it; with `tie`, of the inverted indices among the
    /// Gaussians whose gradient has these bits.
    fn select_key(
        &self,
        buffers: &DensityBuffers,
        decision: &Decision,
        gaussians: u32,
        rank: u32,
        tie: Option<u32>,
    ) -> Result<(u32, u32, u32)> {
        let histogram = self.gpu.buffer("histogram", 4 * u64::from(HISTOGRAM_WORDS), Memory::Device)?;
        let (mut key, mut mask, mut before, mut equal) = (0_u32, 0_u32, 0, 0);
        for (shift, digit_mask) in [(21, 0x7ff_u32), (10, 0x7ff), (0, 0x3ff)] {
            let push = DensityHistogramPush {
                gaussians,
                by_index: u32::from(tie.is_some()),
                tie_key: tie.unwrap_or(0),
                prefix_mask: mask,
                prefix: key,
                shift,
            };
            let mut r = self.gpu.recorder("density histogram");
            r.fill(&histogram, 0)?;
            let bound = DensityHistogramBuffers {
                density: buffers.density.whole(),
                action: decision.action.whole(),
                histogram: histogram.whole(),
            };
            let groups = Groups::Direct(blocks(gaussians).into());
            r.dispatch(&DENSITY_HISTOGRAM, (), push, bound, groups)?;
            self.gpu.run(r)?;
            let counts = self.digit_counts(&histogram, digit_mask)?;
            let mut digit = digit_mask;
            while digit > 0 && before + counts[digit as usize] < rank {
                before += counts[digit as usize];
                digit -= 1;
            }
            equal = counts[digit as usize];
            key |= digit << shift;
            mask |= digit_mask << shift;
        }
        Ok((key, before, equal))
    }

    /// Counts of the digit's values; the kernel always takes 11 bits, so a narrower digit's counts are folded.
    fn digit_counts(&self, histogram: &Buffer, digit_mask: u32) -> Result<Vec<u32>> {
        let words = self.words(histogram, HISTOGRAM_WORDS as usize)?;
        let mut counts = vec![0; digit_mask as usize + 1];
        for (i, count) in words.into_iter().enumerate() {
            counts[i & digit_mask as usize] += count;
        }
        Ok(counts)
    }

    fn source(&self, decision: &Decision, gaussians: u32, rows: u32) -> Result<Buffer> {
        let source = self.gpu.buffer("source", 4 * u64::from(rows), Memory::Device)?;
        let blocks = blocks(gaussians);
        let mut r = self.gpu.recorder("density source");
        let row_block = decision.row_block.whole();
        let bound = DensityScanBuffers { row_block: row_block.clone() };
        r.dispatch(&DENSITY_SCAN, (), DensityScanPush { blocks }, bound, Groups::Direct(1))?;
        let push = DensityEmitPush { gaussians, rows };
        let bound = DensityEmitBuffers { action: decision.action.whole(), row_block, source: source.whole() };
        r.dispatch(&DENSITY_EMIT, (), push, bound, Groups::Direct(blocks.into()))?;
        self.gpu.run(r)?;
        Ok(source)
    }

    /// Moves one array and lets the old one go.
    fn gather(&self, old: RowArray, source: &Buffer, old_count: u32, new_count: u32) -> Result<RowArray> {
        if old.planes == 0 {
            return Ok(old);
        }
        let words = u64::from(new_count) * u64::from(old.width) * u64::from(old.planes);
        let old_words = u64::from(old_count) * u64::from(old.width) * u64::from(old.planes);
        if 4 * old_words > old.buffer.bytes() || words.max(old_words) > u64::from(u32::MAX) {
            let have = u128::from(old.buffer.bytes() / 4).min(u32::MAX.into());
            let what = format!("words of `{}` in density control", old.buffer.name());
            return Err(Error::Limit { what, need: words.max(old_words).into(), have });
        }
        let buffer = self.gpu.buffer(old.buffer.name(), 4 * words, Memory::Device)?;
        if new_count > 0 {
            let zero_new = u32::from(old.new_rows == NewRows::Zero);
            let push = GatherRowsPush { old_count, new_count, planes: old.planes, width: old.width, zero_new };
            let mut r = self.gpu.recorder("density gather");
            let bound =
                GatherRowsBuffers { source: source.whole(), old_rows: old.buffer.whole(), new_rows: buffer.whole() };
            let groups = Groups::Direct((u64::from(new_count) * u64::from(old.width)).div_ceil(256));
            r.dispatch(&GATHER_ROWS, (), push, bound, groups)?;
            self.gpu.run(r)?;
        }
        Ok(RowArray { buffer, ..old })
    }

    fn zeros(&self, name: &str, words: u64) -> Result<Buffer> {
        let buffer = self.gpu.buffer(name, 4 * words, Memory::Device)?;
        let mut r = self.gpu.recorder("density zeros");
        r.fill(&buffer, 0)?;
        self.gpu.run(r)?;
        Ok(buffer)
    }

    fn move_rows(
        &self,
        buffers: DensityBuffers,
        source: &Buffer,
        old_count: u32,
        new_count: u32,
        options: &DensityOptions,
    ) -> Result<DensityBuffers> {
        let DensityBuffers { parameters, density, max_radius, rows } = buffers;
        let names = [density.name().to_owned(), max_radius.name().to_owned()];
        drop((density, max_radius));
        let gather = |old| self.gather(old, source, old_count, new_count);
        let parameters = parameters.into_iter().map(gather).collect::<Result<Vec<_>>>()?;
        if new_count > 0 {
            let push = SplitChildrenPush {
                rows: new_count,
                seed_low: options.seed as u32,
                seed_high: (options.seed >> 32) as u32,
                iteration: options.iteration,
            };
            let mut r = self.gpu.recorder("density children");
            let bound = SplitChildrenBuffers {
                source: source.whole(),
                rotation: parameters[ROTATION].buffer.whole(),
                mean: parameters[MEAN].buffer.whole(),
                log_scale: parameters[LOG_SCALE].buffer.whole(),
            };
            let groups = Groups::Direct(blocks(new_count).into());
            r.dispatch(&SPLIT_CHILDREN, (), push, bound, groups)?;
            self.gpu.run(r)?;
        }
        let rows = rows.into_iter().map(gather).collect::<Result<Vec<_>>>()?;
        let density = self.zeros(&names[0], 2 * u64::from(new_count))?;
        let max_radius = self.zeros(&names[1], new_count.into())?;
        Ok(DensityBuffers { parameters, density, max_radius, rows })
    }
}

fn decide_push(options: &DensityOptions, gaussians: u32) -> DensityDecidePush {
    DensityDecidePush {
        gaussians,
        gradient_threshold: options.gradient_threshold,
        min_opacity_logit: logit(options.min_opacity),
        dense_log_scale: log_of(options.percent_dense * options.extent),
        world_log_scale: options.world_size.map_or(f32::INFINITY, |share| log_of(share * options.extent)),
        max_screen_radius: options.max_screen_radius.unwrap_or(f32::INFINITY),
        accept_key: 0,
        accept_index: u32::MAX,
    }
}
