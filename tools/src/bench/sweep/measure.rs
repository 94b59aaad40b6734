//! Time and error of one setting.

use std::collections::BTreeMap;
use std::time::Instant;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::gpu::kernel::{Kernel, Workload};
use engine::image::{Image, difference};
use engine::metrics::{Planes, flip};
use engine::render::{RenderOptions, Renderer};
use engine::scene::{Camera, MotionSource, Scene};

use super::measured::{ErrorOf, Measured, VISIBLE, VISIBLE_SHARE};
use super::settings::Setting;
use super::views::Views;
use crate::cli::args::SweepArgs;
use crate::report::measure::{Quantiles, raise_clocks, with_push};
use crate::report::processor::processor_seconds;

/// Timed frames of a setting where the arguments do not say, on a GPU and on a CPU.
const FRAMES: [u32; 2] = [60, 9];
/// Frames before.
const WARMUP: u32 = 3;

/// What all settings have in common.
pub(super) struct Measurer<'a> {
    gpu: &'a Gpu,
    scene: &'a Scene,
    background: [f32; 3],
    motion: MotionSource,
    frames: u32,
    warmup: u32,
    /// Draws exact frames beside those of a setting; only for a device that is a CPU.
    pace: Option<Renderer>,
    /// Processor time of the first exact frames, median, ms.
    pace_ms: Option<f64>,
    pub(super) views: &'a Views,
    pub(super) truth: &'a [Image],
    planes: Vec<Planes>,
}

impl<'a> Measurer<'a> {
    pub(super) fn new(
        gpu: &'a Gpu,
        scene: &'a Scene,
        args: &SweepArgs,
        views: &'a Views,
        truth: &'a [Image],
    ) -> Result<Self> {
        let mut measurer = Self {
            gpu,
            scene,
            background: args.look.background,
            motion: args.look.motion_source(),
            frames: args.frames.unwrap_or(FRAMES[usize::from(gpu.info().is_cpu())]),
            warmup: args.warmup.unwrap_or(WARMUP),
            pace: None,
            pace_ms: None,
            views,
            truth,
            planes: truth.iter().map(Planes::clamped).collect::<Result<_>>()?,
        };
        if gpu.info().is_cpu() {
            let mut pace = measurer.renderer(&Setting::exact(), true)?;
            for i in 0..measurer.warmup as usize {
                let (camera, time) = views.timed(i);
                pace.draw(&camera, time)?;
            }
            measurer.pace = Some(pace);
        }
        Ok(measurer)
    }

    /// Processor time of an exact frame, ms, where the device is a CPU.
    fn exact_frame(&mut self, camera: &Camera, time: f64) -> Result<Option<f64>> {
        let Some(pace) = &mut self.pace else { return Ok(None) };
        let before = processor_seconds();
        pace.draw(camera, time)?;
        Ok(processor_seconds().zip(before).map(|(after, before)| (after - before) * 1e3))
    }

    fn renderer(&self, setting: &Setting, profile: bool) -> Result<Renderer> {
        let options = RenderOptions {
            background: self.background,
            motion: setting.motion(self.motion),
            quality: setting.quality,
            profile,
            ..RenderOptions::default()
        };
        Renderer::new(self.gpu, self.scene, &options)
    }

    /// The image of a view.
    pub(super) fn image(&self, setting: &Setting, view: usize) -> Result<Image> {
        let (camera, time) = &self.views.cameras[view];
        self.renderer(setting, false)?.render(camera, *time)
    }

