//! A program with its own Vulkan device that draws a mesh, and our scene among it: `cargo run --example host [OUT.png]`.
//!
//! `vulkan.rs` is what any program has; `composite.rs` is what embedding takes: the engine on the host's device, a scene, a
//! view, `View::record` into the host's command buffer and images, and a pass that puts colour and depth among the meshes.
#![allow(clippy::undocumented_unsafe_blocks, reason = "nearly every line is a raw Vulkan call")]

mod composite;
mod vulkan;

use engine::file::picture::{Alpha, write_png};
use engine::image::Image;
use engine::scene::synthetic::{demo_camera, demo_scene};
use glam::DVec3;

const SIZE: [u32; 2] = [640, 480];
const TIME: f64 = 0.25;

fn main() -> vulkan::Result<()> {
    let out = std::env::args().nth(1).unwrap_or_else(|| "out/host.png".into());
    let host = vulkan::Vulkan::new(std::env::var_os("SPGS_VALIDATION").is_some())?;
    let gpu = composite::engine_on(&host)?;
    let camera = demo_camera(TIME, SIZE[0], SIZE[1]);
    let mut compositor = composite::Compositor::new(&host, &gpu, &demo_scene(), SIZE)?;
    compositor.warm_up(&camera, TIME)?;
    let pixels = compositor.draw(&camera, TIME, composite::cube(DVec3::ZERO, 0.45))?;
    let rgba = pixels.iter().map(|v| f32::from(*v) / 255.0).collect();
    let path = std::path::Path::new(&out);
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    write_png(path, &Image { width: SIZE[0], height: SIZE[1], rgba, depth: Vec::new() }, Alpha::Drop)?;
    match host.messages().first() {
        Some(message) => Err(format!("validation layer: {message}").into()),
        None => Ok(()),
    }
}
