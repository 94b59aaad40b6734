//! Renders the views and scores them.

use engine::data::{DatasetKind, ImageLoader, View};
use engine::error::Result;
use engine::gpu::Gpu;
use engine::image::Image;
use engine::metrics::flicker::{Flicker, FlickerMeter, STATIC_CHANGE};
use engine::metrics::lpips::{Lpips, Range, WeightsFile};
use engine::metrics::{self, Planes, Weights, mean_of};
use engine::render::Renderer;
use engine::scene::Scene;
use serde::Serialize;

use super::exposure;
use super::setting::Setting;
use crate::report::scores::{AllScores, Scorer};

/// Decoded photos that are kept, bytes.
pub(super) const PHOTO_BYTES: u64 = 1 << 30;

/// Scores of float images: those metrics that rounding changes in a way worth telling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct FloatScores {
    psnr: f64,
    ssim: f64,
    ssim_valid: Option<f64>,
    ms_ssim: Option<f64>,
}

impl FloatScores {
    fn of(truth: &Planes, rendered: &Planes) -> Result<Self> {
        let (similarity, ms_ssim) = metrics::ssim_and_ms_ssim(truth, rendered)?;
        Ok(Self {
            psnr: metrics::psnr(truth, rendered, None)?,
            ssim: similarity.zero_padded,
            ssim_valid: similarity.valid,
            ms_ssim,
        })
    }

    pub(super) fn mean(all: &[Self]) -> Option<Self> {
        Some(Self {
            psnr: mean_of(all.iter().map(|s| Some(s.psnr)))?,
            ssim: mean_of(all.iter().map(|s| Some(s.ssim)))?,
            ssim_valid: mean_of(all.iter().map(|s| s.ssim_valid)),
            ms_ssim: mean_of(all.iter().map(|s| s.ms_ssim)),
        })
    }

    /// Text cells in the order of [`AllScores::rows`]; `None` where a metric is not taken of floats.
    pub(super) fn cells(&self) -> [Option<f64>; 4] {
        [Some(self.psnr), Some(self.ssim), self.ssim_valid, self.ms_ssim]
    }
}

/// Scores of one view.
#[derive(Debug, Clone, Serialize)]
pub(super) struct ViewResult {
    pub(super) index: usize,
    pub(super) name: String,
    pub(super) time: f64,
    pub(super) width: usize,
    pub(super) height: usize,
    /// On 8-bit values.
    #[serde(flatten)]
    pub(super) scores: AllScores,
    /// On floats.
    pub(super) float: FloatScores,
    /// On 8-bit values, under the mask.
    pub(super) masked: Option<AllScores>,
    /// LPIPS of the protocol's network, fed as the paper's code does.
    pub(super) lpips_paper: Option<f64>,
    /// From submission to the image in host memory.
    pub(super) render_ms: f64,
}

/// What renders and scores.
pub(super) struct Session<'a> {
    setting: &'a Setting,
    renderer: Renderer,
    loader: ImageLoader,
    scorer: Scorer,
    paper_lpips: Option<Lpips>,
}

/// A rendering and its truth.
struct Pair {
    rendered: Image,
    truth: Image,
    render_ms: f64,
}

impl<'a> Session<'a> {
    pub(super) fn new(gpu: &Gpu, scene: &Scene, setting: &'a Setting, weights: &WeightsFile) -> Result<Self> {
        let network = setting.protocol.as_ref().and_then(|p| p.lpips);
        let paper_lpips = network.and_then(|n| weights.get(n)).map(|w| Lpips::new(gpu, w)).transpose()?;
        Ok(Self {
            setting,
            renderer: Renderer::new(gpu, scene, &setting.options)?,
            loader: ImageLoader::new(setting.views.clone().into(), PHOTO_BYTES, workers())?,
            scorer: Scorer::new(Some(gpu), weights)?,
            paper_lpips,
        })
    }

