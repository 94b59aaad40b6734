//! Cases 18 and 19: popping between frames of a turning camera, and flicker of pixels that stand still.

use engine::error::Result;
use engine::image::Image;
use engine::metrics::flicker::flicker;
use engine::metrics::{PIXELS_PER_DEGREE, Planes, Weights, flip};
use engine::reference;
use engine::render::Renderer;
use engine::scene::synthetic::{moving_scene, random_scene};
use engine::scene::{Camera, Scene};
use glam::{DMat3, DVec3};

use super::case::{Case, Check, Context, Outcome};
use super::compare::{reference_options, usual_options};
use super::views;

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

/// Mean FLIP between a frame and an earlier one, warped; what the warp does not reach is the same on both sides.
fn jump(before: &[f64], after: &[f64], from: &Camera, to: &Camera) -> Result<f64> {
    let (width, height) = (to.width as usize, to.height as usize);
    let black = || Planes { width, height, rgb: [0, 1, 2].map(|_| vec![0.0; width * height]) };
    let (mut expected, mut found, mut seen) = (black(), black(), vec![0.0; width * height]);
    for (p, color) in warped(before, from, to).into_iter().enumerate() {
        let Some(color) = color else { continue };
        seen[p] = 1.0;
        for c in 0..3 {
            expected.rgb[c][p] = color[c].clamp(0.0, 1.0);
            found.rgb[c][p] = after[3 * p + c].clamp(0.0, 1.0);
        }
    }
    Ok(flip(&expected, &found, PIXELS_PER_DEGREE)?.mean(Some(&Weights::new(seen, [width, height])?)))
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
    // FLIP between neighbours and between frames that are seven apart, as StopThePop measures it.
    let mean = |images: &[Vec<f64>], apart: usize| -> Result<f64> {
        let pairs = cameras.len() - apart;
        let jumps = (0..pairs).map(|i| jump(&images[i], &images[i + apart], &cameras[i], &cameras[i + apart]));
        Ok(jumps.sum::<Result<f64>>()? / pairs as f64)
    };
    let [near, far] = [mean(&truth, 1)?, mean(&truth, 7)?];
    let [device_near, device_far] = [mean(&device, 1)?, mean(&device, 7)?];
    Ok(Outcome {
        truth: format!(
            "FLIP {near:.4} between warped neighbours, {far:.4} over seven frames: the method's, and the warp's"
        ),
        checks: vec![
            Check::at_most("FLIP of neighbours, device − truth", (device_near - near).abs(), 1.0e-4),
            Check::at_most("FLIP over seven frames, device − truth", (device_far - far).abs(), 1.0e-4),
            Check::shown("FLIP of warped neighbours", near),
            Check::shown("FLIP of warped frames, seven apart", far),
        ],
    })
}

/// The even superpoints of a moving scene do not move.
fn half_still() -> Scene {
    let mut scene = moving_scene(2000, 8, 9, 191, false);
    if let Some(motion) = scene.deformation.table_mut() {
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
    let static_pixels = (0..pixels).filter(|p| still(p) && painted(p)).count();
    let planes = |rgb: &[f64]| Planes {
        width: camera.width as usize,
        height: camera.height as usize,
        rgb: [0, 1, 2].map(|c| rgb.iter().skip(c).step_by(3).copied().collect()),
    };
    let exact: Vec<Planes> = truth.iter().map(|t| planes(t)).collect();
    let found: Vec<Planes> = device.iter().map(|d| planes(&d.rgb().collect::<Vec<f64>>())).collect();
    let flicker = flicker(&exact, &found, 1.0e-12)?;
    Ok(Outcome {
        truth: format!("{static_pixels} of {pixels} pixels show something and do not change"),
        checks: vec![
            Check::at_most("largest change of a static pixel", flicker.max, 0.0),
            Check::at_least("static pixels that show something", static_pixels as f64, 100.0),
        ],
    })
}
