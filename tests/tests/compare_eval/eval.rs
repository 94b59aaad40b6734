//! A model on the data set that it was rendered from.

use std::path::Path;

use engine::file::picture as files;
use engine::metrics::lpips::Network;
use engine::metrics::{self, Planes};
use serde_json::Value;
use tests_harness::posed::{Posed, PosedOptions};
use tests_harness::procedural_lpips;

use super::common::{assert_close, bad_data, ok, spgs, text};

fn setup(options: &PosedOptions) -> (Posed, tempfile::TempDir) {
    let posed = Posed::new(&tests_harness::gpu(), options);
    let folder = tempfile::tempdir().unwrap();
    engine::file::save(&folder.path().join("model.safetensors"), &posed.scene).unwrap();
    (posed, folder)
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn scores_are_those_of_the_pictures_it_writes() {
    let options = PosedOptions { sizes: vec![[172, 164]], test: 3, ..PosedOptions::default() };
    let (posed, folder) = setup(&options);
    let at = |name: &str| folder.path().join(name);
    let (model, json, report, out) = (at("model.safetensors"), at("e.json"), at("e.html"), at("pictures"));
    let arguments = [
        "eval",
        text(&model),
        "--data",
        text(posed.path()),
        "--json",
        text(&json),
        "--report",
        text(&report),
        "--out",
        text(&out),
        "--scene",
        "lego",
        "--confidence",
    ];
    let kept = folder.path().join("confidence.safetensors");
    let printed = ok(&[&arguments[..], &["--save-confidence", text(&kept)]].concat());
    let e = read(&json);
    let images = e["images"].as_array().unwrap();
    assert_eq!(images.len(), 3);
    for (i, image) in images.iter().enumerate() {
        let planes =
            |kind: &str| Planes::quantised(&files::read(&out.join(format!("{i:05}{kind}.png"))).unwrap()).unwrap();
        let (truth, _) = metrics::score(&planes("_truth"), &planes(""), None).unwrap();
        assert_eq!(image["index"], i);
        assert_close(&image["psnr"], truth.psnr);
        assert_close(&image["ssim"], truth.ssim);
        assert_close(&image["ms_ssim"], truth.ms_ssim.unwrap());
        assert_close(&image["flip"], truth.flip);
        assert!(image["lpips_vgg"].is_null());
        // The data set is this scene, but for the rounding of straight alpha.
        assert!(truth.psnr > 35.0 && image["float"]["psnr"].as_f64().unwrap() > 35.0, "{image}");
        let sure = &e["confidence"]["images"][i];
        assert_eq!(sure["name"], image["name"]);
        let drawn = files::read(&out.join(format!("{i:05}_expected.png"))).unwrap();
        let of_drawn = drawn.rgb().sum::<f64>() / (4.0 * 3.0 * 172.0 * 164.0);
        assert!((of_drawn - sure["expected_error"].as_f64().unwrap()).abs() < 2e-3, "{of_drawn}, {sure}");
        assert!(out.join(format!("{i:05}_flip.png")).exists() && out.join(format!("{i:05}_error.png")).exists());
    }
    assert_eq!(e["confidence"]["training_views"], options.train);
    assert!(printed.contains("error expected from"), "{printed}");
    let mean = images.iter().map(|i| i["psnr"].as_f64().unwrap()).sum::<f64>() / 3.0;
    assert!((e["mean"]["psnr"].as_f64().unwrap() - mean).abs() < 1e-12);
    let rows = e["paper"]["rows"].as_array().unwrap();
    assert!(rows.iter().any(|r| r["method"] == "SP-GS" && r["psnr"] == 24.48), "{rows:?}");
    assert!(e["paper"]["deviations"].to_string().contains("172x164"));
    assert!(printed.contains("24.48") && printed.contains("this model") && printed.contains("Lego"), "{printed}");
    let page = std::fs::read_to_string(&report).unwrap();
    for part in ["24.48", "this model", "PSNR over time", "data:image/png;base64,", "</html>"] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("src=\"http") && !page.contains("href="), "loads something");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 5, "nothing but what was asked for");

    // The same errors from the file.
    let (model, sure) = (folder.path().join("model.safetensors"), folder.path().join("sure"));
    let cameras = ["--cameras", text(posed.path()), "--split", "test", "--confidence", text(&kept)];
    let rendered = [&["render", text(&model)][..], &cameras, &["--out", text(&sure)]].concat();
    ok(&rendered);
    ok(&[&rendered[..], &["--format", "exr"]].concat());
    for i in 0..3 {
        let [of_eval, of_render] = [out.join(format!("{i:05}_expected.png")), sure.join(format!("{i:05}.png"))]
            .map(|p| files::read(&p).unwrap());
        let apart = of_eval.rgba.iter().zip(&of_render.rgba).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(of_eval.rgba.len() == of_render.rgba.len() && apart < 1.5 / 255.0, "view {i}: {apart}");
        let exact = files::read(&sure.join(format!("{i:05}.exr"))).unwrap();
        let mean = exact.rgba.chunks_exact(4).map(|p| f64::from(p[0])).sum::<f64>() / (172.0 * 164.0);
        let expected = e["confidence"]["images"][i]["expected_error"].as_f64().unwrap();
        assert!((mean - expected).abs() < 1e-4, "{mean}, {expected}");
    }
    let other = folder.path().join("other.safetensors");
    engine::file::save(&other, &engine::scene::synthetic::random_scene(50, 1, 0)).unwrap();
    let line =
        bad_data(&[&["render", text(&other)][..], &cameras, &["--out", text(&folder.path().join("none"))]].concat());
    assert!(line.contains("another model") && !folder.path().join("none").exists(), "{line}");
}

