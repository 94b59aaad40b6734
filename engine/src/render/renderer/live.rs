//! What an interactive program asks of a renderer: options that change between frames, the frame's buffers for a kernel that
//! goes on with them, and what lies under a pixel.

use super::{FrameId, Renderer, Targets};
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Slice};
use crate::render::blend::{MAX_ALPHA, MIN_TRANSMITTANCE};
use crate::render::ellipse::log2_cut;
use crate::render::limits::{INSTANCE_GAUSSIAN, TILE_SIZE};
use crate::render::sh_storage;
use crate::render::splat::{Splat, splat_words, unpack_splat};
use crate::scene::parameter;

/// SH basis of degree 0.
const SH_0: f32 = 0.282_094_8;

/// The Gaussian that contributes most to a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Picked {
    /// Index in the scene.
    pub gaussian: u32,
    /// Its weight α T in the pixel, 0 to 1.
    pub weight: f32,
    /// Its depth along the camera's axis, world units.
    pub depth: f32,
    /// Gaussians that the pixel blends.
    pub blended: u32,
}

/// What a frame leaves for windows.
pub(crate) struct Output {
    pub(crate) color: Slice,
    /// Of a frame with depth.
    pub(crate) depth: Option<Slice>,
    pub(crate) ranges: Slice,
    pub(crate) counters: Slice,
}

impl Renderer {
    /// Colour behind everything, from the next frame on.
    pub fn set_background(&mut self, background: [f32; 3]) {
        self.options.background = background;
    }

    /// Whether the depth is rendered too, from the next frame on.
    pub fn set_depth(&mut self, depth: bool) {
        if self.options.depth != depth {
            self.options.depth = depth;
            self.targets = None;
        }
    }

    /// Share of the asked-for width and height that is rendered, from the next frame on. Buffers stay as large as the largest share
    /// needed, so that a change allocates nothing.
    pub fn set_resolution(&mut self, resolution: f32) {
        self.options.quality.resolution = resolution.clamp(0.05, 1.0);
    }

    /// What is drawn and how.
    pub fn options(&self) -> &super::RenderOptions {
        &self.options
    }

    /// Replaces the colours of SH band 0: `[N]` red, green, blue. What higher bands add stays.
    ///
    /// # Errors
    /// `Usage` when the number is not that of the Gaussians.
    pub fn set_base_colors(&self, colors: &[[f32; 3]]) -> Result<()> {
        self.check_count("base colours", colors.len())?;
        let planes: Vec<f32> = (0..3).flat_map(|c| colors.iter().map(move |v| (v[c] - 0.5) / SH_0)).collect();
        let words = sh_storage::encode(self.scene.sh_storage, 0, &planes, colors.len());
        self.gpu.upload(&self.scene.parameter[parameter::SH_0], bytemuck::cast_slice(&words))
    }

    /// Replaces the opacities, without lifespans: `[N]` before the sigmoid.
    ///
    /// # Errors
    /// `Usage` when the number is not that of the Gaussians.
    pub fn set_opacities(&self, logits: &[f32]) -> Result<()> {
        self.check_count("opacities", logits.len())?;
        self.gpu.upload(&self.scene.parameter[parameter::OPACITY_LOGIT], bytemuck::cast_slice(logits))
    }

    fn check_count(&self, what: &str, found: usize) -> Result<()> {
        let expected = self.scene.gaussians;
        if found == expected as usize {
            Ok(())
        } else {
            Err(Error::usage(what, found.to_string(), expected.to_string()))
        }
    }

    /// Size of the images that are rendered; smaller than asked for by the resolution.
    pub fn rendered_size(&self) -> [u32; 2] {
        self.targets.as_ref().map_or([0, 0], |t| t.size)
    }

    /// Changes whenever the buffers of [`Renderer::outputs`] are others; no two renderers have the same.
    pub(crate) fn generation(&self) -> u64 {
        self.generation
    }

    /// Which of [`Renderer::outputs`] a frame uses.
    pub(crate) fn slot_index(&self, frame: FrameId) -> Result<usize> {
        self.slot(frame)?;
        let slots = self.targets.iter().flat_map(Targets::slots);
        Ok(slots.into_iter().position(|s| s.frame == frame.0).unwrap_or(0))
    }

