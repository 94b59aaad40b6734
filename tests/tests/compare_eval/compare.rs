//! Pictures and folders, and what goes wrong with them.

use engine::file::picture as files;
use engine::metrics::lpips::{Network, Range, WeightsFile, lpips};
use engine::metrics::{self, Planes};
use tests_harness::procedural_lpips;

use super::common::{assert_close, bad_data, ok, ok_json, picture, spgs, text, write};

const KEYS: [&str; 7] = ["psnr", "ssim", "ssim_valid", "ms_ssim", "flip", "lpips_alex", "lpips_vgg"];

#[test]
fn two_pictures_have_exactly_the_engine_s_values() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a.png", "b.png"].map(|n| folder.path().join(n));
    write(&a, &picture([190, 170], 1));
    write(&b, &picture([190, 170], 2));
    let json = ok_json(&["compare", text(&a), text(&b), "--json"]);
    let planes = |path| Planes::quantised(&files::read(path).unwrap()).unwrap();
    let (truth, _) = metrics::score(&planes(&a), &planes(&b), None).unwrap();
    assert_close(&json["psnr"], truth.psnr);
    assert_close(&json["ssim"], truth.ssim);
    assert_close(&json["ssim_valid"], truth.ssim_valid.unwrap());
    assert_close(&json["ms_ssim"], truth.ms_ssim.unwrap());
    assert_close(&json["flip"], truth.flip);
    for key in ["lpips_alex", "lpips_vgg"] {
        assert!(json.get(key).unwrap().is_null(), "no number without weights");
        assert!(json["notes"].to_string().contains(key), "{json}");
    }
    let plain = ok(&["compare", text(&a), text(&b)]);
    assert!(plain.contains("psnr") && plain.contains(&format!("{:.2}", truth.psnr)), "{plain}");
}

#[test]
fn weights_give_lpips_of_the_network_that_they_are_of() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b, weights] = ["a.png", "b.png", "w.safetensors"].map(|n| folder.path().join(n));
    write(&a, &picture([40, 33], 1));
    write(&b, &picture([40, 33], 2));
    procedural_lpips::write(&weights, Network::Alex, &procedural_lpips::names(Network::Alex));
    let json = ok_json(&["compare", text(&a), text(&b), "--json", "--lpips-weights", text(&weights)]);
    let planes = |path| Planes::quantised(&files::read(path).unwrap()).unwrap();
    let file = WeightsFile::read(&weights).unwrap();
    let truth = lpips(file.get(Network::Alex).unwrap(), &planes(&a), &planes(&b), Range::default()).unwrap();
    let ours = json["lpips_alex"].as_f64().unwrap();
    assert!((ours - truth).abs() < 1e-5 * truth, "{ours}, {truth}");
    assert!(json["lpips_vgg"].is_null() && !json["notes"].to_string().contains("lpips_alex"), "{json}");
    // Too small a picture for the network has no number either.
    write(&a, &picture([20, 20], 1));
    let json = ok_json(&["compare", text(&a), text(&a), "--json", "--lpips-weights", text(&weights)]);
    assert!(json["lpips_alex"].is_null() && json["notes"].to_string().contains("31 pixels"), "{json}");
}

#[test]
fn folders_are_paired_by_name_and_averaged() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|n| folder.path().join(n));
    for (dir, seed) in [(&a, 1), (&b, 10)] {
        std::fs::create_dir(dir).unwrap();
        for i in 0..3 {
            let image = picture([30, 20], seed + i);
            if i == 2 && seed == 10 {
                files::write_exr(&dir.join(format!("{i}.exr")), &image).unwrap();
            } else {
                write(&dir.join(format!("{i}.png")), &image);
            }
        }
        std::fs::write(dir.join("notes.txt"), "no picture").unwrap();
    }
    let out = folder.path().join("errors");
    let json = ok_json(&["compare", text(&a), text(&b), "--json", "--out", text(&out)]);
    let images = json["images"].as_array().unwrap();
    assert_eq!(images.iter().map(|i| i["name"].as_str().unwrap()).collect::<Vec<_>>(), ["0", "1", "2"]);
    for key in KEYS {
        assert!(images[0].get(key).is_some() && json["mean"].get(key).is_some(), "{key}");
    }
    let mean = images.iter().map(|i| i["psnr"].as_f64().unwrap()).sum::<f64>() / 3.0;
    assert!((json["mean"]["psnr"].as_f64().unwrap() - mean).abs() < 1e-12);
    assert!(json["mean"]["ms_ssim"].is_null() && json["notes"].to_string().contains("ms_ssim"));
    for name in ["0_flip.png", "1_error.png", "2_flip.png"] {
        assert_eq!(files::read(&out.join(name)).unwrap().width, 30);
    }
    let single = folder.path().join("flip.png");
    ok(&["compare", text(&a.join("0.png")), text(&b.join("0.png")), "--out", text(&single)]);
    assert_eq!(std::fs::read(&single).unwrap(), std::fs::read(out.join("0_flip.png")).unwrap());
}

