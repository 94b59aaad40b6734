//! `spgs demo`: a built-in moving scene, pictures, frame rate and kernel times; needs no arguments and no data.

use engine::error::Result;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{DEMO_BACKGROUND, demo_camera, demo_scene};
use serde_json::json;

use crate::cli::args::{DemoArgs, Format, Global};
use crate::cli::{gpu_session, model, output, progress};
use crate::report::files::create_folder;
use crate::report::measure::{self, Plan};
use crate::report::summary;

const WIDTH: u32 = 800;
const HEIGHT: u32 = 800;
/// Measured frames on a GPU and on a CPU device, where a frame takes a thousand times as long.
const FRAMES: [u32; 2] = [500, 12];

/// Renders the demo.
pub fn run(args: &DemoArgs, global: &Global) -> Result<()> {
    let gpu = gpu_session::open(global)?;
    let scene = demo_scene();
    let say = !global.quiet && !args.json;
    if say {
        output::line(&format!("device  {}", gpu_session::describe(&gpu)));
        output::line(&format!("scene   {}, {WIDTH}x{HEIGHT} pixels", model::describe(&scene)));
    }
    let options = RenderOptions { background: DEMO_BACKGROUND, ..RenderOptions::default() };
    create_folder(&args.out)?;
    let mut renderer = Renderer::new(&gpu, &scene, &options)?;
    let bar = progress::bar(args.frames.into(), global.quiet);
    for i in 0..args.frames {
        let time = f64::from(i) / f64::from(args.frames.max(2) - 1);
        let image = renderer.render(&demo_camera(time, WIDTH, HEIGHT), time)?;
        Format::Png.write(&args.out.join(format!("{i:05}.png")), &image)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    drop(renderer);
    let frames = FRAMES[usize::from(gpu.info().is_cpu())];
    let camera = demo_camera(0.0, WIDTH, HEIGHT);
    let plan = Plan { camera, times: [0.0, 1.0], frames, warmup: 3, paper_protocol: false };
    let bar = progress::bar(plan.ticks(), global.quiet);
    let measured = measure::measure(&gpu, &scene, &options, &plan, &|| bar.inc(1))?;
    bar.finish_and_clear();
    gpu_session::report_validation(&gpu);
    if args.json {
        return output::json(&json!({
            "device": gpu.info(),
            "pictures": args.out,
            "picture_count": args.frames,
            "width": WIDTH,
            "height": HEIGHT,
            "measurement": measured,
        }));
    }
    if say {
        output::line(summary::text(&measured).trim_end());
        output::line(&format!("{} images are in {}", args.frames, args.out.display()));
    }
    Ok(())
}
