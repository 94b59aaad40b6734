//! All metrics of a pair of pictures, LPIPS among them, as the commands print them.

use std::path::PathBuf;

use engine::error::Result;
use engine::gpu::Gpu;
use engine::metrics::lpips::{Lpips, Network, Range, WeightsFile};
use engine::metrics::{self, FlipMap, Planes, Scores, Weights, mean_of};
use serde::Serialize;

/// Scores of one picture, or their means. What is absent is `null`, never a number.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct AllScores {
    /// PSNR, SSIM, MS-SSIM, FLIP.
    #[serde(flatten)]
    pub pixel: Scores,
    /// LPIPS with AlexNet.
    pub lpips_alex: Option<f64>,
    /// LPIPS with VGG-16.
    pub lpips_vgg: Option<f64>,
}

impl AllScores {
    /// Mean of each metric; `None` of an empty list.
    pub fn mean(all: &[Self]) -> Option<Self> {
        let pixel: Vec<Scores> = all.iter().map(|s| s.pixel).collect();
        Some(Self {
            pixel: Scores::mean(&pixel)?,
            lpips_alex: mean_of(all.iter().map(|s| s.lpips_alex)),
            lpips_vgg: mean_of(all.iter().map(|s| s.lpips_vgg)),
        })
    }

    /// Name, value and decimals of each metric, in the order of the tables.
    pub fn rows(&self) -> [(&'static str, Option<f64>, usize); 7] {
        [
            ("psnr", Some(self.pixel.psnr), 2),
            ("ssim", Some(self.pixel.ssim), 4),
            ("ssim_valid", self.pixel.ssim_valid, 4),
            ("ms_ssim", self.pixel.ms_ssim, 4),
            ("flip", Some(self.pixel.flip), 4),
            ("lpips_alex", self.lpips_alex, 4),
            ("lpips_vgg", self.lpips_vgg, 4),
        ]
    }
}

/// The header of [`line()`].
pub fn header(name_width: usize) -> String {
    let names: String = AllScores::default().rows().iter().map(|(name, _, _)| format!(" {name:>10}")).collect();
    format!("{:name_width$}{names}", "")
}

/// One row of a table; `-` for what is absent.
pub fn line(name: &str, name_width: usize, scores: &AllScores) -> String {
    let cells = scores.rows().map(|(_, value, decimals)| format!(" {:>10}", cell(value, decimals)));
    format!("{name:name_width$}{}", cells.concat())
}

/// A number with so many decimals; `-` for what is absent.
pub fn cell(value: Option<f64>, decimals: usize) -> String {
    value.map_or("-".into(), |v| format!("{v:.decimals$}"))
}

/// What scores pictures: the pixel metrics, and LPIPS where there are weights.
#[derive(Debug, Default)]
pub struct Scorer {
    networks: Vec<Lpips>,
}

impl Scorer {
    /// Uploads the weights.
    pub fn new(gpu: Option<&Gpu>, weights: &WeightsFile) -> Result<Self> {
        let Some(gpu) = gpu else { return Ok(Self::default()) };
        let present = Network::ALL.into_iter().filter_map(|n| weights.get(n));
        Ok(Self { networks: present.map(|w| Lpips::new(gpu, w)).collect::<Result<_>>()? })
    }

    /// Scores of a pair, and its map of FLIP.
    pub fn score(&self, reference: &Planes, test: &Planes) -> Result<(AllScores, FlipMap)> {
        let (pixel, map) = metrics::score(reference, test, None)?;
        let mut scores = AllScores { pixel, ..AllScores::default() };
        let side = reference.width.min(reference.height);
        for lpips in self.networks.iter().filter(|l| side >= l.network().smallest_side()) {
            let distance = Some(lpips.distance(reference, test, Range::default())?);
            match lpips.network() {
                Network::Alex => scores.lpips_alex = distance,
                Network::Vgg => scores.lpips_vgg = distance,
            }
        }
        Ok((scores, map))
    }

    /// Scores under a mask: those metrics that have a value per pixel.
    pub fn masked(reference: &Planes, test: &Planes, mask: &Weights) -> Result<AllScores> {
        let (pixel, _) = metrics::score(reference, test, Some(mask))?;
        Ok(AllScores { pixel, ..AllScores::default() })
    }
}

/// Reads the files of `--lpips-weights`.
pub fn read_weights(files: &[PathBuf]) -> Result<WeightsFile> {
    let mut all = WeightsFile::default();
    for file in files {
        all.merge(WeightsFile::read(file)?);
    }
    Ok(all)
}

/// Why numbers are absent, for people and for the JSON.
pub fn notes(weights: &WeightsFile, scores: &[AllScores]) -> Vec<String> {
    let mut notes = Vec::new();
    for network in Network::ALL {
        let name = network.name();
        let absent = |s: &AllScores| match network {
            Network::Alex => s.lpips_alex.is_none(),
            Network::Vgg => s.lpips_vgg.is_none(),
        };
        if weights.get(network).is_some() && scores.iter().any(absent) {
            let side = network.smallest_side();
            notes.push(format!("lpips_{name} is absent: its network needs images of at least {side} pixels a side"));
        }
        if weights.get(network).is_none() {
            notes.push(format!(
                "lpips_{name} is absent: no weights of {name} were given (--lpips-weights FILE.safetensors)"
            ));
        }
    }
    if scores.iter().any(|s| s.pixel.ms_ssim.is_none()) {
        let side = metrics::ssim::MS_SSIM_MIN_SIDE;
        notes.push(format!("ms_ssim is absent: five scales need images of at least {side} pixels a side"));
    }
    if scores.iter().any(|s| s.pixel.ssim_valid.is_none()) {
        notes.push("ssim_valid is absent: no 11x11 window lies inside the image".into());
    }
    notes
}
