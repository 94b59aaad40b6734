//! Thousands of frames: nothing is allocated, on the host or on the device, and an embedded frame costs what the engine's
//! own does.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::Instant;

use engine::gpu::GpuOptions;
use engine::render::{PixelFormat, RenderOptions, Renderer, SceneHandle, SceneOptions, Target, View, ViewOptions};
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
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    text.split_whitespace().nth(1).and_then(|n| n.parse::<u64>().ok()).unwrap_or(0) * 4096
}

/// Processor time of all threads of this process, ms: the steadier measure where the device is the CPU and others use it.
fn processor_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // After the name in parentheses: utime and stime are the 12th and 13th field, in 1/100 s.
    let fields: Vec<&str> = text.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    10.0 * (ticks(11) + ticks(12))
}

/// Draws `count` frames after some of warming up. The engine allocates nothing in them; resident memory grows by at most
/// `slack` bytes.
fn draw_many(count: u32, slack: u64) {
    let host = Host::new();
    let camera = demo_camera(0.0, 64, 48);
    // Small, so that many frames take little time; it moves.
    let scene = moving_scene(500, 8, 5, 3, false);
    let handle = SceneHandle::upload(host.gpu(), &scene, &SceneOptions::default()).unwrap();
    let mut view = View::new(host.gpu(), &handle, &ViewOptions { depth: true, ..ViewOptions::default() }).unwrap();
    view.warm_up(&camera, 0.0).unwrap();
    let color = host.picture([64, 48], vk::Format::R8G8B8A8_UNORM);
    let depth = host.picture([64, 48], vk::Format::R32_SFLOAT);
    let frames = [(); 2].map(|()| host.vulkan.frame().unwrap());
    let target = Target { color: to_read(color), depth: Some(to_read(depth)) };
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
        "{count} frames: {allocations} allocations in record; resident memory {} -> {} KiB",
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
    draw_many(200, 4 << 20);
}

/// `cargo test -p spgs-engine --test embed -- --ignored --nocapture ten_thousand`
#[test]
#[ignore = "minutes"]
fn ten_thousand_frames_keep_memory_flat() {
    draw_many(10_000, 4 << 20);
}

/// Median time of an embedded frame against the engine's own on the same device, frames one at a time, alternately, and the
/// mean processor time of both. Runs without validation: `cargo test --release -p spgs-engine --test embed -- --ignored --nocapture costs`
#[test]
#[ignore = "a measurement"]
fn an_embedded_frame_costs_what_the_engines_own_does() {
    let host = Host::new();
    let number = |name: &str, default: u32| std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default);
    let (size, frames) = ([number("WIDTH", 640), number("HEIGHT", 480)], number("FRAMES", 60));
    let scene = demo_scene();
    let camera = demo_camera(0.0, size[0], size[1]);
    let options = GpuOptions { pipeline_cache: false, breadcrumbs: false, ..GpuOptions::default() };
    let own = Gpu::new(&options).unwrap();
    let mut renderer = Renderer::new(&own, &scene, &RenderOptions::default()).unwrap();
    let handle = SceneHandle::upload(host.gpu(), &scene, &SceneOptions::default()).unwrap();
    let frame = host.vulkan.frame().unwrap();
    for format in [PixelFormat::Rgba8, PixelFormat::Rgba16F, PixelFormat::Rgba32F] {
        let options = ViewOptions { format, in_flight: 1, ..ViewOptions::default() };
        let mut view = View::new(host.gpu(), &handle, &options).unwrap();
        view.warm_up(&camera, 0.0).unwrap();
        let color = host.picture(size, vk_format(format));
        let target = Target { color: to_read(color), depth: None };
        let (mut times, mut processor) = ([Vec::new(), Vec::new()], [0.0; 2]);
        for i in 0..frames + 5 {
            let time = f64::from(i) / f64::from(frames);
            let (start, busy) = (Instant::now(), processor_ms());
            renderer.draw(&camera, time).unwrap();
            let (middle, busy_middle) = (Instant::now(), processor_ms());
            submit(&host, frame, &mut view, &camera, time, &target);
            host.vulkan.wait(frame).unwrap();
            if i >= 5 {
                times[0].push((middle - start).as_secs_f64() * 1e3);
                times[1].push(middle.elapsed().as_secs_f64() * 1e3);
                processor[0] += (busy_middle - busy) / f64::from(frames);
                processor[1] += (processor_ms() - busy_middle) / f64::from(frames);
            }
        }
        let [own, embedded] = times.map(median);
        let percent = |own: f64, embedded: f64| 100.0 * (embedded / own.max(1e-9) - 1.0);
        println!(
            "{format:?} {}x{}: own {own:.3} ms, embedded {embedded:.3} ms, {:+.1} %; processor {:+.1} %",
            size[0],
            size[1],
            percent(own, embedded),
            percent(processor[0], processor[1]),
        );
        drop(view);
        let options = ViewOptions { profile: true, ..options };
        let mut view = View::new(host.gpu(), &handle, &options).unwrap();
        view.warm_up(&camera, 0.0).unwrap();
        let (mut blend, mut copy) = (Vec::new(), Vec::new());
        for i in 0..frames.min(30) {
            submit(&host, frame, &mut view, &camera, f64::from(i) / f64::from(frames), &target);
            host.vulkan.wait(frame).unwrap();
            for timing in view.timings().unwrap() {
                match timing.label.as_str() {
                    "blend" | "blend_packed" => blend.push(timing.us / 1e3),
                    label if label.starts_with("copy") && label.ends_with("to image") => copy.push(timing.us / 1e3),
                    _ => {}
                }
            }
        }
        println!("  of which blend {:.3} ms, copy to the image {:.3} ms", median(blend), median(copy));
        drop(view);
        host.vulkan.destroy(color);
    }
    host.vulkan.destroy_frame(frame);
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
