//! One view of a model as a PNG: `cargo run --release -p spgs-engine --example render [MODEL [OUT.png]]`; without a model, the
//! built-in scene.

use engine::file::picture::{Alpha, write_png};
use engine::gpu::{Gpu, GpuOptions};
use engine::render::{RenderOptions, Renderer, SceneHandle, SceneOptions};
use engine::scene::{Camera, synthetic::demo_scene};
use glam::DVec3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let scene = match arguments.next() {
        Some(model) => engine::file::load(model.as_ref())?.scene,
        None => demo_scene(),
    };
    let gpu = Gpu::new(&GpuOptions::default())?;
    // A ball around most of the scene, seen from a little above it.
    let ball = SceneHandle::upload(&gpu, &scene, &SceneOptions::default())?.extent();
    let eye = ball.center + DVec3::new(2.0, -2.0, 1.0) * ball.radius;
    let camera = Camera::look_at(eye, ball.center, DVec3::Z, 0.8, [640, 480]);
    let options = RenderOptions { near: 0.01 * ball.radius as f32, ..Default::default() };
    let image = Renderer::new(&gpu, &scene, &options)?.render(&camera, ball.times[0])?;
    let out = arguments.next().unwrap_or_else(|| "render.png".into());
    write_png(out.as_ref(), &image, Alpha::Drop)?;
    Ok(())
}