    /// Scores all views, in their order; `each` gets index, rendering and truth as 8-bit values.
    pub(super) fn score_all(
        &mut self,
        mut each: impl FnMut(usize, &Planes, &Planes) -> Result<()>,
    ) -> Result<(Vec<ViewResult>, Option<Flicker>)> {
        let order = by_camera_and_time(&self.setting.views);
        self.loader.prefetch(&order);
        let mut results = Vec::with_capacity(order.len());
        let mut meter = FlickerMeter::new(STATIC_CHANGE);
        let mut before: Option<(usize, Planes, Planes)> = None;
        for index in order {
            let pair = self.pair(index)?;
            let (truth, rendered) = (Planes::quantised(&pair.truth)?, Planes::quantised(&pair.rendered)?);
            results.push(self.result(index, &pair, &truth, &rendered)?);
            each(index, &rendered, &truth)?;
            if let Some((other, old_truth, old_rendered)) = &before
                && same_camera(&self.setting.views[*other], &self.setting.views[index])
            {
                meter.pair([old_truth, &truth], [old_rendered, &rendered])?;
            }
            before = Some((index, truth, rendered));
        }
        results.sort_by_key(|r| r.index);
        Ok((results, meter.result()))
    }

    /// Rendering and truth of a view as 8-bit values.
    pub(super) fn quantised(&mut self, index: usize) -> Result<[Planes; 2]> {
        let pair = self.pair(index)?;
        Ok([Planes::quantised(&pair.rendered)?, Planes::quantised(&pair.truth)?])
    }

    fn pair(&mut self, index: usize) -> Result<Pair> {
        let view = &self.setting.views[index];
        let begin = std::time::Instant::now();
        let mut rendered = self.renderer.render(&view.camera, view.time)?;
        let render_ms = begin.elapsed().as_secs_f64() * 1e3;
        let truth = self.loader.get(index)?.over(self.setting.background);
        if self.setting.fit_exposure {
            exposure::fit(&mut rendered, &truth);
        }
        Ok(Pair { rendered, truth, render_ms })
    }

    fn result(&self, index: usize, pair: &Pair, truth: &Planes, rendered: &Planes) -> Result<ViewResult> {
        let view = &self.setting.views[index];
        let (scores, _) = self.scorer.score(truth, rendered)?;
        let mask = if self.setting.masks { self.mask(view, truth)? } else { None };
        let fits = |l: &&Lpips| truth.width.min(truth.height) >= l.network().smallest_side();
        let paper = self.paper_lpips.as_ref().filter(fits).map(|l| l.distance(truth, rendered, Range::ZeroToOne));
        Ok(ViewResult {
            index,
            name: view.name.clone(),
            time: view.time,
            width: truth.width,
            height: truth.height,
            scores,
            float: FloatScores::of(&Planes::clamped(&pair.truth)?, &Planes::clamped(&pair.rendered)?)?,
            masked: mask.map(|m| Scorer::masked(truth, rendered, &m)).transpose()?,
            lpips_paper: paper.transpose()?,
            render_ms: pair.render_ms,
        })
    }

    /// What moves: 0 in NeRF-DS, everything but 0 elsewhere (object numbers among them). `None` without a mask, or where
    /// nothing moves.
    fn mask(&self, view: &View, truth: &Planes) -> Result<Option<Weights>> {
        let Some(mask) = view.image.decode_mask()? else { return Ok(None) };
        let counts = |m: u8| match self.setting.kind {
            DatasetKind::NerfDs => 255 - m,
            _ => u8::from(m != 0) * 255,
        };
        let mask: Vec<u8> = mask.into_iter().map(counts).collect();
        if mask.iter().all(|m| *m == 0) {
            return Ok(None);
        }
        Weights::from_mask(&mask, [truth.width, truth.height]).map(Some)
    }
}

/// Threads that decode photos.
pub(super) fn workers() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from).min(4)
}

/// Views of one camera side by side, in order of time.
fn by_camera_and_time(views: &[View]) -> Vec<usize> {
    let key = |i: usize| -> Vec<f64> {
        let c = &views[i].camera;
        c.position.to_array().into_iter().chain(c.rotation.to_cols_array()).chain([views[i].time]).collect()
    };
    let mut order: Vec<usize> = (0..views.len()).collect();
    let compare = |a: &Vec<f64>, b: &Vec<f64>| {
        a.iter().zip(b).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne()).unwrap_or(std::cmp::Ordering::Equal)
    };
    order.sort_by(|&a, &b| compare(&key(a), &key(b)));
    order
}

/// The same pose, intrinsics and size, at another time.
fn same_camera(a: &View, b: &View) -> bool {
    let mut other = b.camera.clone();
    (other.time, other.name) = (a.camera.time, a.camera.name.clone());
    a.camera == other && a.time < b.time
}
