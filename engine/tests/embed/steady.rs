//! Thousands of frames: nothing is allocated, on the host or on the device, and an embedded frame costs what the engine's
//! own does.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::Instant;

use engine::gpu::{Gpu, GpuOptions};
use engine::render::display::{DisplayMode, DisplayOptions, Screen};
use engine::render::{
    PixelFormat, Quality, RenderOptions, Renderer, SceneHandle, SceneOptions, Target, View, ViewOptions,
};
use engine::scene::Scene;
use engine::scene::synthetic::{demo_camera, demo_scene, moving_scene};

use super::*;

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|n| n.set(n.get() + 1));
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Resident memory of this process, bytes.
fn resident() -> u64 {
    let own = sysinfo::get_current_pid().unwrap();
    let mut system = sysinfo::System::new();
    let what = sysinfo::ProcessRefreshKind::nothing().with_memory();
    system.refresh_processes_specifics(sysinfo::ProcessesToUpdate::Some(&[own]), false, what);
    system.process(own).unwrap().memory()
}

/// Draws `count` frames after some of warming up, with the colour image copied or stored to. The engine allocates nothing in them; resident memory grows by at most
/// `slack` bytes.
fn draw_many(count: u32, storage: bool, slack: u64) {
    let host = Host::new();
    let camera = demo_camera(0.0, 64, 48);
    // Small, so that many frames take little time; it moves.
    let scene = moving_scene(500, 8, 5, 3, false);
    let handle = SceneHandle::upload(host.gpu(), &scene, &SceneOptions::default()).unwrap();
    let options = ViewOptions { depth: true, storage, ..ViewOptions::default() };
    let mut view = View::new(host.gpu(), &handle, &options).unwrap();
    view.warm_up(&camera, 0.0).unwrap();
    let color = host.picture([64, 48], vk::Format::R8G8B8A8_UNORM);
    let depth = host.picture([64, 48], vk::Format::R32_SFLOAT);
    let frames = [(); 2].map(|()| host.vulkan.frame().unwrap());
    let image = if storage { to_store(color) } else { to_read(color) };
    let target = Target { color: image, depth: Some(to_read(depth)) };
    let (mut allocations, mut before) = (0, (0, 0, 0));
    let warm = count / 10;
    for i in 0..warm + count {
        if i == warm {
            before = (resident(), host.gpu().memory_used().0, host.gpu().buffer_count());
        }
        let frame = frames[i as usize % 2];
        host.vulkan.begin(frame).unwrap();
        let commands = commands_of(frame);
        let start = ALLOCATIONS.with(Cell::get);
        view.record(&commands, &camera, f64::from(i % 100) / 100.0, &target).unwrap();
        allocations += ALLOCATIONS.with(Cell::get) - start;
        host.vulkan.submit(frame).unwrap();
        if i == warm {
            allocations = 0;
        }
    }
    frames.into_iter().for_each(|f| host.vulkan.wait(f).unwrap());
    let after = (resident(), host.gpu().memory_used().0, host.gpu().buffer_count());
    println!(
        "{count} frames, storage {storage}: {allocations} allocations in record; resident memory {} -> {} KiB",
        before.0 >> 10,
        after.0 >> 10
    );
    // What the loader and the driver allocate for commands is theirs; the validation layer's is not counted at all.
    assert_eq!(allocations, 0);
    assert_eq!((before.1, before.2), (after.1, after.2), "device memory");
    if host.vulkan.validates() {
        println!("resident memory is not judged: the validation layer keeps books");
    } else {
        assert!(after.0 <= before.0 + slack, "resident memory grew from {} to {} bytes", before.0, after.0);
    }
    drop(view);
    [color, depth].into_iter().for_each(|p| host.vulkan.destroy(p));
    frames.into_iter().for_each(|f| host.vulkan.destroy_frame(f));
}

#[test]
fn frames_allocate_nothing() {
    [false, true].into_iter().for_each(|storage| draw_many(200, storage, 4 << 20));
}

/// `cargo test -p spgs-engine --test embed -- --ignored --nocapture ten_thousand`
#[test]
#[ignore = "minutes"]
fn ten_thousand_frames_keep_memory_flat() {
    [false, true].into_iter().for_each(|storage| draw_many(10_000, storage, 4 << 20));
}

