//! `spgs-dev plan`: the barrier plan of every kind of frame and training step, as the recorder derived it. Golden files keep them from
//! changing unnoticed.

use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use engine::file::durable::write_atomic;
use engine::gpu::{Commands, Gpu};
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{demo_camera, demo_scene, moving_scene, random_scene};
use engine::scene::{MotionSource, Scene};

use crate::bench::train;
use crate::cli::camera;

/// Where the golden files are, relative to the folder of the workspace.
pub const GOLDEN: &str = "tests/golden";

/// Most dispatches of a frame and of a training step.
const FRAME_BUDGET: usize = 7;
const STEP_BUDGET: usize = 60;

/// The plan of one kind of frame or training step.
#[derive(Debug, Clone)]
pub struct NamedPlan {
    /// Stem of its golden file `NAME.plan.txt`.
    pub name: &'static str,
    /// Most dispatches that it may have.
    pub budget: usize,
    /// Dispatches of the frame.
    pub dispatches: usize,
    /// Barriers of the frame.
    pub barriers: usize,
    /// One line per operation.
    pub text: String,
}

/// Plans of the demo's frame (motion by the key-time table), of a static scene, and of motion by network F; of training steps.
pub fn plans(gpu: &Gpu) -> Result<Vec<NamedPlan>> {
    let demo = (demo_scene(), demo_camera(0.0, 640, 480));
    let small = |scene: Scene| {
        let camera = camera::default_camera(&scene, [320, 200]);
        (scene, camera)
    };
    let cases = [
        ("frame", demo, MotionSource::Auto),
        ("static", small(random_scene(1000, 1, 3)), MotionSource::Auto),
        ("network", small(moving_scene(1000, 8, 4, 1, true)), MotionSource::Network),
    ];
    cases
        .into_iter()
        .map(|(name, (scene, camera), motion)| {
            let mut renderer = Renderer::new(gpu, &scene, &RenderOptions { motion, ..RenderOptions::default() })?;
            renderer.draw(&camera, 0.0)?;
            named(name, FRAME_BUDGET, renderer.commands())
        })
        .chain(training_plans(gpu))
        .collect()
}

/// Plans of a training step: of a static scene and of a moving one.
fn training_plans(gpu: &Gpu) -> impl Iterator<Item = Result<NamedPlan>> {
    [("train_static", 0), ("train_rigid", 8)].into_iter().map(|(name, superpoints)| {
        let trainer = train::stepped(gpu, 500, superpoints, [64, 48])?;
        named(name, STEP_BUDGET, trainer.commands())
    })
}

fn named(name: &'static str, budget: usize, commands: Option<&Commands>) -> Result<NamedPlan> {
    let Some(commands) = commands else {
        return Err(Error::usage("spgs-dev plan", "no recorded commands", "some after the first run"));
    };
    let (dispatches, barriers) = (commands.dispatches(), commands.barriers());
    Ok(NamedPlan { name, budget, dispatches, barriers, text: commands.plan().to_owned() })
}

/// The first line in which the plan differs from its golden file, if any.
pub fn difference(root: &Path, plan: &NamedPlan) -> Result<Option<String>> {
    let path = golden(root, plan);
    let golden = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    if golden == plan.text {
        return Ok(None);
    }
    let mut lines = golden.lines().zip(plan.text.lines()).enumerate();
    let place = lines.find(|(_, (a, b))| a != b);
    let text = match place {
        Some((i, (golden, now))) => format!("line {}: golden `{golden}`, now `{now}`", i + 1),
        None => format!("{} lines in the golden file, now {}", golden.lines().count(), plan.text.lines().count()),
    };
    Ok(Some(format!("{}: {text}; if that is meant, run spgs-dev plan --write", path.display())))
}

/// Replaces the golden file.
pub fn write(root: &Path, plan: &NamedPlan) -> Result<()> {
    let folder = root.join(GOLDEN);
    std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, "make folder", e))?;
    write_atomic(&golden(root, plan), |out| out.write_all(plan.text.as_bytes()))
}

fn golden(root: &Path, plan: &NamedPlan) -> PathBuf {
    root.join(GOLDEN).join(format!("{}.plan.txt", plan.name))
}