    /// Times frames and compares images.
    pub(super) fn measure(&mut self, setting: Setting) -> Result<Measured> {
        let mut renderer = self.renderer(&setting, true)?;
        let images: Vec<Image> =
            self.views.cameras.iter().map(|(c, t)| renderer.render(c, *t)).collect::<Result<_>>()?;
        let error = self.error(&images)?;
        let photo_psnr = self.views.photos.as_ref().map(|photos| {
            let psnr = photos.iter().zip(&images).map(|(p, i)| difference(p.rgb(), i.rgb()).psnr);
            psnr.sum::<f64>() / photos.len() as f64
        });
        for i in 0..self.warmup as usize {
            let (camera, time) = self.views.timed(i);
            renderer.draw(&camera, time)?;
        }
        let (camera, time) = self.views.timed(0);
        raise_clocks(self.gpu, || renderer.draw(&camera, time).map(|_| ()))?;
        let (mut frame_ms, mut ratios, mut exact_ms) = (Vec::new(), Vec::new(), Vec::new());
        let mut stages: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
        let mut counted = Default::default();
        for i in 0..self.frames as usize {
            let (camera, time) = self.views.timed(i);
            let exact = self.exact_frame(&camera, time)?;
            let before = processor_seconds();
            let start = Instant::now();
            let (frame, statistics) = renderer.draw(&camera, time)?;
            frame_ms.push(start.elapsed().as_secs_f64() * 1e3);
            if let (Some(exact), Some(before), Some(after)) = (exact, before, processor_seconds()) {
                ratios.push((after - before) * 1e3 / exact.max(1e-3));
                exact_ms.push(exact);
            }
            let mut of_frame: BTreeMap<&'static str, f64> = BTreeMap::new();
            for timing in renderer.timings(frame)? {
                *of_frame.entry(stage(&timing.label)).or_default() += timing.us / 1e3;
            }
            of_frame.into_iter().for_each(|(name, ms)| stages.entry(name).or_default().push(ms));
            counted = statistics;
        }
        if self.pace_ms.is_none() && !exact_ms.is_empty() {
            self.pace_ms = Some(Quantiles::of(exact_ms).median);
        }
        let ratio = (!ratios.is_empty()).then(|| Quantiles::of(ratios).median);
        let workload = renderer.workload(&counted);
        let commands = renderer.commands();
        let dispatches = commands.map(|c| c.kernels().into_iter().zip(c.push_constants())).into_iter().flatten();
        let bytes = dispatches.map(|((_, kernel), push)| bytes_of(kernel, &workload, push)).sum();
        Ok(Measured {
            setting,
            frame_ms: Quantiles::of(frame_ms),
            processor_ms: ratio.zip(self.pace_ms).map(|(ratio, exact)| ratio * exact),
            stage_ms: stages.into_iter().map(|(name, ms)| (name, Quantiles::of(ms).median)).collect(),
            bytes,
            scene_bytes: renderer.memory().scene,
            dispatches: commands.map_or(0, engine::gpu::Commands::dispatches),
            instances: counted.instances,
            error,
            photo_psnr,
            pareto: false,
        })
    }

    fn error(&self, images: &[Image]) -> Result<ErrorOf> {
        let reference = || self.truth.iter().flat_map(Image::rgb);
        let test = || images.iter().flat_map(Image::rgb);
        let d = difference(reference(), test());
        let (mut squares, mut seen, mut count) = (0.0, 0_u64, 0_u64);
        for (a, b) in reference().zip(test()) {
            squares += (a - b).powi(2);
            // As a picture shows them.
            seen += u64::from((a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).abs() > VISIBLE);
            count += 1;
        }
        let mut flip_sum = 0.0;
        for (truth, image) in self.planes.iter().zip(images) {
            flip_sum += flip::mean_flip(truth, &Planes::clamped(image)?, None)?;
        }
        let visible = seen as f64 / count.max(1) as f64;
        Ok(ErrorOf {
            psnr: d.psnr,
            rmse: (squares / count.max(1) as f64).sqrt(),
            max: d.max,
            q999: d.q999,
            visible,
            invisible: visible <= VISIBLE_SHARE,
            flip: flip_sum / images.len().max(1) as f64,
        })
    }
}

fn bytes_of(kernel: &Kernel, workload: &Workload, push: &[u8]) -> u64 {
    (kernel.bytes)(&with_push(workload, kernel, push))
}

/// Stages in the order of the pipeline.
pub(super) const STAGES: [&str; 6] = ["networks", "project", "tiles", "sort", "blend", "other"];

/// The stage of an operation.
fn stage(label: &str) -> &'static str {
    match label {
        l if l.contains("network") || l.starts_with("field") || l.starts_with("linear") => STAGES[0],
        l if l.starts_with("deform_project") => STAGES[1],
        l if l.starts_with("scan_tiles") || l.starts_with("emit_tiles") => STAGES[2],
        l if l.starts_with("sort_tiles") => STAGES[3],
        l if l.starts_with("blend") => STAGES[4],
        _ => STAGES[5],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_operation_of_a_frame_has_its_stage() {
        for (label, expected) in [
            ("deform_network", "networks"),
            ("nonrigid_network 0", "networks"),
            ("field_waves", "networks"),
            ("linear_forward", "networks"),
            ("deform_project", "project"),
            ("scan_tiles", "tiles"),
            ("emit_tiles", "tiles"),
            ("sort_tiles", "sort"),
            ("sort_tiles long", "sort"),
            ("blend", "blend"),
            ("fill zeroed", "other"),
        ] {
            assert_eq!(stage(label), expected, "{label}");
        }
    }
}
