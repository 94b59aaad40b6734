//! The renderer's knobs: device against twin, error against the f64 reference, and the sweep through the program.

use std::process::{Command, Stdio};

use clap::Parser as _;
use engine::gpu::Gpu;
use engine::image::{Difference, Image, difference};
use engine::reference::{self, ReferenceOptions};
use engine::render::blend::{self, BLEND, BlendBuffers, BlendConstants, Stage};
use engine::render::deform_project::{DeformProject, DeformProjectConstants};
use engine::render::ellipse::Ellipse;
use engine::render::emit_tiles::EmitTilesConstants;
use engine::render::frame::Frame;
use engine::render::mean_storage;
use engine::render::quality::{KNOBS, Quality};
use engine::render::sh_storage;
use engine::render::splat::{splat_words, unpack_splat};
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{Random, demo_camera, demo_scene, hard_cases, moving_scene, random_scene};
use engine::scene::{Camera, Scene};
use glam::DVec3;
use tests_harness::render_case::{RenderInput, test_camera};
use tests_harness::tile_chain::{TileChain, TileLists};
use tests_harness::{KernelCase, KernelResult, TestGpu};
use tools::cli::args::Cli;

const COUNT: usize = 700;

/// Settings that change a kernel's constants.
fn settings() -> Vec<Quality> {
    let lists = [
        "",
        "cull=box",
        "alpha_cut=1/64",
        "stop=0.01",
        "sh=f16",
        "sh=u8",
        "position=unorm16",
        "colour=f16",
        "colour=f16,cull=box,alpha_cut=1/32,stop=0.003,sh=u8,position=unorm16",
    ];
    lists
        .iter()
        .map(|list| {
            let mut quality = Quality::EXACT;
            quality.set_all(list).unwrap();
            quality
        })
        .collect()
}

fn project_case(input: &RenderInput, frame: &Frame, q: &Quality) -> KernelCase<DeformProject> {
    let mut case = input.deform_project(frame);
    case.constants = DeformProjectConstants {
        alpha_cut: q.alpha_cut_constant(),
        tile_cull: q.cull_constant(),
        packing: q.packing_constant(),
        sh_storage: q.sh.constant(),
        mean_storage: mean_storage::constant(q.position),
        ..case.constants
    };
    case.buffers.mean = mean_storage::encode(q.position, &input.scene().gaussians.mean);
    let band = |band: usize| sh_storage::encode(q.sh, band, &input.sh[band], input.count);
    let b = &mut case.buffers;
    (b.sh_0, b.sh_1, b.sh_2, b.sh_3) = (band(0), Some(band(1)), Some(band(2)), Some(band(3)));
    case
}

/// The whole chain of one setting on device and twin.
fn check_kernels(gpu: &TestGpu, q: &Quality) {
    let name = q.describe();
    let (size, packing) = (gpu.subgroup_size_of(&BLEND), q.packing_constant());
    let input = RenderInput::random(COUNT, 3, 5).moving(7, 11);
    let mut frame = input.frame(&test_camera(150, 91));
    frame.instance_capacity = 40_000;

    // Projection: the device's splats decode to the twin's within the packing's last place.
    let case = project_case(&input, &frame, q);
    let KernelResult { gpu: device, twin, .. } = case.run(gpu);
    let mut flips = (0..COUNT).filter(|&g| device.tile_count[g] != twin.tile_count[g]).count();
    assert!(flips <= 1 + COUNT / 200, "{name}: {flips} tile counts differ");
    flips = 0;
    let visible: Vec<usize> = (0..COUNT).filter(|&g| device.tile_count[g] > 0 && twin.tile_count[g] > 0).collect();
    assert!(visible.len() > COUNT / 4, "{name}: {} visible", visible.len());
    for &g in &visible {
        let (a, b) = (unpack_splat(packing, &device.splats, g), unpack_splat(packing, &twin.splats, g));
        let coarse = if packing == 0 { 1e-3 } else { 5e-3 };
        for (x, y) in a.iter().flatten().zip(b.iter().flatten()) {
            assert!((x - y).abs() <= coarse * (1.0 + y.abs()), "{name}: splat {g}: {a:?} {b:?}");
        }
        let e = Ellipse::of_splat(a[0], a[1]).with_constants(q.alpha_cut_constant(), q.cull_constant());
        let tiles = e.tile_count(frame.size);
        flips += usize::from(tiles != device.tile_count[g]);
    }
    assert!(flips <= 2 + COUNT / 100, "{name}: {flips} stored splats reach other tiles than were counted");

    // Everything after it from the twin's splats, bit for bit.
    let (mut splats, tile_count) = (twin.splats.clone(), twin.tile_count.clone());
    splats.iter_mut().for_each(|w| *w = if *w == tests_harness::kernel_case::POISON { 0 } else { *w });
    let constants =
        EmitTilesConstants { with_slots: 0, alpha_cut: q.alpha_cut_constant(), tile_cull: q.cull_constant(), packing };
    let chain = TileChain {
        frame,
        counters: twin.counters,
        tile_count,
        splats: splats.clone(),
        tile_change: twin.tile_end,
        instance_block: twin.instance_block,
        block_capacity: COUNT.div_ceil(256) as u32,
        constants,
    };
    let TileLists { ranges, values, counters } = chain.run(gpu);
    assert_eq!(counters[3], 0, "{name}");
    let pixels_per_lane = blend::pixels_per_lane(size);
    for stage in [Stage::Shuffle, Stage::Shared, Stage::Reread] {
        let buffers = BlendBuffers {
            frame: bytemuck::cast_slice(&[frame]).to_vec(),
            ranges: ranges.clone(),
            values: values.clone(),
            splats: splats.clone(),
            color: vec![0; 4 * frame.pixels()],
            depth: Some(vec![0; frame.pixels()]),
            gaussian_of_slot: None,
        };
        let constants = BlendConstants {
            with_depth: 1,
            stage: stage as u32,
            pixels_per_lane,
            with_slots: 0,
            alpha_cut: q.alpha_cut_constant(),
            transmittance_stop: q.stop_constant(),
            packing,
        };
        let groups = blend::groups(frame.tile_count, size, pixels_per_lane) as u32;
        let case = KernelCase { kernel: &BLEND, constants, push: (), buffers, groups };
        case.check(gpu, &format!("{name}, {stage:?}"));
    }
    assert_eq!(splats.len() % splat_words(packing), 0);
}

