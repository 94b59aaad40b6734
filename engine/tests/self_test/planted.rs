//! Faults that drivers have, planted in the SPIR-V: the self-test names the kernel.

use std::collections::BTreeSet;

use engine::Error;
use engine::gpu::kernel::Kernel;
use engine::gpu::{Gpu, spirv};
use engine::render::{SceneHandle, SceneOptions, View, ViewOptions};
use engine::scene::synthetic::demo_scene;
use engine::self_test::Suite;

use crate::{open, options};

const OP_NOP: u32 = 0x0001_0000;
const OP_ENTRY_POINT: u32 = 15;
const OP_FUNCTION: u32 = 54;
const OP_FUNCTION_END: u32 = 56;
const OP_VARIABLE: u32 = 59;
const OP_CONTROL_BARRIER: u32 = 224;
const OP_LABEL: u32 = 248;
const OP_RETURN: u32 = 253;

fn kernel(name: &str) -> &'static Kernel {
    engine::kernels().find(|k| k.name == name).unwrap()
}

/// The instructions of a module: opcode and words.
fn instructions(words: &[u32]) -> Vec<(u32, &[u32])> {
    let (mut at, mut found) = (5, Vec::new());
    while at < words.len() {
        let length = (words[at] >> 16) as usize;
        found.push((words[at] & 0xffff, &words[at..at + length]));
        at += length;
    }
    found
}

/// The kernel without its code: its entry point returns at once.
fn returns_at_once(kernel: &Kernel) -> Vec<u32> {
    let words = spirv::words(kernel).unwrap();
    let all = instructions(&words);
    let main = all.iter().find(|(op, _)| *op == OP_ENTRY_POINT).unwrap().1[2];
    let mut out = words[..5].to_vec();
    let (mut in_main, mut done) = (false, false);
    for (op, instruction) in all {
        if op == OP_FUNCTION && instruction[2] == main {
            (in_main, done) = (true, false);
        }
        let head = matches!(op, OP_FUNCTION | OP_LABEL | OP_VARIABLE);
        if in_main && !done && !head {
            out.push(1 << 16 | OP_RETURN);
            done = true;
        }
        if op == OP_FUNCTION_END {
            in_main = false;
        }
        if !in_main || !done {
            out.extend(instruction);
        }
    }
    out
}

/// The kernel with every barrier left out.
fn without_barriers(kernel: &Kernel) -> Vec<u32> {
    let words = spirv::words(kernel).unwrap();
    let mut out = words[..5].to_vec();
    for (op, instruction) in instructions(&words) {
        match op {
            OP_CONTROL_BARRIER => out.extend(instruction.iter().map(|_| OP_NOP)),
            _ => out.extend(instruction),
        }
    }
    assert_ne!(out, words, "{} has no barrier", kernel.name);
    out
}

/// What the self-test says of a device with this kernel in the place of its own.
fn verdict(name: &'static str, words: Vec<u32>, suite: Suite) -> Result<(), Error> {
    let gpu = open(&engine::gpu::GpuOptions { replace_spirv: vec![(name, words)], ..options() });
    gpu.self_test(suite).map(|_| ())
}

fn assert_named(name: &'static str, words: Vec<u32>, suite: Suite) {
    let error = verdict(name, words, suite).expect_err(name);
    println!("{error}");
    assert!(matches!(error, Error::SelfTest { .. }), "{error}");
    assert!(error.to_string().contains(&format!("kernel `{name}`")), "{name}: {error}");
    assert_eq!(error.exit_code(), 1);
}

#[test]
fn a_kernel_that_does_nothing_is_named() {
    let suites: [(Suite, &[&str]); 5] = [
        (
            Suite::Frame,
            &[
                "subgroup_order",
                "sort_histogram",
                "sort_spine",
                "sort_scatter",
                "deform_project",
                "scan_tiles",
                "emit_tiles",
                "sort_tiles",
                "blend",
            ],
        ),
        (Suite::Packed, &["blend_packed", "display"]),
        (Suite::Networks, &["deform_network", "nonrigid_network"]),
        (Suite::Soft, &["deform_project"]),
        (Suite::Fields, &["field_waves", "field_planes", "field_nodes", "field_offset", "linear_forward"]),
    ];
    for (suite, kernels) in suites {
        for name in kernels {
            assert_named(name, returns_at_once(kernel(name)), suite);
        }
    }
}