#[test]
fn equal_pictures_are_equal_and_alpha_is_over_the_background() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a.png", "b.png"].map(|n| folder.path().join(n));
    let mut image = picture([20, 20], 3);
    image.rgba.chunks_exact_mut(4).for_each(|p| p[3] = 0.5);
    files::write_png(&a, &image, files::Alpha::Straight).unwrap();
    files::write_png(&b, &image, files::Alpha::Straight).unwrap();
    let json = ok_json(&["compare", text(&a), text(&b), "--json"]);
    assert_eq!((json["psnr"].as_f64(), json["flip"].as_f64()), (Some(300.0), Some(0.0)));
    // Against black, half of white behind everything is a difference of a half.
    let mut over = files::read(&a).unwrap();
    over.rgba.chunks_exact_mut(4).for_each(|p| (p[0], p[1], p[2], p[3]) = (p[0] * p[3], p[1] * p[3], p[2] * p[3], 1.0));
    files::write_exr(&folder.path().join("black.exr"), &over).unwrap();
    let arguments = |c| ["compare", text(&a), "BLACK", "--json", "--background", c].map(str::to_owned);
    let psnr = |c| {
        let mut list = arguments(c);
        list[2] = text(&folder.path().join("black.exr")).to_owned();
        ok_json(&list.each_ref().map(String::as_str))["psnr"].as_f64().unwrap()
    };
    assert!(psnr("0,0,0") > 100.0, "{}", psnr("0,0,0"));
    assert!(psnr("1,1,1") < 10.0);
}

#[test]
fn bad_pictures_get_one_line_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let [a, b, small, nan, broken] = ["a.png", "b.png", "small.png", "nan.exr", "broken.png"].map(at);
    write(&a, &picture([20, 16], 1));
    write(&b, &picture([20, 16], 2));
    write(&small, &picture([16, 20], 2));
    let mut image = picture([20, 16], 2);
    image.rgba[4 * 25 + 1] = f32::NAN;
    files::write_exr(&nan, &image).unwrap();
    std::fs::write(&broken, &std::fs::read(&a).unwrap()[..60]).unwrap();
    let out = at("out");
    let wrong = |x: &std::path::Path, y: &std::path::Path| {
        let line = bad_data(&["compare", text(x), text(y), "--json", "--out", text(&out)]);
        assert!(!out.exists(), "a failed comparison left its folder");
        line
    };
    assert!(wrong(&a, &at("none.png")).contains("none.png"));
    let line = wrong(&a, &small);
    assert!(line.contains("16 x 20") && line.contains("20 x 16") && line.contains("small.png"), "{line}");
    let line = wrong(&a, &nan);
    assert!(line.contains("nan.exr") && line.contains("(5, 1)") && line.contains("G = NaN"), "{line}");
    assert!(wrong(&a, &broken).contains("broken.png"));
    // Folders: empty, of other names, with one bad picture at the end.
    let [empty, left, right] = ["empty", "left", "right"].map(at);
    for dir in [&empty, &left, &right] {
        std::fs::create_dir(dir).unwrap();
    }
    assert!(wrong(&empty, &empty).contains("none"));
    assert!(wrong(&a, &empty).contains("empty"));
    for name in ["0.png", "1.png"] {
        std::fs::copy(&a, left.join(name)).unwrap();
    }
    std::fs::copy(&a, right.join("0.png")).unwrap();
    let line = wrong(&left, &right);
    assert!(line.contains("right") && line.contains("`1`"), "{line}");
    std::fs::copy(&small, right.join("1.png")).unwrap();
    assert!(wrong(&left, &right).contains("1.png"));
    std::fs::copy(&a, right.join("1.jpg")).unwrap();
    assert!(wrong(&left, &right).contains("one image of each name"));
    // Weights that are no weights.
    let line = bad_data(&["compare", text(&a), text(&b), "--lpips-weights", text(&broken)]);
    assert!(line.contains("broken.png"), "{line}");
    assert_eq!(spgs(&["compare", text(&left), text(&left), "--out", text(&at("x.png"))]).code, 2);
}
