//! Teacher and student beside photos.

use std::path::Path;

use engine::data::dataset::{self, DatasetOptions};
use engine::data::loader::ImageLoader;
use engine::error::Result;
use engine::gpu::Gpu;
use engine::render::RenderOptions;
use engine::scene::Scene;
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

/// Held-out photos, or, where there are none, those to train on.
#[derive(Debug)]
pub(super) struct Held {
    split: &'static str,
    loader: ImageLoader,
}

impl Held {
    /// `None` for cameras without photos.
    pub(super) fn of(data: &Path, downscale: Option<u32>) -> Result<Option<Self>> {
        let options = DatasetOptions { downscale, ..DatasetOptions::default() };
        let Ok(data) = dataset::load(data, &options) else { return Ok(None) };
        let (split, views) = if data.test.is_empty() { ("train", data.train) } else { ("test", data.test) };
        Ok(Some(Self { split, loader: ImageLoader::new(views.into(), PHOTO_BYTES, 1)? }))
    }

    /// Mean PSNR and SSIM of a scene.
    pub(super) fn score(
        &self,
        gpu: &Gpu,
        scene: &Scene,
        options: &RenderOptions,
        tick: &mut dyn FnMut(usize),
    ) -> Result<[f64; 2]> {
        let all: Vec<usize> = (0..self.loader.views().len()).collect();
        let mut done = 0;
        let scores = evaluate::evaluate(gpu, scene, &self.loader, &all, options, |_, _, _| {
            done += 1;
            tick(done);
            Ok(())
        })?;
        Ok(evaluate::mean(&scores))
    }

    /// Scores of teacher and student side by side.
    pub(super) fn both(&self, [[a, c], [b, d]]: [[f64; 2]; 2]) -> Photos {
        Photos { split: self.split, views: self.loader.views().len(), psnr: [a, b], ssim: [c, d] }
    }
}
