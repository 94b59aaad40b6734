//! `spgs-dev plan`: the barrier plan of every kind of frame, as the recorder derived it. The golden file keeps it from
//! changing unnoticed.

use std::path::Path;

use engine::error::{Error, Result};
use engine::gpu::Gpu;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{moving_scene, random_scene};
use engine::scene::{MotionSource, Scene};

use crate::view;

/// The golden file, relative to the folder of the workspace.
pub const GOLDEN: &str = "tests/golden/plan.txt";
const SIZE: [u32; 2] = [320, 200];

/// Plans of a static scene, of motion from the table and from network F, and of one so large that sorts need a spine.
pub fn plan(gpu: &Gpu) -> Result<String> {
    let moving = || moving_scene(1000, 8, 4, 1, true);
    let cases: [(&str, Scene, MotionSource); 4] = [
        ("static", random_scene(1000, 1, 3), MotionSource::Auto),
        ("moving by the key-time table", moving(), MotionSource::Table),
        ("moving by network F", moving(), MotionSource::Network),
        ("static, 600,000 Gaussians", random_scene(600_000, 1, 0), MotionSource::Auto),
    ];
    let mut text = String::new();
    for (name, scene, motion) in cases {
        let mut renderer = Renderer::new(gpu, &scene, &RenderOptions { motion, ..RenderOptions::default() })?;
        renderer.draw(&view::default_camera(&scene, SIZE), 0.0)?;
        let Some(commands) = renderer.commands() else {
            return Err(Error::usage("spgs-dev plan", "no recorded frame", "one after the first draw"));
        };
        let (dispatches, barriers) = (commands.dispatches(), commands.barriers());
        text += &format!("== {name}: {dispatches} dispatches, {barriers} barriers\n{}\n", commands.plan());
    }
    Ok(text)
}

/// The first line in which the plan differs from the golden file, if any.
pub fn difference(root: &Path, plan: &str) -> Result<Option<String>> {
    let path = root.join(GOLDEN);
    let golden = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    if golden == plan {
        return Ok(None);
    }
    let mut lines = golden.lines().zip(plan.lines()).enumerate();
    let place = lines.find(|(_, (a, b))| a != b);
    let text = match place {
        Some((i, (golden, now))) => format!("line {}: golden `{golden}`, now `{now}`", i + 1),
        None => format!("{} lines in the golden file, now {}", golden.lines().count(), plan.lines().count()),
    };
    Ok(Some(format!("{GOLDEN}: {text}; if that is meant, run spgs-dev plan --write")))
}

/// Replaces the golden file.
pub fn write(root: &Path, plan: &str) -> Result<()> {
    let path = root.join(GOLDEN);
    engine::file::durable::write_atomic(&path, |out| out.write_all(plan.as_bytes()))
}
