//! The GPU layer by itself: transfers, budgets, refusals, injected failures.

use engine::Error;
use engine::gpu::{Commands, Gpu, GpuOptions, Groups, Memory, Slice};
use engine::render::sort_histogram::{SORT_HISTOGRAM, SortHistogramBuffers, SortHistogramPush};
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{demo_camera, demo_scene};

#[test]
fn upload_fill_copy_download() {
    let gpu = tests_harness::gpu();
    let data: Vec<u8> = (0..100_003_u32).map(|i| (i * 7 + 3) as u8).collect();
    let buffer = gpu.buffer_with("data", &data).unwrap();
    let back = gpu.download(buffer.slice(0, data.len() as u64)).unwrap();
    assert!(back == data);
    let mut recorder = gpu.recorder("fill");
    recorder.fill(buffer.slice(4096, 1024), 0xDEAD_BEEF).unwrap();
    recorder.copy(buffer.slice(4096, 512), buffer.slice(0, 512)).unwrap();
    let commands = gpu.run(recorder).unwrap();
    assert_eq!(commands.barriers(), 2, "{}", commands.plan());
    let back = gpu.download(&buffer).unwrap();
    assert_eq!(&back[..4], &0xDEAD_BEEF_u32.to_le_bytes());
    assert_eq!(back[512], data[512]);
}

#[test]
fn budget_and_injected_failure_name_the_allocation() {
    let gpu = tests_harness::gpu();
    let before = gpu.memory_used().0;
    gpu.set_byte_budget(before + 1000);
    match gpu.buffer("too large", 2000, Memory::Device) {
        Err(Error::OutOfMemory { name, need: 2000, .. }) => assert_eq!(name, "too large"),
        other => panic!("{other:?}"),
    }
    assert_eq!(gpu.memory_used().0, before);
    gpu.set_byte_budget(u64::MAX / 2);
    gpu.inject_allocation_failure(2);
    let first = gpu.buffer("first", 16, Memory::Device).unwrap();
    assert!(matches!(gpu.buffer("second", 16, Memory::Device), Err(Error::OutOfMemory { .. })));
    assert!(gpu.buffer("third", 16, Memory::Device).is_ok());
    drop(first);
    assert_eq!(gpu.buffer_count(), 0);
}

#[test]
fn lost_device_names_the_running_kernel() {
    // It is not known without breadcrumbs; after the first loss they are noted.
    if std::env::var_os("SPGS_BREADCRUMBS").is_none() {
        assert_eq!(lost_at(&tests_harness::gpu()), "unknown");
    }
    assert_eq!(lost_at(&tests_harness::gpu()), "sort_histogram");
}

/// Loses the device at a kernel; its name as the error has it.
fn lost_at(gpu: &Gpu) -> String {
    let counters = gpu.buffer_with("counters", bytemuck::cast_slice(&[4096_u32; 4])).unwrap();
    let buffer = |name| gpu.buffer(name, 16_384, Memory::Device).unwrap();
    let (keys, histogram) = (buffer("keys"), buffer("histogram"));
    let push = SortHistogramPush { shift: 0, digit_bits: 8, count_word: 0, partition_shift: 12 };
    let mut recorder = gpu.recorder("frame");
    recorder.fill(&keys, 1).unwrap();
    let [counters, keys, histogram] = [&counters, &keys, &histogram].map(Slice::from);
    let buffers = SortHistogramBuffers { counters, keys, histogram };
    recorder.dispatch(&SORT_HISTOGRAM, (), push, buffers, Groups::Direct(1)).unwrap();
    let mut commands = recorder.finish().unwrap();
    gpu.submit(&mut commands).unwrap();
    gpu.inject_device_lost(1);
    let [first, second] = [0; 2].map(|_| match gpu.submit(&mut commands) {
        Err(Error::DeviceLost { label, last_kernel, next_kernel, .. }) => {
            let known = next_kernel != "unknown";
            assert!(if known { last_kernel == "fill keys" } else { last_kernel.contains("SPGS_BREADCRUMBS=1") });
            assert_eq!(label, "frame");
            next_kernel
        }
        other => panic!("{other:?}"),
    });
    assert_eq!(first, second);
    first
}

/// Reads `constants` in the first operation and then works for more than ten milliseconds.
fn long_work(gpu: &Gpu, constants: &engine::gpu::Buffer, readback: &engine::gpu::Buffer) -> Commands {
    let large = gpu.buffer("large", 64 << 20, Memory::Device).unwrap();
    let mut recorder = gpu.recorder("long");
    recorder.copy(constants, readback.slice(0, constants.bytes())).unwrap();
    // Some GPUs fill memory with one value far faster than they write it.
    let fills = if gpu.info().is_cpu() { 20 } else { 40_000 };
    (0..fills).for_each(|value| recorder.fill(&large, value).unwrap());
    recorder.host_read(readback);
    recorder.finish().unwrap()
}

