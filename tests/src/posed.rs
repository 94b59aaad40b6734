//! A small data set made by rendering: a synthetic scene, moving or not, in D-NeRF's format in a temporary folder.

use std::path::Path;

use engine::file::picture::{self, Alpha};
use engine::gpu::Gpu;
use engine::image::Image;
use engine::reference::{self, ReferenceOptions};
use engine::render::{RenderOptions, Renderer};
use engine::scene::parameter::LIFESPAN;
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
    /// How many of the last superpoints are balls: a red one that circles above the others, by more than its size from image to
    /// image, and a green one that does so the other way around, below them.
    pub balls: usize,
    /// Whether the last superpoint is a hand that swings a stick: its every other Gaussian is the stick's.
    pub stick: bool,
    /// Whether the images are opaque, white behind the scene; else they are cut out.
    pub opaque: bool,
    /// Whether every other Gaussian is seen early, and the others late.
    pub comes_and_goes: bool,
}

impl Default for PosedOptions {
    fn default() -> Self {
        Self {
            sizes: vec![[32, 24]],
            train: 8,
            test: 2,
            gaussians: 80,
            superpoints: 3,
            moving: true,
            swing: 0.3,
            balls: 0,
            stick: false,
            opaque: false,
            comes_and_goes: false,
        }
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
    /// Renders on the device and writes a data set.
    ///
    /// # Panics
    /// When rendering fails or a file cannot be written.
    pub fn new(gpu: &Gpu, options: &PosedOptions) -> Self {
        let scene = scene(options);
        let background = if options.opaque { [1.0; 3] } else { [0.0; 3] };
        let mut renderer =
            Renderer::new(gpu, &scene, &RenderOptions { background, ..RenderOptions::default() }).unwrap();
        let folder = write(options, |camera, time| renderer.render(camera, time).unwrap());
        Self { scene, folder }
    }

    /// The same, rendered by the f64 reference: what training on it comes to tells devices apart, not data sets.
    ///
    /// # Panics
    /// As [`Posed::new`].
    pub fn by_reference(options: &PosedOptions) -> Self {
        let scene = scene(options);
        let exact = ReferenceOptions::default();
        let folder = write(options, |camera, time| reference::render(&scene, camera, time, &exact).unwrap().to_image());
        Self { scene, folder }
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// What the images show.
fn scene(options: &PosedOptions) -> Scene {
    let mut scene = moving_scene(options.gaussians, options.superpoints, 33, 7, false);
    if let Some(motion) = scene.deformation.table_mut() {
        let superpoints = options.superpoints;
        for (at, translation) in motion.translation.iter_mut().enumerate() {
            let (time, j) = (motion.times[at / superpoints], at % superpoints);
            translation[j % 3] += options.swing * (std::f32::consts::TAU * time).sin();
        }
    }
    for ball in 0..options.balls {
        throw_ball(&mut scene, options.superpoints - 1 - ball, ball);
    }
    if options.stick {
        hold_stick(&mut scene, options.superpoints - 1);
    }
    if options.comes_and_goes {
        let lifespan = |i: usize| [[0.1_f32, -1.6], [0.9, -1.6]][i % 2];
        scene.gaussians.optional.set(LIFESPAN, (0..options.gaussians).flat_map(lifespan).collect());
    }
    scene
}

/// Makes a ball of a superpoint's Gaussians: red, 0.2 in radius, on a circle of radius 0.9 above the others, once around in two
/// thirds of the time; the second is green, goes the other way around, and below.
fn throw_ball(scene: &mut Scene, ball: usize, which: usize) {
    let of_gaussian = scene.deformation.superpoint_of_gaussian().to_vec();
    let side = [1.0, -1.0][which];
    let start = DVec3::new(0.9, 1.15 * side, 0.0);
    let k3 = scene.gaussians.sh_coefficients() * 3;
    let g = &mut scene.gaussians;
    for (at, i) in (0..g.len()).filter(|&i| of_gaussian[i] as usize == ball).enumerate() {
        let angles = DVec3::new(1.0, 2.3, 3.7) * at as f64;
        let inside = 0.15 * DVec3::new(angles.x.sin(), angles.y.sin(), angles.z.sin());
        g.mean[i] = (start + inside).as_vec3().to_array();
        (g.log_scale[i], g.opacity_logit[i]) = ([-2.8; 3], 3.0);
        g.sh[i * k3..(i + 1) * k3].fill(0.0);
        g.sh[i * k3 + which] = 1.5;
    }
    if let Some(motion) = scene.deformation.table_mut() {
        let superpoints = motion.translation.len() / motion.times.len();
        for (time, at) in motion.times.iter().zip((ball..).step_by(superpoints)) {
            let angle = 1.5 * std::f64::consts::TAU * f64::from(*time);
            let place =
                DVec3::new(0.9 * angle.cos(), side * (1.15 + 0.15 * (2.0 * angle).sin()), side * 0.9 * angle.sin());
            motion.rotation[at] = [0.0; 3];
            motion.translation[at] = (place - start).as_vec3().to_array();
        }
    }
}

/// Gives the last 80 Gaussians to a superpoint that has no others: a red hand, 0.1 in radius, that moves a little above the others, and
/// a black stick of 0.6 in it, which swings by 60° to either side twice.
fn hold_stick(scene: &mut Scene, superpoint: usize) {
    let first = scene.gaussians.len() - 80;
    if let Some(moved) = scene.deformation.superpoint_deformation_mut() {
        let of_gaussian = &mut moved.superpoints.of_gaussian;
        of_gaussian.iter_mut().filter(|j| **j as usize == superpoint).for_each(|j| *j = 0);
        of_gaussian[first..].fill(superpoint as u32);
    }
    let hand = DVec3::new(0.0, 1.1, 0.0);
    let k3 = scene.gaussians.sh_coefficients() * 3;
    let g = &mut scene.gaussians;
    for (at, i) in (first..g.len()).enumerate() {
        let angles = DVec3::new(1.0, 2.3, 3.7) * at as f64;
        let knob = 0.06 * DVec3::new(angles.x.sin(), angles.y.sin(), angles.z.sin());
        let along = DVec3::Y * (0.1 + 0.5 * at as f64 / 80.0);
        let (place, size, color) =
            if is_of_stick(at) { (along, -4.3, [-1.6; 3]) } else { (knob, -3.2, [1.6, -0.6, -0.6]) };
        g.mean[i] = (hand + place).as_vec3().to_array();
        (g.log_scale[i], g.opacity_logit[i]) = ([size; 3], 3.0);
        g.sh[i * k3..(i + 1) * k3].fill(0.0);
        g.sh[i * k3..i * k3 + 3].copy_from_slice(&color);
    }
    if let Some(motion) = scene.deformation.table_mut() {
        let superpoints = motion.translation.len() / motion.times.len();
        for (time, at) in motion.times.iter().zip((superpoint..).step_by(superpoints)) {
            let angle = std::f64::consts::TAU * f64::from(*time);
            let turn = 1.05 * (2.0 * angle).sin();
            let place = hand + DVec3::new(0.3 * angle.sin(), 0.1 * angle.cos(), 0.1 * angle.sin());
            motion.rotation[at] = [0.0, 0.0, turn as f32];
            motion.translation[at] = (place - DMat3::from_rotation_z(turn) * hand).as_vec3().to_array();
        }
    }
}

/// Whether the so many-th Gaussian of a hand with a stick is the stick's.
pub fn is_of_stick(at: usize) -> bool {
    at % 2 == 1
}

/// Writes both splits with the pictures that `render` makes.
fn write(options: &PosedOptions, mut render: impl FnMut(&Camera, f64) -> Image) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, count, offset) in [("train", options.train, 0.0), ("test", options.test, 0.5)] {
        if count == 0 {
            continue;
        }
        std::fs::create_dir(folder.path().join(name)).unwrap();
        let mut frames = Vec::new();
        for i in 0..count {
            let time = if options.moving { (i as f64 + offset) / count.max(2) as f64 } else { 0.0 };
            let camera = camera(i, offset, options.sizes[i % options.sizes.len()]);
            let file = format!("{name}/r_{i:03}");
            let path = folder.path().join(format!("{file}.png"));
            let alpha = if options.opaque { Alpha::Drop } else { Alpha::Straight };
            picture::write_png(&path, &render(&camera, time), alpha).unwrap();
            frames.push(frame(&camera, time, &file));
        }
        let text = json!({ "camera_angle_x": FIELD_OF_VIEW, "frames": frames }).to_string();
        std::fs::write(folder.path().join(format!("transforms_{name}.json")), text).unwrap();
    }
    folder
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
