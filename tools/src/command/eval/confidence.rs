//! How far off the model says its images are, beside how far off they are.

use engine::confidence::{Confidence, Evidence, correlation, rank_correlation};
use engine::data::ImageLoader;
use engine::error::Result;
use engine::gpu::Gpu;
use engine::image::Image;
use engine::metrics::{Planes, mean_of};
use engine::scene::Scene;
use indicatif::ProgressBar;
use serde::Serialize;

use super::session::{PHOTO_BYTES, workers};
use super::setting::Setting;
use crate::report::error_image;

/// Opacity from which on a pixel shows the model, not what is behind it.
const SHOWN: f32 = 0.5;

/// What is expected of one view, and what is.
#[derive(Debug, Clone, Serialize)]
struct OfView {
    index: usize,
    name: String,
    /// Means over the pixels of the error that is expected and of the true one: roots of mean squares over r, g, b.
    expected_error: f64,
    error: f64,
    /// Spearman's and Pearson's correlation over all pixels.
    rank_correlation: Option<f64>,
    correlation: Option<f64>,
    /// Spearman's over pixels that the model covers at least half.
    rank_correlation_inside: Option<f64>,
}

/// The same of all views, for the JSON.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Summary {
    training_views: usize,
    expected_error: Option<f64>,
    error: Option<f64>,
    rank_correlation: Option<f64>,
    correlation: Option<f64>,
    rank_correlation_inside: Option<f64>,
    /// Pearson's correlation of the views' mean errors.
    between_views: Option<f64>,
    images: Vec<OfView>,
}

/// Draws and compares.
pub(super) struct Foretold {
    pub(super) evidence: Evidence,
    drawn: Confidence,
    training_views: usize,
    images: Vec<OfView>,
}

impl Foretold {
    /// Looks at all training views.
    pub(super) fn new(gpu: &Gpu, scene: &Scene, setting: &Setting, bar: &ProgressBar) -> Result<Self> {
        let loader = ImageLoader::new(setting.training.clone().into(), PHOTO_BYTES, workers())?;
        let evidence = Evidence::of_views(gpu, scene, &loader, &setting.options, || bar.inc(1))?;
        let drawn = Confidence::new(gpu, scene, &setting.options, &evidence)?;
        Ok(Self { evidence, drawn, training_views: setting.training.len(), images: Vec::new() })
    }

    /// Compares a view; what comes back is the expected error as an image, like the error's.
    pub(super) fn view(&mut self, setting: &Setting, index: usize, images: [&Planes; 2]) -> Result<Image> {
        let view = &setting.views[index];
        let drawn = self.drawn.render(&view.camera, view.time)?;
        let expected: Vec<f64> = drawn.error.iter().map(|e| f64::from(*e)).collect();
        let [rendered, truth] = images;
        let of_pixel = |i: usize| {
            let squares = rendered.rgb.iter().zip(&truth.rgb).map(|(a, b)| (a[i] - b[i]).powi(2));
            (squares.sum::<f64>() / 3.0).sqrt()
        };
        let error: Vec<f64> = (0..truth.pixels()).map(of_pixel).collect();
        let inside = |values: &[f64]| -> Vec<f64> {
            values.iter().zip(&drawn.opacity).filter(|(_, a)| **a >= SHOWN).map(|(v, _)| *v).collect()
        };
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        self.images.push(OfView {
            index,
            name: view.name.clone(),
            expected_error: mean(&expected),
            error: mean(&error),
            rank_correlation: rank_correlation(&expected, &error),
            correlation: correlation(&expected, &error),
            rank_correlation_inside: rank_correlation(&inside(&expected), &inside(&error)),
        });
        Ok(error_image::gained(&drawn.error, [truth.width as u32, truth.height as u32]))
    }

    /// All views together.
    pub(super) fn summary(mut self) -> Summary {
        self.images.sort_by_key(|v| v.index);
        let all = &self.images;
        let of = |value: fn(&OfView) -> Option<f64>| mean_of(all.iter().map(value));
        let list = |value: fn(&OfView) -> f64| -> Vec<f64> { all.iter().map(value).collect() };
        Summary {
            training_views: self.training_views,
            expected_error: of(|v| Some(v.expected_error)),
            error: of(|v| Some(v.error)),
            rank_correlation: of(|v| v.rank_correlation),
            correlation: of(|v| v.correlation),
            rank_correlation_inside: of(|v| v.rank_correlation_inside),
            between_views: correlation(&list(|v| v.expected_error), &list(|v| v.error)),
            images: self.images,
        }
    }
}

impl Summary {
    /// One line.
    pub(super) fn line(&self) -> String {
        let cell = |v: Option<f64>, digits: usize| crate::report::scores::cell(v, digits);
        format!(
            "error expected from {} training views {}, found {}; rank correlation {} (inside {}), of the views' means {}",
            self.training_views,
            cell(self.expected_error, 4),
            cell(self.error, 4),
            cell(self.rank_correlation, 3),
            cell(self.rank_correlation_inside, 3),
            cell(self.between_views, 3),
        )
    }
}