#[test]
fn a_wait_that_runs_out_names_the_running_kernel_and_the_setting() {
    let options = GpuOptions { timeout_s: 0.001, breadcrumbs: true, pipeline_cache: false, ..GpuOptions::default() };
    let gpu = Gpu::open(&options).unwrap();
    let constants = gpu.buffer("constants", 256, Memory::Upload).unwrap();
    let readback = gpu.buffer("readback", 256, Memory::Readback).unwrap();
    let mut commands = long_work(&gpu, &constants, &readback);
    gpu.submit(&mut commands).unwrap();
    let error = gpu.wait_for(&commands).expect_err("more than a gigabyte in a millisecond");
    match &error {
        Error::TimedOut { label, next_kernel, .. } => assert!(label == "long" && next_kernel != "unknown", "{error}"),
        other => panic!("{other:?}"),
    }
    assert!(error.to_string().contains("SPGS_TIMEOUT_S") && error.exit_code() == 1, "{error}");
}

#[test]
fn the_host_leaves_alone_what_a_submission_uses() {
    let gpu = tests_harness::gpu();
    for memory in [Memory::Upload, Memory::Constants] {
        let written = gpu.buffer("written", 64, memory).unwrap();
        let readback = gpu.buffer("readback", 64, Memory::Readback).unwrap();
        let mut commands = long_work(&gpu, &written, &readback);
        written.write(0, &[1; 64]).unwrap();
        let submission = gpu.submit(&mut commands).unwrap();
        let (write, read) = (written.write(0, &[2; 64]), readback.read(0, &mut [0; 64]));
        // Had the work been done by then, nothing would be shown: it takes a hundred times as long as these calls.
        assert!(!gpu.is_finished(submission).unwrap(), "the work is too short");
        for (name, outcome) in [("written", write), ("readback", read)] {
            let text = outcome.unwrap_err().to_string();
            assert!(text.contains(name) && text.contains("still uses it"), "{text}");
        }
        gpu.wait(submission).unwrap();
        let mut bytes = [0; 64];
        readback.read(0, &mut bytes).unwrap();
        assert_eq!(bytes, [1; 64], "what was written before");
        written.write(0, &[3; 64]).unwrap();
        gpu.submit(&mut commands).unwrap();
        gpu.wait_for(&commands).unwrap();
        readback.read(0, &mut bytes).unwrap();
        assert_eq!(bytes, [3; 64]);
    }
}

#[test]
fn constants_apart_from_the_host_give_the_same_pictures() {
    let gpu = tests_harness::gpu();
    let pictures = |apart: bool| {
        gpu.inject_memory_apart(apart);
        let mut renderer = Renderer::new(&gpu, &demo_scene(), &RenderOptions::default()).unwrap();
        let draw = |i: u32| renderer.render(&demo_camera(f64::from(i) / 3.0, 96, 72), f64::from(i) / 3.0).unwrap().rgba;
        let pictures: Vec<Vec<f32>> = (0..3).map(draw).collect();
        let plan = renderer.commands().unwrap().plan().to_owned();
        (pictures, plan.contains("copy frame"), renderer.commands().unwrap().barriers())
    };
    let (near, near_copies, near_barriers) = pictures(false);
    let (apart, apart_copies, apart_barriers) = pictures(true);
    assert!(near == apart, "other pictures");
    assert!(near[0] != near[1], "pictures that do not move show nothing");
    let on_device = gpu.info().capabilities.device_upload;
    assert_eq!((near_copies, apart_copies), (!on_device, true));
    println!("barriers: {near_barriers}, apart {apart_barriers}");
    assert!(apart_barriers <= near_barriers + 1, "{near_barriers} {apart_barriers}");
}

#[test]
fn the_budget_is_what_the_device_has_free() {
    let gpu = tests_harness::gpu();
    let heap = gpu.info().capabilities.device_heap;
    let (used, budget) = gpu.memory_used();
    println!("heap {} MiB, free {:?} MiB, budget {} MiB", heap.bytes >> 20, heap.free.map(|f| f >> 20), budget >> 20);
    assert_eq!((used, budget), (0, heap.budget(0)));
    assert!(budget > 0 && budget <= heap.bytes / 5 * 4);
    let Err(Error::OutOfMemory { name, need, free, budget }) = fill_up(&gpu) else { panic!("it never ends") };
    println!("`{name}`: {need} bytes wanted, {free} free, budget {budget}");
    // A driver may refuse before.
    assert!(need > free || name.ends_with("refused by the driver"), "`{name}`: {need} {free}");
    assert!(budget <= heap.bytes / 5 * 4, "{budget}");
    // A budget that somebody sets stays.
    gpu.set_byte_budget(1000);
    assert!(gpu.buffer("more", 4096, Memory::Device).is_err());
    assert_eq!(gpu.memory_used().1, 1000);
}

/// Asks for one allocation after another, each smaller than the limit, without touching the memory, until one is refused.
fn fill_up(gpu: &Gpu) -> engine::Result<()> {
    let bytes = gpu.info().capabilities.max_allocation_bytes.min(1 << 30);
    let mut kept = Vec::new();
    for i in 0..10_000 {
        kept.push(gpu.buffer(&format!("part {i}"), bytes, Memory::Device)?);
    }
    Ok(())
}
