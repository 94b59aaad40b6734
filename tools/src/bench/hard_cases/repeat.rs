//! Case 16: the same bits on every run.

use engine::error::Result;
use engine::image::Image;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{demo_camera, demo_scene, moving_scene};

use super::case::{Case, Check, Context, Outcome};
use super::gradients::View;

pub(super) fn cases() -> Vec<Case> {
    let image = "The demo scene at 160×120, a new renderer every time.";
    let flight = "The demo scene with two frames in flight, 40 frames to and fro in time.";
    let gradient = "Gradients of 600 moving Gaussians, from the beginning every time.";
    vec![
        Case::new(16, "same_image", image, judge_image),
        Case::new(16, "same_image_in_flight", flight, judge_flight),
        Case::new(16, "same_gradients", gradient, judge_gradients),
    ]
}

/// FNV-1a over bits.
pub(super) fn hash(words: impl Iterator<Item = u32>) -> u64 {
    words.fold(0xCBF2_9CE4_8422_2325, |h, w| (h ^ u64::from(w)).wrapping_mul(0x0000_0100_0000_01B3))
}

/// Of the bits of an image and its depth.
pub(super) fn hash_image(image: &Image) -> u64 {
    hash(image.rgba.iter().chain(&image.depth).map(|v| v.to_bits()))
}

fn judged(truth: &str, hashes: &[u64]) -> Outcome {
    let other = hashes.iter().filter(|h| **h != hashes[0]).count();
    Outcome {
        truth: truth.into(),
        checks: vec![
            Check::exactly("runs with other bits", other, 0),
            Check::at_least("runs", hashes.len() as f64, 2.0),
        ],
    }
}

fn judge_image(context: &Context<'_>) -> Result<Outcome> {
    let scene = demo_scene();
    let options = RenderOptions { depth: true, ..RenderOptions::default() };
    let render = |_| {
        let mut renderer = Renderer::new(context.gpu, &scene, &options)?;
        Ok(hash_image(&renderer.render(&demo_camera(0.3, 160, 120), 0.3)?))
    };
    let hashes = (0..context.runs.max(2)).map(render).collect::<Result<Vec<u64>>>()?;
    Ok(judged("one image; compare `bits` of the JSON between devices", &hashes))
}

fn judge_flight(context: &Context<'_>) -> Result<Outcome> {
    let mut renderer = Renderer::new(context.gpu, &demo_scene(), &RenderOptions::default())?;
    // The largest frame first, so that no later one grows the buffers.
    let time = |i: u32| f64::from(i % 4) * 0.25;
    let mut by_time = [Vec::new(), Vec::new(), Vec::new(), Vec::new()];
    for i in 0..4 {
        renderer.draw(&demo_camera(time(i), 160, 120), time(i))?;
    }
    let mut pending = None;
    for i in 0..40 {
        let next = (i, renderer.submit(&demo_camera(time(i), 160, 120), time(i))?);
        if let Some((at, frame)) = pending.replace(next)
            && renderer.finish(frame)?.is_some()
        {
            by_time[at as usize % 4].push(hash_image(&renderer.read(frame)?));
        }
    }
    let other: usize = by_time.iter().map(|h| h.iter().filter(|x| **x != h[0]).count()).sum();
    let frames: usize = by_time.iter().map(Vec::len).sum();
    Ok(Outcome {
        truth: "a frame does not depend on the one before it or beside it".into(),
        checks: vec![Check::exactly("frames with other bits", other, 0), Check::exactly("frames compared", frames, 39)],
    })
}

fn judge_gradients(context: &Context<'_>) -> Result<Outcome> {
    let view = View::usual(moving_scene(600, 12, 2, 161, false));
    let run = |_| {
        let g = view.on_device(context.gpu)?;
        let all = [g.mean.as_flattened(), g.rotation.as_flattened(), g.log_scale.as_flattened()];
        let rest = [&g.opacity_logit[..], &g.sh[..], g.mean2d.as_flattened(), g.pose.as_flattened()];
        Ok(hash(all.into_iter().chain(rest).flatten().map(|v| v.to_bits())))
    };
    let hashes = (0..context.runs.max(2)).map(run).collect::<Result<Vec<u64>>>()?;
    Ok(judged("sums in a fixed order: one gradient", &hashes))
}
