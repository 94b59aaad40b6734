//! Devices that are opened, used and closed again and again, several at a time, on threads that end: drivers and the loader
//! come and go with them.
//!
//! Without the validation layer: up to version 1.3.296 it looks a device up in a map without a lock (`GetLayerDataPtr` in its
//! `layers/vk_layer_data.h`, "We probably should lock here"), so that any call crashes when another thread opens or closes a
//! device of its own meanwhile. The search below shows it with `SPGS_VALIDATION=1`: signal 11 within seconds, inside the layer.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;

use engine::gpu::{Gpu, GpuOptions, Memory};

/// Threads at a time: more than cores, so that they are stopped anywhere.
const THREADS: usize = 6;

fn options() -> GpuOptions {
    GpuOptions { pipeline_cache: false, ..GpuOptions::default() }
}

fn without_layer() -> GpuOptions {
    GpuOptions { validation: false, ..options() }
}

/// Opens a device, lets it copy something, closes it.
fn use_once(options: &GpuOptions, word: u32) {
    let gpu = Gpu::open(options).expect("a Vulkan device");
    let from = gpu.buffer("from", 64, Memory::Device).unwrap();
    let to = gpu.buffer("to", 64, Memory::Readback).unwrap();
    let mut r = gpu.recorder("open and close");
    r.fill(&from, word).unwrap();
    r.copy(&from, &to).unwrap();
    r.host_read(&to);
    gpu.run(r).unwrap();
    let mut found = [0_u32; 16];
    to.read(0, bytemuck::cast_slice_mut(&mut found)).unwrap();
    assert_eq!(found, [word; 16]);
}

/// Threads that end after one device each.
fn open_and_close(options: &GpuOptions, rounds: usize) {
    for round in 0..rounds {
        thread::scope(|threads| {
            for i in 0..THREADS {
                threads.spawn(move || use_once(options, (round * THREADS + i) as u32));
            }
        });
    }
}

/// Records and runs on one device until `over`.
fn use_until(options: &GpuOptions, over: &AtomicBool) {
    let gpu = Gpu::open(options).expect("a Vulkan device");
    let buffer = gpu.buffer("buffer", 64, Memory::Device).unwrap();
    while !over.load(Relaxed) {
        let mut r = gpu.recorder("fills");
        for _ in 0..200 {
            r.fill(&buffer, 1).unwrap();
        }
        gpu.run(r).unwrap();
    }
}

/// Threads that use a device each while others open and close theirs.
fn use_while_others_come_and_go(options: &GpuOptions, rounds: u32) {
    let over = AtomicBool::new(false);
    thread::scope(|threads| {
        for _ in 0..THREADS / 2 {
            threads.spawn(|| use_until(options, &over));
        }
        let others: Vec<_> =
            (0..THREADS / 2).map(|_| threads.spawn(move || (0..rounds).for_each(|i| use_once(options, i)))).collect();
        // The others end in any case.
        let ended: Vec<_> = others.into_iter().map(|t| t.join()).collect();
        over.store(true, Relaxed);
        ended.into_iter().for_each(|e| e.unwrap());
    });
}

#[test]
fn devices_come_and_go_on_threads_that_end() {
    open_and_close(&without_layer(), 4);
}

#[test]
fn devices_are_used_while_others_come_and_go() {
    use_while_others_come_and_go(&without_layer(), 8);
}

/// With the layer when `SPGS_VALIDATION=1`.
#[test]
#[ignore = "a search for crashes: minutes"]
fn devices_come_and_go_for_long() {
    let rounds = std::env::var("SPGS_TEST_ROUNDS").map_or(200, |v| v.parse().unwrap());
    open_and_close(&options(), rounds);
    use_while_others_come_and_go(&options(), rounds as u32);
}
