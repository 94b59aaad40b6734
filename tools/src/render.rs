//! `spgs render`: pictures of a model along a camera file.

use std::path::{Path, PathBuf};
use std::time::Instant;

use engine::error::{Error, Result};
use engine::file::picture::{self, Alpha};
use engine::image::Image;
use engine::render::{RenderOptions, Renderer};
use serde::Serialize;
use serde_json::json;

use crate::args::{Format, Global, RenderArgs};
use crate::{gpu_session, model, output, progress};

/// One written picture.
#[derive(Debug, Serialize)]
struct FrameSummary {
    index: usize,
    name: String,
    file: PathBuf,
    time: f64,
    width: u32,
    height: u32,
    /// Host time from submission to the image in host memory, milliseconds.
    render_ms: f64,
}

/// Renders and writes the pictures.
pub fn run(args: &RenderArgs, global: &Global) -> Result<()> {
    let loaded = model::load(&args.model)?;
    let set = model::load_cameras(&args.cameras, args.split.as_deref(), [args.view.width, args.view.height])?;
    let frames: Vec<usize> =
        if args.frames.is_empty() { (0..set.cameras.len()).collect() } else { args.frames.clone() };
    for &index in &frames {
        model::camera(&set, index)?;
    }
    let gpu = gpu_session::open(global)?;
    let options = RenderOptions {
        background: args.view.background,
        depth: args.format == Format::Exr,
        motion: args.view.motion_source(),
        quality: args.view.quality(),
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(&gpu, &loaded.scene, &options)?;
    create_folder(&args.out)?;
    let bar = progress::bar(frames.len() as u64, global.quiet);
    let start = Instant::now();
    let mut summaries = Vec::with_capacity(frames.len());
    for &index in &frames {
        let camera = model::camera(&set, index)?;
        let time = args.time.unwrap_or(camera.time);
        let begin = Instant::now();
        let image = renderer.render(camera, time)?;
        let render_ms = begin.elapsed().as_secs_f64() * 1e3;
        let file = args.out.join(format!("{index:05}.{}", args.format.extension()));
        write(&file, &image, args.format)?;
        let (width, height, name) = (camera.width, camera.height, camera.name.clone());
        summaries.push(FrameSummary { index, name, file, time, width, height, render_ms });
        bar.inc(1);
    }
    bar.finish_and_clear();
    let seconds = start.elapsed().as_secs_f64();
    gpu_session::report_validation(&gpu);
    if args.json {
        return output::json(&json!({
            "model": args.model,
            "cameras": set.source,
            "device": gpu.info().name,
            "gaussians": loaded.scene.gaussians.len(),
            "rejected": loaded.rejected,
            "seconds": seconds,
            "frames": summaries,
        }));
    }
    if !global.quiet {
        let each = summaries.iter().map(|s| s.render_ms).sum::<f64>() / summaries.len().max(1) as f64;
        output::line(&format!(
            "{} pictures in {} ({seconds:.1} s; {each:.1} ms to render and read back each) on {}",
            summaries.len(),
            args.out.display(),
            gpu_session::describe(&gpu)
        ));
    }
    Ok(())
}

/// Makes a folder and those above it.
pub fn create_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "make folder", e))
}

/// Writes a picture; the file is there whole or not at all.
pub fn write(path: &Path, image: &Image, format: Format) -> Result<()> {
    match format {
        Format::Png => picture::write_png(path, image, Alpha::Drop),
        Format::Exr => picture::write_exr(path, image),
    }
}
