//! A small data set made by rendering: a synthetic scene, moving or not, in D-NeRF's format in a temporary folder.

use std::path::Path;

use engine::file::picture::{self, Alpha};
use engine::gpu::Gpu;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::moving_scene;
use engine::scene::{Camera, Scene};
use glam::{DMat3, DVec3};
use serde_json::json;

/// What is rendered.
#[derive(Debug, Clone)]
pub struct PosedOptions {
    /// Image sizes, pixels; frames take them in turn.
    pub sizes: Vec<[u32; 2]>,
    /// Training images.
    pub train: usize,
    /// Test images; 0: no test split.
    pub test: usize,
    /// Gaussians.
    pub gaussians: usize,
    /// Superpoints.
    pub superpoints: usize,
    /// Whether the images have different times.
    pub moving: bool,
    /// How far superpoints swing, world units; beside the scene's own rocking.
    pub swing: f32,
}

impl Default for PosedOptions {
    fn default() -> Self {
        Self { sizes: vec![[32, 24]], train: 8, test: 2, gaussians: 80, superpoints: 3, moving: true, swing: 0.3 }
    }
}

/// A data set on disk, removed when dropped.
#[derive(Debug)]
pub struct Posed {
    /// What the images show.
    pub scene: Scene,
    folder: tempfile::TempDir,
}

impl Posed {
    /// Renders and writes a data set.
    ///
    /// # Panics
    /// When rendering fails or a file cannot be written.
    pub fn new(gpu: &Gpu, options: &PosedOptions) -> Self {
        let mut scene = moving_scene(options.gaussians, options.superpoints, 33, 7, false);
        if let Some(motion) = &mut scene.motion {
            let superpoints = options.superpoints;
            for (at, translation) in motion.translation.iter_mut().enumerate() {
                let (time, j) = (motion.times[at / superpoints], at % superpoints);
                translation[j % 3] += options.swing * (std::f32::consts::TAU * time).sin();
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let mut renderer = Renderer::new(gpu, &scene, &RenderOptions::default()).unwrap();
        let mut split = |name: &str, count: usize, offset: f64| {
            if count == 0 {
                return;
            }
            std::fs::create_dir(folder.path().join(name)).unwrap();
            let mut frames = Vec::new();
            for i in 0..count {
                let time = if options.moving { (i as f64 + offset) / count.max(2) as f64 } else { 0.0 };
                let camera = camera(i, offset, options.sizes[i % options.sizes.len()]);
                let image = renderer.render(&camera, time).unwrap();
                let file = format!("{name}/r_{i:03}");
                picture::write_png(&folder.path().join(format!("{file}.png")), &image, Alpha::Straight).unwrap();
                frames.push(frame(&camera, time, &file));
            }
            let text = json!({ "camera_angle_x": FIELD_OF_VIEW, "frames": frames }).to_string();
            std::fs::write(folder.path().join(format!("transforms_{name}.json")), text).unwrap();
        };
        split("train", options.train, 0.0);
        split("test", options.test, 0.5);
        Self { scene, folder }
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

const FIELD_OF_VIEW: f64 = 0.8;

/// Cameras on a circle around the scene, a third of it from one to the next.
fn camera(i: usize, offset: f64, size: [u32; 2]) -> Camera {
    let angle = 2.3 * i as f64 + 0.4 * offset;
    let eye = DVec3::new(4.5 * angle.cos(), 1.2, 4.5 * angle.sin());
    Camera::look_at(eye, DVec3::ZERO, DVec3::Y, FIELD_OF_VIEW, size)
}

/// A frame of `transforms_*.json`: camera to world, OpenGL axes.
fn frame(camera: &Camera, time: f64, file: &str) -> serde_json::Value {
    let turn = camera.rotation.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let row = |r: usize| [turn.row(r).x, turn.row(r).y, turn.row(r).z, camera.position[r]];
    json!({ "file_path": format!("./{file}"), "time": time, "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]] })
}
