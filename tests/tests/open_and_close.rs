//! Devices that are opened, used and closed again and again, several at a time, on threads that end: drivers, layers and the
//! loader come and go with them.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::thread;

use engine::gpu::{Gpu, GpuOptions, Memory};

/// Threads at a time: more than cores, so that they are stopped anywhere.
const THREADS: usize = 6;

/// Opens a device, lets it copy something, closes it.
fn use_once(word: u32) {
    let gpu = Gpu::open(&GpuOptions { pipeline_cache: false, ..GpuOptions::default() }).expect("a Vulkan device");
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
fn open_and_close(rounds: usize) {
    for round in 0..rounds {
        let threads: Vec<_> =
            (0..THREADS).map(|i| thread::spawn(move || use_once((round * THREADS + i) as u32))).collect();
        threads.into_iter().for_each(|t| t.join().unwrap());
    }
}

#[test]
fn devices_come_and_go_on_threads_that_end() {
    open_and_close(4);
}

#[test]
#[ignore = "a search for crashes: minutes"]
fn devices_come_and_go_for_long() {
    open_and_close(std::env::var("SPGS_TEST_ROUNDS").map_or(200, |v| v.parse().unwrap()));
}
