//! `spgs render`: pictures of a model along a camera file or a path, and videos.

mod plan;
mod video;

use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Instant;

use engine::confidence::Evidence;
use engine::data::CameraSet;
use engine::error::{Error, Result};
use engine::image::Image;
use engine::render::{RenderOptions, Renderer};
use serde::Serialize;
use serde_json::json;

use crate::cli::args::{Format, Global, PathArg, RenderArgs};
use crate::cli::interrupt::{self, Interrupt};
use crate::cli::{camera, gpu_session, model, output, progress};
use crate::report::average::{Mean, reduced};
use crate::report::error_image;
use crate::report::files::create_folder;
use plan::Picture;
use video::Encoder;

/// One written picture.
#[derive(Debug, Serialize)]
struct FrameSummary {
    index: usize,
    name: String,
    /// The picture's file; none in a video.
    file: Option<PathBuf>,
    time: f64,
    width: u32,
    height: u32,
    /// Host time from submission to the image in host memory, all sub-frames, milliseconds.
    render_ms: f64,
}

/// Where the pictures go.
#[derive(Debug)]
struct Places {
    folder: Option<PathBuf>,
    /// The encoder's program and the file.
    video: Option<(PathBuf, PathBuf)>,
}

/// Renders and writes the pictures.
pub fn run(args: &RenderArgs, global: &Global) -> Result<()> {
    if let Some(path) = &args.video {
        video::check(path)?;
    }
    if args.cameras.is_none() && args.path.is_none() {
        return Err(no_cameras());
    }
    let loaded = model::load_level(&args.model, args.level)?;
    let set = cameras(args)?;
    let pictures = match (&args.path, &set) {
        (Some(kind), set) => plan::of_path(args, kind, set.as_ref(), &loaded.scene)?,
        (None, Some(set)) => plan::of_views(args, set)?,
        (None, None) => return Err(no_cameras()),
    };
    if args.video.is_some() {
        video::one_size(&pictures)?;
    }
    let own = if set.is_none() { camera::near(&loaded.scene) } else { RenderOptions::default().near };
    let gpu = gpu_session::open(global)?;
    let options = RenderOptions {
        background: args.look.background,
        depth: args.format == Format::Exr,
        near: args.near.unwrap_or(own),
        motion: args.look.motion_source(),
        quality: args.quality.chosen(),
        ..RenderOptions::default()
    };
    let mut renderer = match &args.confidence {
        Some(path) => {
            let (scene, options) = Evidence::read(path, &loaded.scene)?.scene(&loaded.scene, &options)?;
            Renderer::new(&gpu, &scene, &options)?
        }
        None => Renderer::new(&gpu, &loaded.scene, &options)?,
    };
    let places = places(args);
    if let Some(folder) = &places.folder {
        create_folder(folder)?;
    }
    if let Some(parent) = places.video.as_ref().and_then(|(_, file)| file.parent()) {
        create_folder(parent)?;
    }
    let bar = progress::bar(pictures.len() as u64, global.quiet);
    let start = Instant::now();
    let mut summaries = Vec::with_capacity(pictures.len());
    let mut encoder = None;
    // Pictures are there whole or not at all; an unfinished video must be taken away.
    let interrupt = match places.video {
        Some(_) => Interrupt::watch("Ctrl-C will leave an unfinished video"),
        None => Interrupt::default(),
    };
    for picture in &pictures {
        let begin = Instant::now();
        let image = draw(&mut renderer, picture, args.supersample)?;
        let render_ms = begin.elapsed().as_secs_f64() * 1e3;
        let file = places.folder.as_ref().map(|f| f.join(format!("{:05}.{}", picture.index, args.format.extension())));
        if let Some(file) = &file {
            match args.format {
                Format::Exr => args.format.write(file, &image)?,
                Format::Png => args.format.write(file, &in_8_bits(args, &image))?,
            }
        }
        if interrupt.is_set() {
            break;
        }
        if let Some((program, path)) = &places.video {
            let size = [image.width, image.height];
            let encoder = match &mut encoder {
                Some(running) => running,
                none => none.insert(Encoder::start(program, path, size, args.fps)?),
            };
            match encoder.add(&in_8_bits(args, &image)) {
                // The encoder hears of it as well.
                Err(_) if interrupt.is_set() => break,
                added => added?,
            }
        }
        summaries.push(summary(picture, file, &image, render_ms));
        bar.inc(1);
    }
    if interrupt.is_set() {
        drop(encoder);
        bar.finish_and_clear();
        output::error_line("spgs: interrupted; no video is written");
        std::process::exit(interrupt::CODE);
    }
    encoder.map_or(Ok(()), Encoder::finish)?;
    bar.finish_and_clear();
    let seconds = start.elapsed().as_secs_f64();
    gpu_session::report_validation(&gpu);
    let video = places.video.as_ref().map(|(_, file)| file);
    if args.json {
        return output::json(&json!({
            "model": args.model,
            "cameras": set.map(|s| s.source),
            "device": gpu.info().name,
            "gaussians": loaded.scene.gaussians.len(),
            "rejected": loaded.rejected,
            "seconds": seconds,
            "video": video,
            "frames": summaries,
        }));
    }
    if !global.quiet {
        let each = summaries.iter().map(|s| s.render_ms).sum::<f64>() / summaries.len().max(1) as f64;
        let files: Vec<String> = places.folder.iter().chain(video).map(|p| p.display().to_string()).collect();
        output::line(&format!(
            "{} images in {} ({seconds:.1} s; {each:.1} ms to render and read back each) on {}",
            summaries.len(),
            files.join(" and "),
            gpu_session::describe(&gpu)
        ));
    }
    Ok(())
}

