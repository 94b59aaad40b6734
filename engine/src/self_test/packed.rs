//! Frames in reduced quality or with depth, and pixels as windows and other programs take them.

use super::check;
use super::frame::{BACKGROUND, SIZE, TIMES, camera, scene};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::render::display::{DisplayMode, DisplayOptions, Screen};
use crate::render::{PixelFormat, Quality, RenderOptions, Renderer, SceneHandle, SceneOptions, View, ViewOptions};
use crate::scene::Scene;

/// Tests what the viewer shows and what other programs are given.
pub(super) fn test(gpu: &Gpu) -> Result<()> {
    let scene = scene();
    packed(gpu, &scene)?;
    displayed(gpu, &scene)
}

/// A frame in the quality that programs show, packed into pixels.
fn packed(gpu: &Gpu, scene: &Scene) -> Result<()> {
    let (watched, watch) = gpu.watched();
    let options = SceneOptions { quality: Quality::HIGH, ..SceneOptions::default() };
    let scene = SceneHandle::upload(&watched, scene, &options)?;
    let options = ViewOptions { background: BACKGROUND, format: PixelFormat::Rgba8, ..ViewOptions::default() };
    View::new(&watched, &scene, &options)?.warm_up(&camera(TIMES[0]), TIMES[0])?;
    check(&watch)
}

/// A frame with depth, then its way to a window: as it is and as depth.
fn displayed(gpu: &Gpu, scene: &Scene) -> Result<()> {
    let (watched, watch) = gpu.watched();
    let options = RenderOptions { background: BACKGROUND, depth: true, ..RenderOptions::default() };
    let mut renderer = Renderer::new(&watched, scene, &options)?;
    let (mut color, mut depth) = (Screen::new(&watched)?, Screen::new(&watched)?);
    let frame = renderer.submit(&camera(TIMES[0]), TIMES[0])?;
    for (screen, mode) in [(&mut color, DisplayMode::Color), (&mut depth, DisplayMode::Depth)] {
        let options = DisplayOptions { mode, size: SIZE, bgra: false, depth_range: [1.0, 6.0], tile_range: 50.0 };
        screen.submit(&renderer, frame, &options)?;
    }
    watched.wait_idle()?;
    check(&watch)
}