#[test]
fn masks_weight_what_moves_and_weights_give_lpips() {
    let (posed, folder) = setup(&PosedOptions { sizes: vec![[40, 32]], ..PosedOptions::default() });
    let (model, json) = (folder.path().join("model.safetensors"), folder.path().join("e.json"));
    let weights = folder.path().join("w.safetensors");
    procedural_lpips::write(&weights, Network::Alex, &procedural_lpips::names(Network::Alex));
    let base = ["eval", text(&model), "--data", text(posed.path()), "--json", text(&json), "--lpips-weights"];
    let base = [&base[..], &[text(&weights)]].concat();
    let line = bad_data(&[&base[..], &["--masks"]].concat());
    assert!(line.contains("mask") && !json.exists(), "{line}");
    let masks = posed.path().join("test/masks");
    std::fs::create_dir(&masks).unwrap();
    for (name, value) in [("r_000.png", 3), ("r_001.png", 0)] {
        image::GrayImage::from_pixel(40, 32, image::Luma([value])).save(masks.join(name)).unwrap();
    }
    ok(&[&base[..], &["--masks"]].concat());
    let e = read(&json);
    let [first, second] = [&e["images"][0], &e["images"][1]];
    assert_eq!(first["masked"]["psnr"], first["psnr"], "a mask of everything");
    assert!(second["masked"].is_null(), "a mask of nothing");
    assert_eq!(e["mean"]["masked"]["psnr"], first["psnr"]);
    // The paper's code feeds another range of values to the same network.
    let [package, paper] = ["lpips_alex", "lpips_paper"].map(|k| e["mean"][k].as_f64().unwrap());
    assert!(package > 0.0 && paper > 0.0 && package != paper, "{package}, {paper}");
    assert!(e["mean"]["lpips_vgg"].is_null());
}

/// The same model beside itself, and beside one that has nothing.
#[test]
fn other_models_are_drawn_beside() {
    let (posed, folder) = setup(&PosedOptions { test: 2, ..PosedOptions::default() });
    let at = |name: &str| folder.path().join(name);
    let (model, twin, empty, page) = (at("model.safetensors"), at("twin.json"), at("other.safetensors"), at("e.html"));
    let base = ["--data", text(posed.path()), "--json"];
    ok(&[&["eval", text(&model)][..], &base, &[text(&twin)]].concat());
    let mut none = engine::scene::synthetic::random_scene(1, 0, 0);
    none.gaussians.mean[0] = [0.0, 0.0, 1e6];
    engine::file::save(&empty, &none).unwrap();
    let compared = ["--beside", text(&twin), "--report", text(&page)];
    let said = |model: &Path| ok(&[&["eval", text(model)][..], &base, &[text(&at("e.json"))], &compared].concat());
    let line = said(&model);
    assert!(line.contains("twin: ") && line.contains("on 2 of these views") && line.contains("(+0.00)"), "{line}");
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(html.contains(">twin<") || html.contains("twin\n"), "the legend");
    let worse = said(&empty);
    assert!(worse.contains("twin: ") && worse.contains("(-"), "{worse}");
    std::fs::write(&twin, "{\"images\": [{\"name\": \"r_000\"}]}").unwrap();
    let line = bad_data(&[&["eval", text(&model)][..], &base, &[text(&at("f.json"))], &compared].concat());
    assert!(line.contains("twin.json") && line.contains("time") && !at("f.json").exists(), "{line}");
}

#[test]
fn bad_data_leave_no_report() {
    let (posed, folder) = setup(&PosedOptions { test: 2, ..PosedOptions::default() });
    let at = |name: &str| folder.path().join(name);
    let (model, json, report, out) = (at("model.safetensors"), at("e.json"), at("e.html"), at("pictures"));
    let run = |more: &[&str]| {
        let base = ["eval", text(&model), "--data", text(posed.path()), "--json", text(&json), "--report"];
        let line = bad_data(&[&base[..], &[text(&report), "--out", text(&out)], more].concat());
        let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["model.safetensors"], "{line}");
        line
    };
    assert!(run(&["--split", "val"]).contains("val"));
    let picture = posed.path().join("test/r_001.png");
    let whole = std::fs::read(&picture).unwrap();
    // The header is whole, so that only decoding fails, after the first view was scored.
    std::fs::write(&picture, &whole[..whole.len() / 2]).unwrap();
    assert!(run(&[]).contains("r_001"));
    std::fs::remove_file(&picture).unwrap();
    assert!(run(&[]).contains("r_001"));
    let unknown = spgs(&["eval", text(&model), "--data", text(posed.path()), "--scene", "nonsense"]);
    assert!(unknown.code == 3 || unknown.code == 2, "{unknown:?}");
}
