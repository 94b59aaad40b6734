//! `spgs-dev pictures`: the images of the README, made from the built-in scene.

use std::path::Path;

use engine::error::{Error, Result};
use engine::file::durable::write_atomic;
use engine::file::picture::to_u8;
use engine::gpu::Gpu;
use engine::image::{Image, difference};
use engine::metrics::Planes;
use engine::reference::{self, ReferenceOptions};
use engine::render::{Quality, RenderOptions, Renderer};
use engine::scene::Scene;
use engine::scene::synthetic::{DEMO_BACKGROUND, demo_camera, demo_scene};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, Frame, RgbaImage};

use crate::cli::args::Format;
use crate::report::{average, error_image, files};

/// Where the images lie in a source tree.
pub const FOLDER: &str = "tools/docs/images";
/// Side of the animation and of the stills, pixels.
const ANIMATION: u32 = 320;
const STILL: u32 = 320;
/// Frames of the animation, which loops, and milliseconds between two of them.
const FRAMES: u32 = 24;
const DELAY_MS: u32 = 100;
/// Pixels of a rendered frame per pixel of the animation, each way.
const SUPERSAMPLE: u32 = 2;
/// Time that the stills show.
const TIME: f64 = 0.27;
/// Powers of ten between which the error image tells differences apart.
const DECADES: [f64; 2] = [-6.0, -3.0];

/// Writes all images; what it prints are their names, sizes and the numbers that their captions give.
///
/// # Errors
/// Those of rendering; `Io`.
pub fn write(gpu: &Gpu, root: &Path) -> Result<Vec<String>> {
    let folder = root.join(FOLDER);
    files::create_folder(&folder)?;
    let scene = demo_scene();
    let ours = still(gpu, &scene)?;
    let camera = demo_camera(TIME, STILL, STILL);
    let options = ReferenceOptions { background: DEMO_BACKGROUND.map(f64::from), ..ReferenceOptions::default() };
    let reference = reference::render(&scene, &camera, TIME, &options)?;
    let distance = difference(reference.rgb.iter().copied(), ours.rgb());
    let reference = reference.to_image();
    let error = error_image::decades(&Planes::clamped(&reference)?, &Planes::clamped(&ours)?, DECADES);
    let mut lines = vec![format!("device  {}", gpu.info().driver)];
    for (name, image) in [("ours.png", &ours), ("reference.png", &reference), ("error.png", &error)] {
        Format::Png.write(&folder.join(name), image)?;
    }
    let path = folder.join("demo.gif");
    let encoded = animation(gpu, &scene, &path)?;
    write_atomic(&path, |out| out.write_all(&encoded))?;
    let mut total = 0;
    for name in ["demo.gif", "ours.png", "reference.png", "error.png"] {
        let path = folder.join(name);
        let bytes = std::fs::metadata(&path).map_err(|e| Error::io(&path, "read", e))?.len();
        total += bytes;
        lines.push(format!("{bytes:>8}  {}", path.display()));
    }
    lines.push(format!("{total:>8}  bytes in all"));
    lines.push(format!("against the f64 reference: {:.1} dB, largest difference {:.1e}", distance.psnr, distance.max));
    Ok(lines)
}

fn options() -> RenderOptions {
    RenderOptions { background: DEMO_BACKGROUND, quality: Quality::HIGH, ..RenderOptions::default() }
}

fn still(gpu: &Gpu, scene: &Scene) -> Result<Image> {
    Renderer::new(gpu, scene, &options())?.render(&demo_camera(TIME, STILL, STILL), TIME)
}

/// The loop of the built-in scene as a GIF.
fn animation(gpu: &Gpu, scene: &Scene, path: &Path) -> Result<Vec<u8>> {
    let mut renderer = Renderer::new(gpu, scene, &options())?;
    let failed = |e| Error::io(path, "encode GIF", std::io::Error::other(e));
    let mut bytes = Vec::new();
    let mut encoder = GifEncoder::new_with_speed(&mut bytes, 1);
    encoder.set_repeat(Repeat::Infinite).map_err(failed)?;
    for i in 0..FRAMES {
        let time = f64::from(i) / f64::from(FRAMES);
        let side = ANIMATION * SUPERSAMPLE;
        let image = average::reduced(renderer.render(&demo_camera(time, side, side), time)?, SUPERSAMPLE);
        let pixels = image.rgba.chunks_exact(4).flat_map(|p| [to_u8(p[0]), to_u8(p[1]), to_u8(p[2]), 255]).collect();
        let Some(pixels) = RgbaImage::from_raw(ANIMATION, ANIMATION, pixels) else { continue };
        let delay = Delay::from_numer_denom_ms(DELAY_MS, 1);
        encoder.encode_frame(Frame::from_parts(pixels, 0, 0, delay)).map_err(failed)?;
    }
    drop(encoder);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;

    #[test]
    fn the_images_in_the_repository_are_small() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join(FOLDER);
        let bytes: u64 = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().metadata().unwrap().len()).sum();
        assert!((1..=1_500_000).contains(&bytes), "{bytes} bytes");
    }
}
