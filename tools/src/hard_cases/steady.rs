//! Cases 18 and 19: popping between frames of a turning camera, and flicker of pixels that stand still.

use engine::error::Result;
use engine::image::Image;
use engine::reference;
use engine::render::Renderer;
use engine::scene::synthetic::{moving_scene, random_scene};
use engine::scene::{Camera, Scene};
use glam::{DMat3, DVec3};

use super::compare::{reference_options, usual_options};
use super::{Case, Check, Context, Outcome, views};

/// Frames of the turning camera.
const FRAMES: u32 = 9;
/// Turn from one frame to the next, radians.
const TURN: f64 = 0.02;

pub(super) fn cases() -> Vec<Case> {
    let popping =
        "A camera that turns about its own centre: frames warped on to the first; depth order changes, nothing else.";
    let flicker =
        "Half of the Gaussians move, half stand still: pixels that the truth shows unchanged over nine frames.";
    vec![
        Case::new(18, "popping", popping, judge_popping),
        Case::new(19, "flicker_of_static_pixels", flicker, judge_flicker),
    ]
}

/// The camera after turning about its own y axis.
fn turned(camera: &Camera, angle: f64) -> Camera {
    Camera { rotation: DMat3::from_rotation_y(angle) * camera.rotation, ..camera.clone() }
}

/// `rgb` of `from` as seen from `to`, which has the same centre: bilinear, `None` outside. `[H,W]` of three channels.
fn warped(rgb: &[f64], from: &Camera, to: &Camera) -> Vec<Option<[f64; 3]>> {
    let [width, height] = [from.width as usize, from.height as usize];
    let turn = from.rotation * to.rotation.transpose();
    let sample = |x: f64, y: f64| {
        let (left, top) = (x.floor(), y.floor());
        if left < 0.0 || top < 0.0 || left + 1.0 >= width as f64 || top + 1.0 >= height as f64 {
            return None;
        }
        let (fx, fy) = (x - left, y - top);
        let at = |dx: usize, dy: usize, c: usize| rgb[3 * ((top as usize + dy) * width + left as usize + dx) + c];
        Some(std::array::from_fn(|c| {
            (1.0 - fy) * ((1.0 - fx) * at(0, 0, c) + fx * at(1, 0, c))
                + fy * ((1.0 - fx) * at(0, 1, c) + fx * at(1, 1, c))
        }))
    };
    let mut out = Vec::with_capacity(width * height);
    for y in 0..to.height {
        for x in 0..to.width {
            let ray = DVec3::new((f64::from(x) + 0.5 - to.cx) / to.fx, (f64::from(y) + 0.5 - to.cy) / to.fy, 1.0);
            let p = turn * ray;
            out.push(sample(from.fx * p.x / p.z + from.cx - 0.5, from.fy * p.y / p.z + from.cy - 0.5));
        }
    }
    out
}

/// Mean and largest difference between a frame and the one before it, warped.
fn jump(before: &[f64], after: &[f64], from: &Camera, to: &Camera) -> (f64, f64) {
    let (mut sum, mut count, mut most) = (0.0, 0.0, 0.0_f64);
    for (expected, found) in warped(before, from, to).into_iter().zip(after.chunks_exact(3)) {
        let Some(expected) = expected else { continue };
        for (a, b) in expected.iter().zip(found) {
            let d = (a - b).abs();
            (sum, count, most) = (sum + d, count + 1.0, most.max(d));
        }
    }
    (sum / f64::max(count, 1.0), most)
}

fn judge_popping(context: &Context<'_>) -> Result<Outcome> {
    let scene = random_scene(3000, 181, 1);
    let options = usual_options();
    let first = views::camera(128, 96);
    let cameras: Vec<Camera> = (0..FRAMES).map(|i| turned(&first, TURN * (f64::from(i) - 4.0))).collect();
    let mut renderer = Renderer::new(context.gpu, &scene, &options)?;
    let (mut device, mut truth) = (Vec::new(), Vec::new());
    for camera in &cameras {
        device.push(renderer.render(camera, 0.0)?.rgb().collect::<Vec<f64>>());
        truth.push(reference::render(&scene, camera, 0.0, &reference_options(&options))?.rgb);
    }
    let (mut worst, mut mean, mut most) = (0.0_f64, 0.0, 0.0_f64);
    for i in 1..cameras.len() {
        let (a, _) = jump(&device[i - 1], &device[i], &cameras[i - 1], &cameras[i]);
        let (b, largest) = jump(&truth[i - 1], &truth[i], &cameras[i - 1], &cameras[i]);
        worst = worst.max((a - b).abs());
        mean += b / (cameras.len() - 1) as f64;
        most = most.max(largest);
    }
    Ok(Outcome {
        truth: format!(
            "warped neighbours differ by {mean:.4} on average: sorting by centre pops, and the warp interpolates"
        ),
        checks: vec![
            Check::at_most("mean jump between frames, device − truth", worst, 1.0e-4),
            Check::shown("mean jump between frames", mean),
            Check::shown("largest jump between frames", most),
        ],
    })
}

/// The even superpoints of a moving scene do not move.
fn half_still() -> Scene {
    let mut scene = moving_scene(2000, 8, 9, 191, false);
    if let Some(motion) = &mut scene.motion {
        for at in (0..motion.rotation.len()).filter(|at| at % 8 % 2 == 0) {
            (motion.rotation[at], motion.translation[at]) = ([0.0; 3], [0.0; 3]);
        }
    }
    scene
}

fn judge_flicker(context: &Context<'_>) -> Result<Outcome> {
    let (scene, options, camera) = (half_still(), usual_options(), views::camera(128, 96));
    let mut renderer = Renderer::new(context.gpu, &scene, &options)?;
    let (mut device, mut truth): (Vec<Image>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
    for i in 0..FRAMES {
        let time = f64::from(i) / f64::from(FRAMES - 1);
        device.push(renderer.render(&camera, time)?);
        truth.push(reference::render(&scene, &camera, time, &reference_options(&options))?.rgb);
    }
    let pixels = camera.width as usize * camera.height as usize;
    let still = |p: &usize| truth.iter().all(|t| (0..3).all(|c| (t[3 * p + c] - truth[0][3 * p + c]).abs() < 1.0e-12));
    let painted = |p: &usize| (0..3).any(|c| truth[0][3 * p + c] != f64::from(options.background[c]));
    let static_pixels: Vec<usize> = (0..pixels).filter(|p| still(p) && painted(p)).collect();
    let mut most = 0.0_f64;
    for &p in &static_pixels {
        for image in &device {
            for c in 0..3 {
                most = most.max(f64::from((image.rgba[4 * p + c] - device[0].rgba[4 * p + c]).abs()));
            }
        }
    }
    Ok(Outcome {
        truth: format!("{} of {pixels} pixels show something and do not change", static_pixels.len()),
        checks: vec![
            Check::at_most("largest change of such a pixel", most, 0.0),
            Check::at_least("such pixels", static_pixels.len() as f64, 100.0),
        ],
    })
}