/// A program that draws fewer pixels while something moves changes the resolution from frame to frame: pictures are those of a
/// renderer that never drew another size, and nothing is allocated once the largest was drawn.
#[test]
fn another_resolution_allocates_nothing_and_changes_no_pixel() {
    let gpu = Gpu::open(&GpuOptions { pipeline_cache: false, ..GpuOptions::default() }).unwrap();
    let (scene, camera) = (moving_scene(500, 8, 5, 3, false), demo_camera(0.0, 100, 75));
    let options = RenderOptions { depth: true, ..RenderOptions::default() };
    let mut renderer = Renderer::new(&gpu, &scene, &options).unwrap();
    let mut screen = Screen::new(&gpu).unwrap();
    let display = DisplayOptions {
        mode: DisplayMode::Color,
        size: [100, 75],
        bgra: false,
        depth_range: [0.0, 9.0],
        tile_range: 100.0,
    };
    let mut draw = |renderer: &mut Renderer, share: f32| {
        renderer.set_resolution(share);
        let frame = renderer.submit(&camera, 0.25).unwrap();
        screen.submit(renderer, frame, &display).unwrap();
        assert!(renderer.finish(frame).unwrap().is_some());
        frame
    };
    let full = draw(&mut renderer, 1.0);
    let whole = renderer.read(full).unwrap();
    for _ in 0..4 {
        draw(&mut renderer, 1.0);
    }
    let before = (gpu.memory_used().0, gpu.buffer_count());
    let start = ALLOCATIONS.with(Cell::get);
    for share in [0.5, 0.875, 1.0, 0.625, 0.25, 1.0, 1.0, 0.3, 0.3, 0.7] {
        draw(&mut renderer, share);
    }
    assert_eq!(ALLOCATIONS.with(Cell::get) - start, 0);
    assert_eq!(before, (gpu.memory_used().0, gpu.buffer_count()), "device memory");

    for share in [0.5, 0.875, 1.0, 0.33] {
        let frame = draw(&mut renderer, share);
        let shown = renderer.read(frame).unwrap();
        let own = RenderOptions { quality: Quality { resolution: share, ..Quality::EXACT }, ..options.clone() };
        let mut fresh = Renderer::new(&gpu, &scene, &own).unwrap();
        let expected = fresh.render(&camera, 0.25).unwrap();
        assert_eq!((shown.width, shown.height), (100, 75));
        assert!(shown.rgba == expected.rgba && shown.depth == expected.depth, "resolution {share}");
        assert_eq!(renderer.rendered_size(), fresh.rendered_size());
        assert_eq!(shown.rgba == whole.rgba, share == 1.0, "resolution {share}");
    }
}

/// Time of an embedded frame against the engine's own on the same device, frames one at a time and in turns: of the engine's
/// benchmark scene where `SPGS_DATA` is set, and of the demo's, whose frames are short. Runs without validation:
/// `cargo test --release -p spgs-engine --test embed -- --ignored --nocapture costs`
#[test]
#[ignore = "a measurement"]
fn an_embedded_frame_costs_what_the_engines_own_does() {
    let host = Host::new();
    let number = |name: &str, default: u32| std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default);
    let (size, frames) = ([number("WIDTH", 640), number("HEIGHT", 480)], number("FRAMES", 60));
    match std::env::var_os("SPGS_DATA").map(|data| std::path::PathBuf::from(data).join("bench_s50k")) {
        Some(folder) => {
            let scene = engine::file::load(&folder.join("model.ply")).unwrap();
            let cameras = engine::data::load_cameras(&folder, Some("train"), None).unwrap().cameras;
            compare_costs(&host, "bench_s50k", &scene.scene, &cameras[0], frames);
        }
        None => println!("SKIPPED bench_s50k: SPGS_DATA is not set"),
    }
    compare_costs(&host, "demo", &demo_scene(), &demo_camera(0.0, size[0], size[1]), frames);
}

fn compare_costs(host: &Host, name: &str, scene: &Scene, camera: &Camera, frames: u32) {
    let options = GpuOptions { pipeline_cache: false, breadcrumbs: false, ..GpuOptions::default() };
    let own = Gpu::open(&options).unwrap();
    let mut renderer = Renderer::new(&own, scene, &RenderOptions::default()).unwrap();
    let handle = SceneHandle::upload(host.gpu(), scene, &SceneOptions::default()).unwrap();
    let frame = host.vulkan.frame().unwrap();
    let size = [camera.width, camera.height];
    let formats = [PixelFormat::Rgba8, PixelFormat::Rgba16F, PixelFormat::Rgba32F];
    for (format, storage) in formats.into_iter().flat_map(|f| [(f, false), (f, true)]) {
        let options = ViewOptions { format, storage, in_flight: 1, ..ViewOptions::default() };
        let mut view = View::new(host.gpu(), &handle, &options).unwrap();
        view.warm_up(camera, 0.0).unwrap();
        let color = host.picture(size, vk_format(format));
        let target = Target { color: if storage { to_store(color) } else { to_read(color) }, depth: None };
        let mut times = [Vec::new(), Vec::new()];
        for i in 0..frames + 5 {
            let time = f64::from(i) / f64::from(frames);
            // Whoever comes second finds other caches: they take turns.
            for which in [i as usize % 2, 1 - i as usize % 2] {
                let start = Instant::now();
                if which == 0 {
                    renderer.draw(camera, time).unwrap();
                } else {
                    submit(host, frame, &mut view, camera, time, &target);
                    host.vulkan.wait(frame).unwrap();
                }
                if i >= 5 {
                    times[which].push(start.elapsed().as_secs_f64() * 1e3);
                }
            }
        }
        let mut more: Vec<f64> = times[0].iter().zip(&times[1]).map(|(own, its)| 100.0 * (its / own - 1.0)).collect();
        more.sort_by(f64::total_cmp);
        // Standard error of a median, from the quartiles of what is about normal.
        let error = 1.25 * 0.74 * (more[more.len() * 3 / 4] - more[more.len() / 4]) / (more.len() as f64).sqrt();
        let [own, its] = times.map(median);
        let (way, [width, height]) = (if storage { "stored" } else { "copied" }, size);
        println!(
            "{name} {width}x{height} {format:?} {way}: own {own:.3} ms, embedded {its:.3} ms; frame by frame {:+.1} % ± {error:.1}",
            median(more),
        );
        drop(view);
        host.vulkan.destroy(color);
    }
    host.vulkan.destroy_frame(frame);
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
