//! The same scene on the same device: bit-identical images over 5 runs in each of 3 processes, and with one thread.

use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{demo_camera, demo_scene};

/// FNV-1a over the bits of an image.
fn hash(image: &engine::image::Image) -> u64 {
    let words = image.rgba.iter().chain(&image.depth).map(|v| v.to_bits());
    words.fold(0xCBF2_9CE4_8422_2325, |h, w| (h ^ u64::from(w)).wrapping_mul(0x0000_0100_0000_01B3))
}

fn five_runs() -> Vec<u64> {
    let gpu = tests_harness::gpu();
    let scene = demo_scene();
    (0..5)
        .map(|_| {
            let options = RenderOptions { depth: true, ..RenderOptions::default() };
            let mut renderer = Renderer::new(&gpu, &scene, &options).unwrap();
            hash(&renderer.render(&demo_camera(0.3, 320, 240), 0.3).unwrap())
        })
        .collect()
}

#[test]
fn images_are_bit_identical_across_runs_and_processes() {
    if std::env::var_os("SPGS_DETERMINISM_CHILD").is_some() {
        println!("hashes {:?}", five_runs());
        return;
    }
    let mut all = five_runs();
    for threads in ["", "", "0"] {
        let mut child = std::process::Command::new(std::env::current_exe().unwrap());
        child.args(["--exact", "images_are_bit_identical_across_runs_and_processes", "--nocapture"]);
        child.env("SPGS_DETERMINISM_CHILD", "1");
        if !threads.is_empty() {
            child.env("LP_NUM_THREADS", threads);
        }
        let output = child.output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let list = text.lines().find_map(|l| l.split_once("hashes [")).map(|(_, l)| l.trim_end_matches(']').to_owned());
        let list = list.unwrap_or_else(|| panic!("{text}{}", String::from_utf8_lossy(&output.stderr)));
        all.extend(list.split(", ").map(|v| v.parse::<u64>().unwrap()));
    }
    assert_eq!(all.len(), 20);
    assert!(all.iter().all(|h| *h == all[0]), "images differ: {all:x?}");
}