fn summary(picture: &Picture, file: Option<PathBuf>, image: &Image, render_ms: f64) -> FrameSummary {
    let Picture { index, name, views } = picture;
    // Of the sub-frames, the middle.
    let time = views.iter().map(|(_, t)| t).sum::<f64>() / views.len().max(1) as f64;
    FrameSummary { index: *index, name: name.clone(), file, time, width: image.width, height: image.height, render_ms }
}

fn no_cameras() -> Error {
    let expected = "--cameras FILE|DATA, or --path turntable, time or FILE";
    Error::usage("cameras", "neither --cameras nor --path", expected)
}

/// The views of `--cameras`, or of the recorded path.
fn cameras(args: &RenderArgs) -> Result<Option<CameraSet>> {
    let file = match &args.path {
        Some(PathArg::File(file)) if args.cameras.is_some() => {
            let found = format!("--path {} and --cameras", file.display());
            return Err(Error::usage("cameras", found, "one of them"));
        }
        Some(PathArg::File(file)) => Some(file),
        _ => args.cameras.as_ref(),
    };
    file.map(|f| model::load_cameras(f, args.split.as_deref(), args.size.asked())).transpose()
}

/// Where things go; without an encoder the pictures take the video's place, and a line says so.
fn places(args: &RenderArgs) -> Places {
    let Some(file) = &args.video else { return Places { folder: args.out.clone(), video: None } };
    match video::encoder() {
        Some(program) => Places { folder: args.out.clone(), video: Some((program, file.clone())) },
        None => {
            let folder = args.out.clone().unwrap_or_else(|| file.with_extension(""));
            let shown = (file.display(), folder.display());
            log::warn!("ffmpeg is not installed: instead of {} there are numbered images in {}", shown.0, shown.1);
            Places { folder: Some(folder), video: None }
        }
    }
}

/// The image as 8 bits show it: expected errors are as bright as other errors are, and opaque, as the background has one too.
fn in_8_bits<'a>(args: &RenderArgs, image: &'a Image) -> Cow<'a, Image> {
    if args.confidence.is_none() {
        return Cow::Borrowed(image);
    }
    let error: Vec<f32> = image.rgba.chunks_exact(4).map(|p| p[0]).collect();
    Cow::Owned(error_image::gained(&error, [image.width, image.height]))
}

/// Draws a picture: the mean of its sub-frames, each the mean of its samples.
fn draw(renderer: &mut Renderer, picture: &Picture, supersample: u32) -> Result<Image> {
    let mut mean = Mean::default();
    for (camera, time) in &picture.views {
        let image = if supersample > 1 {
            let side = |s: u32| s.saturating_mul(supersample);
            renderer.render(&camera.resized(side(camera.width), side(camera.height)), *time)?
        } else {
            renderer.render(camera, *time)?
        };
        mean.add(reduced(image, supersample));
    }
    Ok(mean.finish())
}