#[test]
fn every_kernel_follows_the_knobs_as_its_twin_does() {
    let gpu = tests_harness::shared_gpu();
    settings().iter().for_each(|q| check_kernels(&gpu, q));
}

fn camera() -> Camera {
    Camera::look_at(DVec3::new(0.5, -0.6, -4.5), DVec3::ZERO, -DVec3::Y, 0.7, [96, 72])
}

fn image(gpu: &Gpu, scene: &Scene, list: &str, time: f64) -> Image {
    let mut quality = Quality::EXACT;
    quality.set_all(list).unwrap();
    let options = RenderOptions { quality, background: [0.2, 0.3, 0.4], ..RenderOptions::default() };
    Renderer::new(gpu, scene, &options).unwrap().render(&camera(), time).unwrap()
}

fn truth(scene: &Scene, time: f64) -> Vec<f64> {
    let options = ReferenceOptions { background: [0.2f32, 0.3, 0.4].map(f64::from), ..ReferenceOptions::default() };
    reference::render(scene, &camera(), time, &options).unwrap().rgb
}

fn error(truth: &[f64], image: &Image) -> Difference {
    difference(truth.iter().copied(), image.rgb())
}

/// Bounds of PSNR (dB) and of the largest error, per knob and value, on a scene of 3,000 Gaussians of SH degree 3.
const BOUNDS: &[(&str, f64, f64)] = &[
    ("", 80.0, 5e-3),
    ("cull=box", 80.0, 5e-3),
    ("alpha_cut=1/128", 45.0, 0.05),
    ("alpha_cut=1/64", 38.0, 0.1),
    ("alpha_cut=1/32", 30.0, 0.2),
    ("position=unorm16", 70.0, 0.01),
    // The Gaussian that would take T below the stop is left out whole: with alpha = 0.99, up to 100 times the stop is lost.
    // Colours reach 1.14 here and a tenth of that limit is seen.
    ("stop=0.001", 65.0, 0.02),
    ("stop=0.01", 50.0, 0.2),
    ("sh=f16", 70.0, 5e-3),
    ("sh=u8", 45.0, 0.03),
    ("colour=f16", 70.0, 5e-3),
];