/// One kernel of each part of a step.
#[test]
fn kernels_of_training_that_do_nothing_are_named() {
    for name in ["blend_backward", "deform_project_backward", "image_loss", "linear_update", "density_decide"] {
        assert_named(name, returns_at_once(kernel(name)), Suite::Training);
    }
    assert_named("encode_gaussians", returns_at_once(kernel("encode_gaussians")), Suite::Nonrigid);
    assert_named("association_update", returns_at_once(kernel("association_update")), Suite::SoftTraining);
}

#[test]
#[ignore = "a minute and more; run by `ci/test drivers`"]
fn every_kernel_of_training_is_named() {
    let gpu = open(&options());
    let native = gpu.info().capabilities.float_atomics && !gpu.info().is_cpu();
    // No step dispatches it: each kernel of the backward pass has its Adam step in it.
    let mut idle: BTreeSet<&str> = BTreeSet::new();
    // It reports nothing where nothing is wrong.
    idle.insert("check_finite");
    if !native {
        idle.insert("blend_backward_native");
    }
    let mut missed = Vec::new();
    for kernel in engine::train::kernels().filter(|k| !idle.contains(k.name)) {
        let nothing = returns_at_once(kernel);
        let suite = match kernel.name {
            "encode_gaussians" | "nonrigid_network" => Suite::Nonrigid,
            "association_update" => Suite::SoftTraining,
            _ => Suite::Training,
        };
        match verdict(kernel.name, nothing, suite) {
            Err(error) if error.to_string().contains(&format!("kernel `{}`", kernel.name)) => {}
            Err(error) => missed.push(format!("{}: {error}", kernel.name)),
            Ok(()) => missed.push(format!("{}: passed", kernel.name)),
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

#[test]
fn a_kernel_that_skips_its_barriers_is_named() {
    for name in ["sort_scatter", "subgroup_order"] {
        assert_named(name, without_barriers(kernel(name)), Suite::Frame);
    }
}

#[test]
fn what_only_some_need_is_tested_at_first_use() {
    let name = "blend_packed";
    let planted = engine::gpu::GpuOptions { replace_spirv: vec![(name, returns_at_once(kernel(name)))], ..options() };
    let gpu = Gpu::new(&planted).unwrap();
    let scene = SceneHandle::upload(&gpu, &demo_scene(), &SceneOptions::default()).unwrap();
    // Each time, and after a test that was asked for: an error that is not looked at changes nothing.
    gpu.self_test(Suite::Packed).expect_err(name);
    for _ in 0..2 {
        let error = View::new(&gpu, &scene, &ViewOptions::default()).expect_err("a view packs its pixels");
        assert!(matches!(&error, Error::SelfTest { why, .. } if why.contains(name)), "{error}");
    }
    let trusted = engine::gpu::GpuOptions { self_test: engine::gpu::SelfTest::Skip, ..planted };
    let gpu = Gpu::new(&trusted).unwrap();
    let scene = SceneHandle::upload(&gpu, &demo_scene(), &SceneOptions::default()).unwrap();
    View::new(&gpu, &scene, &ViewOptions::default()).unwrap();
}

#[test]
fn a_device_that_fails_is_no_device() {
    let name = "sort_scatter";
    let planted = engine::gpu::GpuOptions { replace_spirv: vec![(name, returns_at_once(kernel(name)))], ..options() };
    let index = open(&planted).info().index.to_string();
    let asked = engine::gpu::GpuOptions { device: Some(index), ..planted.clone() };
    let error = Gpu::new(&asked).expect_err("asked for by index");
    assert!(matches!(&error, Error::SelfTest { why, .. } if why.contains(name)), "{error}");
    let all = Gpu::new(&engine::gpu::GpuOptions { device: None, ..planted.clone() }).expect_err("none is left");
    assert!(matches!(&all, Error::NoDevice { reason } if reason.contains(name)), "{all}");
    assert!(!all.to_string().contains('\n') && all.exit_code() == 1);
    let skipped = engine::gpu::GpuOptions { self_test: engine::gpu::SelfTest::Skip, ..planted };
    Gpu::new(&skipped).unwrap();
}
