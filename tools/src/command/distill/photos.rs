//! Teacher and student beside photos.

use std::path::Path;

use engine::data::dataset::{self, DatasetOptions};
use engine::data::loader::ImageLoader;
use engine::error::Result;
use engine::gpu::Gpu;
use engine::render::RenderOptions;
use engine::scene::{MotionSource, Scene};
use engine::train::evaluate;
use serde::Serialize;

/// Decoded photos that are kept, bytes.
const PHOTO_BYTES: u64 = 1 << 30;

/// Scores on the photos of a data set.
#[derive(Debug, Clone, Serialize)]
pub struct Photos {
    /// Which part of the data set.
    pub split: &'static str,
    /// How many.
    pub views: usize,
    /// Mean PSNR of the teacher and of the student, dB.
    pub psnr: [f64; 2],
    /// Mean SSIM of both.
    pub ssim: [f64; 2],
}

impl Photos {
    /// For people.
    pub(super) fn line(&self) -> String {
        let ([a, b], [c, d]) = (self.psnr, self.ssim);
        format!(
            "teacher {a:.2} dB, SSIM {c:.4}; student {b:.2} dB, SSIM {d:.4} over {} {} views",
            self.views, self.split
        )
    }
}

/// Scores both on the held-out photos, or, where there are none, on those to train on. `None` for cameras without photos.
pub(super) fn score(
    gpu: &Gpu,
    [teacher, student]: [&Scene; 2],
    source: MotionSource,
    data: &Path,
    options: &RenderOptions,
    tick: &mut dyn FnMut(usize),
) -> Result<Option<Photos>> {
    let Ok(data) = dataset::load(data, &DatasetOptions::default()) else { return Ok(None) };
    let (split, views) = if data.test.is_empty() { ("train", data.train) } else { ("test", data.test) };
    let loader = ImageLoader::new(views.into(), PHOTO_BYTES, 1)?;
    let all: Vec<usize> = (0..loader.views().len()).collect();
    let mut done = 0;
    let mut of = |scene: &Scene, motion: MotionSource| {
        let options = RenderOptions { motion, ..options.clone() };
        let scores = evaluate::evaluate(gpu, scene, &loader, &all, &options, |_, _, _| {
            done += 1;
            tick(done);
            Ok(())
        })?;
        Ok::<_, engine::error::Error>(evaluate::mean(&scores))
    };
    let ([a, c], [b, d]) = (of(teacher, source)?, of(student, MotionSource::Auto)?);
    Ok(Some(Photos { split, views: all.len(), psnr: [a, b], ssim: [c, d] }))
}