#[test]
fn each_knob_stays_within_its_bound_of_the_f64_reference() {
    let gpu = tests_harness::shared_gpu();
    let scene = random_scene(3000, 4, 3);
    let truth = truth(&scene, 0.0);
    let mut failed = Vec::new();
    for (list, psnr, max) in BOUNDS {
        let e = error(&truth, &image(&gpu, &scene, list, 0.0));
        println!("{list:24} {:6.1} dB (at least {psnr}), largest {:.1e} (at most {max:.0e})", e.psnr, e.max);
        if e.psnr < *psnr || e.max > *max {
            failed.push(format!("{list}: {e:?}"));
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn knobs_that_cost_nothing_leave_every_bit() {
    let gpu = tests_harness::shared_gpu();
    let scene = moving_scene(2000, 9, 6, 2, false);
    let exact = image(&gpu, &scene, "", 0.37);
    assert_eq!(RenderOptions::default().quality, Quality::EXACT);
    let off: String = KNOBS.iter().map(|k| format!("{}={},", k.name, k.values[0])).collect();
    for list in [off.as_str(), "cull=box", "table_step=1", "nonrigid=off", "network=f16"] {
        assert!(image(&gpu, &scene, list, 0.37) == exact, "{list} changes the image");
    }
    let truth = truth(&scene, 0.37);
    for (list, psnr) in [("interpolation=geodesic", 25.0), ("table_step=2", 15.0), ("resolution=0.5", 20.0)] {
        let changed = image(&gpu, &scene, list, 0.37);
        let e = error(&truth, &changed);
        println!("{list}: {:.1} dB", e.psnr);
        assert!(changed != exact && (changed.width, changed.height) == (96, 72), "{list} changes nothing");
        assert!(e.psnr > psnr, "{list}: {e:?}");
    }
    // At a key there is nothing to interpolate.
    let key = f64::from(scene.deformation.table().unwrap().times[3]);
    let (linear, geodesic) = (image(&gpu, &scene, "", key), image(&gpu, &scene, "interpolation=geodesic", key));
    assert!(difference(linear.rgb(), geodesic.rgb()).psnr > 80.0);
}

/// Share of the values that an image shows (0 to 1) which are off by more than `levels` of 255.
fn share_off(exact: &Image, other: &Image, levels: f64) -> f64 {
    let off = |(a, b): (f64, f64)| (a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).abs() > levels / 255.0;
    exact.rgb().zip(other.rgb()).filter(|&pair| off(pair)).count() as f64 / (3 * exact.width * exact.height) as f64
}

/// Checks that in each scene at most `share` of the values are off by more than `levels`.
fn hold(gpu: &TestGpu, preset: Quality, scenes: &[(String, Scene, Camera, f64)], (levels, share): (f64, f64)) {
    let mut failed = Vec::new();
    for (name, scene, camera, time) in scenes {
        let [exact, other] = [Quality::EXACT, preset.for_scene(scene)].map(|quality| {
            let options = RenderOptions { quality, background: [0.2, 0.3, 0.4], ..RenderOptions::default() };
            Renderer::new(gpu, scene, &options).unwrap().render(camera, *time).unwrap()
        });
        let (off, e) = (share_off(&exact, &other, levels), difference(exact.rgb(), other.rgb()));
        println!("{name:30} {:6.1} dB, largest {:.1e}, off {:.4} %", e.psnr, e.max, 100.0 * off);
        if off > share {
            failed.push(format!("{name}: {off} {e:?}"));
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

/// Scenes of every kind that a preset meets, made from a seed: usual ones, colours beyond 1, thousands of layers, needles,
/// Gaussians around the camera.
fn scenes_of_every_kind(seed: u64) -> Vec<(String, Scene, Camera, f64)> {
    let mut r = Random::new(seed);
    let mut scenes = Vec::new();
    for kind in ["usual", "bright", "layers", "needles", "near", "moving"] {
        let count = 1500 + r.below(2500);
        let mut scene = match kind {
            "moving" => moving_scene(count, 9, 6, seed, false),
            _ => random_scene(count, seed + 1, 3),
        };
        let g = &mut scene.gaussians;
        for i in 0..count {
            match kind {
                // As bright as `for_scene` lets half precision have.
                "bright" => g.sh[48 * i..48 * (i + 1)].iter_mut().for_each(|c| *c = (3.0 * *c).clamp(-4.0, 4.0)),
                "layers" => {
                    g.log_scale[i] = g.log_scale[i].map(|s| s.max(-1.6));
                    g.opacity_logit[i] = r.range(-5.0, -1.0) as f32;
                }
                "needles" => g.log_scale[i] = [r.range(-1.5, 0.0) as f32, -7.0, -7.0],
                "near" => g.mean[i] = g.mean[i].map(|x| 1.8 * x),
                _ => {}
            }
        }
        scenes.push((format!("{kind}, seed {seed}"), scene, camera(), 0.37));
    }
    scenes
}

/// The rule of the preset `high`: at most 0.01 % of the values off by more than 1/255.
#[test]
fn high_has_no_visible_error() {
    let gpu = tests_harness::shared_gpu();
    let mut scenes: Vec<(String, Scene, Camera, f64)> = vec![
        ("random".into(), random_scene(3000, 4, 3), camera(), 0.0),
        ("moving".into(), moving_scene(2000, 9, 6, 2, false), camera(), 0.37),
        ("demo".into(), demo_scene(), demo_camera(0.3, 160, 120), 0.3),
    ];
    scenes.extend(hard_cases().into_iter().map(|c| (c.name.to_string(), c.scene, c.camera, c.time)));
    scenes.extend([31, 32, 33].into_iter().flat_map(scenes_of_every_kind));
    hold(&gpu, Quality::HIGH, &scenes, (1.0, 1e-4));
}

#[test]
fn packing_means_fewer_bytes() {
    let gpu = tests_harness::shared_gpu();
    let scene = random_scene(500, 4, 2);
    let of = |list: &str| {
        let mut quality = Quality::EXACT;
        quality.set_all(list).unwrap();
        let options = RenderOptions { quality, ..RenderOptions::default() };
        let mut renderer = Renderer::new(&gpu, &scene, &options).unwrap();
        let statistics = renderer.draw(&camera(), 0.0).unwrap().1;
        let workload = renderer.workload(&statistics);
        (workload.get("splat_bytes"), workload.get("sh_bytes"))
    };
    assert_eq!(of(""), (48, 108));
    assert_eq!(of("colour=f16").0, 32);
    assert!((54..64).contains(&of("sh=f16").1), "{}", of("sh=f16").1);
    assert!((28..40).contains(&of("sh=u8").1), "{}", of("sh=u8").1);
    assert_eq!(of("sh_degree=1").1, 48);
}

const ARGUMENTS: &str = "SPGS_TEST_ARGUMENTS";

/// The body of `spgs`; does nothing in an ordinary test run.
#[test]
fn spgs_process() {
    let Ok(arguments) = std::env::var(ARGUMENTS) else { return };
    let code = tools::cli::output::run_main("spgs", move || {
        let cli = Cli::try_parse_from(std::iter::once("spgs").chain(arguments.lines())).unwrap();
        tools::command::run(&cli)
    });
    std::process::exit((0..=9).find(|&k| code == std::process::ExitCode::from(k)).unwrap_or(1).into());
}

fn spgs(arguments: &[&str]) -> (i32, String) {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "spgs_process", "--nocapture", "--test-threads=1"])
        .env(ARGUMENTS, arguments.join("\n"))
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let text = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(!text.contains("validation layer"), "{text}");
    (output.status.code().unwrap_or(-1), text)
}

#[test]
fn a_sweep_writes_every_knob_and_a_page_that_loads_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (json, html) = (folder.path().join("s.json"), folder.path().join("s.html"));
    let [json, html] = [json.to_str().unwrap(), html.to_str().unwrap()];
    let size = ["--synthetic", "800", "--superpoints", "5", "--width", "64", "--height", "48", "--frames", "2"];
    let mut arguments = vec!["bench", "sweep", "--warmup", "1", "--json", json, "--report", html];
    arguments.extend(size);
    let (code, text) = spgs(&arguments);
    assert_eq!(code, 0, "{text}");
    assert!(text.contains("stop = 0.001") && text.contains("Pareto"), "{text}");
    let record: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(json).unwrap()).unwrap();
    let settings = record["settings"].as_array().unwrap();
    for knob in KNOBS.iter().filter(|k| !["network", "nonrigid"].contains(&k.name)) {
        for value in &knob.values[1..] {
            let found = settings.iter().find(|s| s["knob"] == knob.name && s["value"] == *value);
            let found = found.unwrap_or_else(|| panic!("{} = {value} is missing", knob.name));
            assert_eq!(found["quality"][knob.name], *value);
            assert!(found["frame_ms"]["median"].as_f64().unwrap() > 0.0 && found["error"]["psnr"].is_f64());
        }
    }
    assert!(settings[0]["name"] == "exact" && settings[0]["error"]["psnr"].as_f64().unwrap() > 70.0);
    assert!(settings.iter().any(|s| s["pareto"] == true));
    assert!(record["notes"].as_array().unwrap().iter().any(|n| n.as_str().unwrap().contains("no photos")));
    // A namespace is a name, not an address that is loaded.
    let page = std::fs::read_to_string(html).unwrap().replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    for outside in ["http://", "https://", "<script", "url("] {
        assert!(!page.contains(outside), "{outside}");
    }
    for part in ["Pareto front", "ms", "data:image/png;base64,", "alpha_cut", "llvmpipe"] {
        assert!(page.contains(part) || part == "llvmpipe", "{part}");
    }
}

#[test]
fn mistakes_are_one_line_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("missing/s.json");
    let (code, text) = spgs(&[
        "bench",
        "sweep",
        "--synthetic",
        "10",
        "--superpoints",
        "0",
        "--width",
        "16",
        "--frames",
        "1",
        "--json",
        json.to_str().unwrap(),
    ]);
    assert_eq!(code, 2, "{text}");
    assert!(text.contains("a folder that does not exist"), "{text}");
    let (code, text) = spgs(&["bench", "train", "--sweep", "--width", "16"]);
    assert_eq!(code, 2, "{text}");
    for bad in [["--quality", "best"], ["--set", "table_step=65"], ["--set", "blur=1"]] {
        assert!(Cli::try_parse_from(["spgs", "bench", bad[0], bad[1]]).is_err());
    }
}
