//! The GPU layer by itself: transfers, budgets, refusals, injected failures.

use engine::Error;
use engine::gpu::{Groups, Memory, Slice};
use engine::render::radix_sort::{SORT_HISTOGRAM, SortHistogramPush};

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
    let gpu = tests_harness::gpu();
    let counters = gpu.buffer_with("counters", bytemuck::cast_slice(&[4096_u32; 4])).unwrap();
    let buffer = |name| gpu.buffer(name, 16_384, Memory::Device).unwrap();
    let (keys, histogram) = (buffer("keys"), buffer("histogram"));
    let push = SortHistogramPush { shift: 0, digit_bits: 8, count_word: 0 };
    let mut recorder = gpu.recorder("frame");
    recorder.fill(&keys, 1).unwrap();
    let slices = [&counters, &keys, &histogram].map(Slice::from);
    recorder.dispatch(&SORT_HISTOGRAM, &[], bytemuck::bytes_of(&push), &slices, Groups::Direct(1)).unwrap();
    let mut commands = recorder.finish().unwrap();
    gpu.submit(&mut commands).unwrap();
    gpu.inject_device_lost(1);
    for _ in 0..2 {
        match gpu.submit(&mut commands) {
            Err(Error::DeviceLost { label, last_kernel, next_kernel, .. }) => {
                assert_eq!(
                    (label.as_str(), last_kernel.as_str(), next_kernel.as_str()),
                    ("frame", "fill keys", "sort_histogram")
                );
            }
            other => panic!("{other:?}"),
        }
    }
}