    /// What each frame in flight leaves, but for those side by side.
    pub(crate) fn outputs(&self) -> impl Iterator<Item = Output> {
        let targets = self.targets.iter();
        targets.flat_map(|t| {
            let work = &t.work[0];
            t.batches[0].iter().flat_map(|batch| &batch.slots).map(move |s| Output {
                color: s.buffers.color.whole(),
                depth: s.buffers.depth.as_ref().map(Buffer::whole),
                ranges: work.ranges.whole(),
                counters: work.counted.whole(),
            })
        })
    }

    /// The Gaussian that contributes most to pixel `x`, `y` of the latest frame (rendered pixels); `None` where nothing
    /// was drawn. Blocks.
    pub fn pick(&self, [x, y]: [u32; 2]) -> Result<Option<Picked>> {
        let Some(targets) = self.targets.as_ref().filter(|t| x < t.size[0] && y < t.size[1]) else {
            return Ok(None);
        };
        let tile = u64::from(y / TILE_SIZE * targets.size[0].div_ceil(TILE_SIZE) + x / TILE_SIZE);
        let work = &targets.work[targets.latest];
        let ranges = &work.ranges;
        let words = |slice: Slice| -> Result<Vec<u32>> { Ok(bytemuck::pod_collect_to_vec(&self.gpu.download(slice)?)) };
        let range = words(ranges.slice(tile * 8, 8))?;
        let (first, count) = (u64::from(range[0]), u64::from(range[1].saturating_sub(range[0])));
        if count == 0 {
            return Ok(None);
        }
        let values = words(work.values.slice(first * 4, count * 4))?;
        let splats = words(Slice::from(&work.splats))?;
        let quality = &self.options.quality;
        let packing = quality.packing_constant();
        let known = splats.len() / splat_words(packing);
        let of_tile = values.into_iter().map(|v| v & INSTANCE_GAUSSIAN).filter(|g| (*g as usize) < known);
        let splats = of_tile.map(|g| (g, unpack_splat(packing, &splats, g as usize)));
        Ok(heaviest(splats, [x as f32 + 0.5, y as f32 + 0.5], log2_cut(quality.alpha_cut_constant())))
    }
}

/// Blends front to back as the kernel does and keeps the largest contribution.
fn heaviest(splats: impl Iterator<Item = (u32, Splat)>, [x, y]: [f32; 2], log2_cut: f32) -> Option<Picked> {
    let mut transmittance = 1.0_f32;
    let mut best: Option<Picked> = None;
    let mut blended = 0;
    for (gaussian, [first, second, _]) in splats {
        let (dx, dy) = (x - first[0], y - first[1]);
        let (u, v) = (first[2] * dx + first[3] * dy, second[0] * dy);
        let log2_alpha = second[1] - u * u - v * v;
        if log2_alpha.is_nan() || log2_alpha < -log2_cut {
            continue;
        }
        let weight = log2_alpha.exp2().min(MAX_ALPHA) * transmittance;
        if transmittance - weight < MIN_TRANSMITTANCE {
            break;
        }
        transmittance -= weight;
        blended += 1;
        if best.is_none_or(|b| weight > b.weight) {
            best = Some(Picked { gaussian, weight, depth: second[2], blended: 0 });
        }
    }
    best.map(|b| Picked { blended, ..b })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn splat(x: f32, log2_opacity: f32, z: f32) -> Splat {
        [[x, 8.5, 0.5, 0.0], [0.5, log2_opacity, z, 0.0], [0.0; 4]]
    }

    #[test]
    fn the_heaviest_contribution_wins_not_the_nearest() {
        let faint_then_solid = [(7, splat(8.5, -4.0, 1.0)), (3, splat(8.5, -0.2, 2.0)), (9, splat(8.5, -0.1, 3.0))];
        let picked = heaviest(faint_then_solid.into_iter(), [8.5, 8.5], 8.0).unwrap();
        assert_eq!((picked.gaussian, picked.depth, picked.blended), (3, 2.0, 3));
        assert!((picked.weight - 0.8706 * (1.0 - 0.0625)).abs() < 1e-3, "{}", picked.weight);
        let far = [(1, splat(80.0, 0.0, 1.0))];
        assert_eq!(heaviest(far.into_iter(), [8.5, 8.5], 8.0), None);
    }
}
