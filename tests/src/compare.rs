//! Renders a scene on the device and in the f64 reference and compares, with the bounds of the project.

use engine::gpu::Gpu;
use engine::image::{Difference, Image, difference};
use engine::reference::{self, ReferenceOptions};
use engine::render::{RenderOptions, Renderer};
use engine::scene::{Camera, MotionSource, Scene};

/// PSNR that every test scene must reach against the f64 reference, dB.
pub const MIN_PSNR: f64 = 65.0;
/// Share of values that must be within 1e-3.
pub const MIN_WITHIN: f64 = 0.999;

/// A scene's view on both sides.
#[derive(Debug)]
pub struct Comparison {
    /// From the device.
    pub image: Image,
    /// Colour difference.
    pub color: Difference,
    /// Alpha difference.
    pub alpha: Difference,
    /// Milliseconds of the device frame, host side, the first one included.
    pub gpu_ms: f64,
}

/// Renders on both sides.
///
/// # Panics
/// When either side fails, or when a value from the device is not finite.
pub fn compare(gpu: &Gpu, scene: &Scene, camera: &Camera, time: f64, motion: MotionSource) -> Comparison {
    let background = [0.25, 0.5, 0.125];
    compare_with(gpu, scene, camera, time, &RenderOptions { background, motion, ..RenderOptions::default() })
}

/// [`compare`] with the near plane, background and motion of `options`.
///
/// # Panics
/// As [`compare`].
pub fn compare_with(gpu: &Gpu, scene: &Scene, camera: &Camera, time: f64, options: &RenderOptions) -> Comparison {
    let options = RenderOptions { depth: true, ..options.clone() };
    let mut renderer = Renderer::new(gpu, scene, &options).unwrap();
    let start = std::time::Instant::now();
    let image = renderer.render(camera, time).unwrap();
    let gpu_ms = start.elapsed().as_secs_f64() * 1e3;
    assert!(image.rgba.iter().chain(&image.depth).all(|v| v.is_finite()), "the device image holds NaN or Inf");
    let options = ReferenceOptions {
        background: options.background.map(f64::from),
        motion: options.motion,
        near: f64::from(options.near),
    };
    let truth = reference::render(scene, camera, time, &options).unwrap();
    let channel = |c: usize| image.rgba.chunks_exact(4).map(move |p| f64::from(p[c]));
    let rgb = image.rgba.chunks_exact(4).flat_map(|p| [f64::from(p[0]), f64::from(p[1]), f64::from(p[2])]);
    let color = difference(truth.rgb.iter().copied(), rgb);
    let alpha = difference(truth.alpha.iter().copied(), channel(3));
    Comparison { image, color, alpha, gpu_ms }
}

impl Comparison {
    /// Prints one line and asserts the bounds.
    ///
    /// # Panics
    /// When a bound is missed.
    pub fn assert_within_bounds(&self, name: &str) {
        let c = self.color;
        println!(
            "{name:44} PSNR {:7.2} dB  max {:.2e}  q999 {:.2e}  within 1e-3 {:.6}  {:8.1} ms",
            c.psnr, c.max, c.q999, c.within_1e3, self.gpu_ms
        );
        for (what, d) in [("colour", self.color), ("alpha", self.alpha)] {
            assert!(d.psnr >= MIN_PSNR, "{name}: {what} PSNR {} dB < {MIN_PSNR}: {d:?}", d.psnr);
            assert!(d.within_1e3 >= MIN_WITHIN, "{name}: {what} within 1e-3 {} < {MIN_WITHIN}: {d:?}", d.within_1e3);
        }
    }
}
