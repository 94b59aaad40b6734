//! What captures need: exposures that belong to photos, and masks of what does not belong to the scene.

use std::path::Path;

use engine::data::dataset::{self, DatasetOptions, MaskRule};
use engine::data::loader::ImageLoader;
use engine::render::RenderOptions;
use engine::scene::Scene;
use engine::train::evaluate;
use engine::train::exposure::EXPOSURE_WORDS;
use engine::train::trainer::{Trainer, TrainingData};
use engine::train::transients::{Transients, TransientsFound};
use image::{GrayImage, Luma, Rgba};

use crate::common::{
    Posed, PosedOptions, advance, config, config_file, gpu, load, posed, scene_of_resumed_run, succeed, train, trainer,
};

/// Nothing but what is looked at: photos of one time, no density control.
const STILL: &str = "
iterations = 300
[gaussians]
sh_degree = 0
random_points = 400
[motion]
enabled = false
[density]
enabled = false
[learning_rate]
sh_0 = 0.02
";

fn still() -> Posed {
    posed(&PosedOptions { moving: false, train: 12, test: 4, ..PosedOptions::default() })
}

/// Changes each training photo: number, place and pixel, alpha straight.
fn edit_photos(folder: &Path, mut change: impl FnMut(usize, [u32; 2], &mut Rgba<u8>)) {
    for i in 0..12 {
        let path = folder.join(format!("train/r_{i:03}.png"));
        let mut photo = image::open(&path).unwrap().into_rgba8();
        photo.enumerate_pixels_mut().for_each(|(x, y, pixel)| change(i, [x, y], pixel));
        photo.save(&path).unwrap();
    }
}

/// The run's trainer, and PSNR on the test views.
fn run(posed: &Posed, over: &str, masks: MaskRule) -> (Trainer, f64) {
    let gpu = gpu();
    let data = dataset::load(posed.path(), &DatasetOptions { masks, ..DatasetOptions::default() }).unwrap();
    let training = TrainingData { views: data.train.clone().into(), extent: data.extent, is_static: data.is_static };
    let mut trainer = trainer(&gpu, &config(&format!("{STILL}{over}")), &training).unwrap();
    advance(&mut trainer, 300).unwrap();
    let psnr = held_out(&trainer.scene().unwrap(), data.test);
    (trainer, psnr)
}

fn held_out(scene: &Scene, test: Vec<dataset::View>) -> f64 {
    let all: Vec<usize> = (0..test.len()).collect();
    let loader = ImageLoader::new(test.into(), 1 << 30, 0).unwrap();
    let scores = evaluate::evaluate(&gpu(), scene, &loader, &all, &RenderOptions::default(), |_, _, _| Ok(())).unwrap();
    evaluate::mean(&scores)[0]
}

#[test]
fn photos_of_many_exposures_make_one_scene() {
    let posed = still();
    let plain = run(&posed, "", MaskRule::Auto).1;
    // Darker and brighter, redder and bluer; on average as they were.
    let gain = |i: usize| [[0.6, 0.7, 0.8], [1.0, 0.9, 0.9], [1.4, 1.4, 1.3]][i % 3];
    edit_photos(posed.path(), |i, _, pixel| {
        (0..3).for_each(|c| pixel[c] = (f64::from(pixel[c]) * gain(i)[c]).round().min(255.0) as u8);
    });
    let as_they_are = run(&posed, "", MaskRule::Auto).1;
    let (trainer, learnt) = run(&posed, "exposure = 0.06", MaskRule::Auto);
    println!("{plain:.2} dB of one exposure; of three: {as_they_are:.2} dB, with exposures {learnt:.2} dB");
    assert!(learnt > as_they_are + 2.0 && learnt > plain - 4.0, "{learnt:.2} dB");
    // Whose photo is brighter has the larger map: what it makes of a grey.
    let rows = trainer.exposures().unwrap().unwrap();
    let red = |i: usize| rows[EXPOSURE_WORDS * i..][..3].iter().sum::<f32>();
    let mean = |group: usize| (0..4).map(|k| red(3 * k + group)).sum::<f32>() / 4.0;
    let [dark, usual, bright] = [0, 1, 2].map(mean);
    assert!(dark < usual - 0.2 && usual < bright - 0.2, "{dark} {usual} {bright}");
}

#[test]
fn a_run_with_exposures_goes_on_with_the_same_bits() {
    scene_of_resumed_run("[learning_rate]\nexposure = 0.02");
}

#[test]
fn exposures_are_written_beside_the_model() {
    let (posed, folder) =
        (posed(&PosedOptions { train: 12, swing: 0.5, ..PosedOptions::default() }), tempfile::tempdir());
    let folder = folder.unwrap();
    let over = "[learning_rate]\nexposure = 0.01\n[density]\nenabled = false\n[refit]\niterations = 20";
    let config = config_file(folder.path(), over);
    let out = folder.path().join("out");
    let said = succeed(train(&posed, &out, &["--config", config.to_str().unwrap()]));
    assert!(said.contains("exposures of 12 photos in exposures.json"), "{said}");
    let text = std::fs::read_to_string(out.join("exposures.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let photos = json["photos"].as_array().unwrap();
    let (data, _) = load(&posed);
    assert!(photos.iter().zip(&data.train).all(|(p, v)| p["name"] == v.name.as_str()) && photos.len() == 12);
    let first: f64 = photos[0]["map"][0][0].as_f64().unwrap();
    assert!((0.5..1.5).contains(&first) && first != 1.0, "{first}");
}

#[test]
fn what_masks_leave_out_is_not_trained() {
    let posed = still();
    let plain = run(&posed, "", MaskRule::Auto).1;
    // A magenta square in each photo, elsewhere in each.
    let square = |i: usize, [x, y]: [u32; 2]| {
        let (left, top) = (4 + (i as u32 * 5) % 18, 3 + (i as u32 * 7) % 12);
        (left..left + 8).contains(&x) && (top..top + 8).contains(&y)
    };
    edit_photos(posed.path(), |i, at, pixel| {
        if square(i, at) {
            *pixel = Rgba([255, 0, 255, 255]);
        }
    });
    let masks = posed.path().join("train/masks");
    std::fs::create_dir(&masks).unwrap();
    for i in 0..12 {
        // Twice the size of the photos: they are made smaller.
        let shade = |x: u32, y: u32| Luma([if square(i, [x / 2, y / 2]) { 0 } else { 255 }]);
        GrayImage::from_fn(64, 48, shade).save(masks.join(format!("r_{i:03}.png"))).unwrap();
    }
    let unmasked = run(&posed, "", MaskRule::Auto).1;
    let (_, masked) = run(&posed, "", MaskRule::White);
    let (_, inverted) = run(&posed, "", MaskRule::Black);
    println!("{plain:.2} dB; with squares {unmasked:.2} dB, masked {masked:.2} dB, all else masked {inverted:.2} dB");
    assert!(masked > unmasked + 2.0 && masked > plain - 1.0 && inverted < unmasked, "{masked:.2} dB");
}

/// What one photo alone shows: a magenta disc in each, elsewhere in each.
fn add_transients(posed: &Posed) {
    let disc = |i: usize, [x, y]: [u32; 2]| {
        let (left, top) = (8 + (i as i64 * 5) % 18, 7 + (i as i64 * 7) % 12);
        (i64::from(x) - left).pow(2) + (i64::from(y) - top).pow(2) <= 16
    };
    edit_photos(posed.path(), |i, at, pixel| {
        if disc(i, at) {
            *pixel = Rgba([255, 0, 255, 255]);
        }
    });
}

const TRANSIENTS: &str = "[loss]\ntransients = 3\ntransients_from = 60\n[schedule]\nscale = false";

#[test]
fn what_one_photo_alone_shows_is_not_trained() {
    let posed = still();
    let plain = run(&posed, "", MaskRule::Auto).1;
    let (clean, looked_at) = run(&posed, TRANSIENTS, MaskRule::Auto);
    add_transients(&posed);
    let believed = run(&posed, "", MaskRule::Auto).1;
    let (trainer, robust) = run(&posed, TRANSIENTS, MaskRule::Auto);
    println!("{plain:.2} dB, looked at {looked_at:.2} dB; with discs {believed:.2} dB, looked at {robust:.2} dB");
    let found = |trainer: &Trainer| Transients::from_words(&trainer.transients().unwrap(), 12).unwrap();
    // A disc has 49 of 768 pixels; what it reaches is left out, too.
    let TransientsFound { photos, share } = found(&trainer).found();
    println!("{photos} photos, {share:.4}");
    assert!(robust > believed + 0.7 && robust > plain - 1.2 && looked_at > plain - 0.5, "{robust:.2} dB");
    assert!(photos == 12 && (0.064..0.16).contains(&share), "{share} of {photos} photos");
    assert!(found(&clean).found().share < 0.01);
}

#[test]
fn a_run_with_transients_goes_on_with_the_same_bits() {
    scene_of_resumed_run("[loss]\ntransients = 1.5\ntransients_from = 5\n[schedule]\nscale = false");
}

#[test]
fn what_is_left_out_is_written_beside_the_model() {
    let (posed, folder) =
        (posed(&PosedOptions { train: 12, swing: 0.5, ..PosedOptions::default() }), tempfile::tempdir());
    add_transients(&posed);
    let folder = folder.unwrap();
    let over = "[loss]\ntransients = 2\ntransients_from = 5\n[density]\nenabled = false\n[refit]\niterations = 20";
    let config = config_file(folder.path(), over);
    let out = folder.path().join("out");
    // Those of an earlier run.
    std::fs::create_dir_all(out.join("transients")).unwrap();
    (0..12).for_each(|i| std::fs::write(out.join(format!("transients/{i:05}.png")), "old").unwrap());
    let said = succeed(train(&posed, &out, &["--config", config.to_str().unwrap()]));
    let masks: Vec<_> = std::fs::read_dir(out.join("transients")).unwrap().collect();
    assert!(
        !masks.is_empty() && said.contains(&format!("of {} of 12 photos; masks in transients/", masks.len())),
        "{said}"
    );
    for mask in masks {
        let mask = image::open(mask.unwrap().path()).unwrap().into_luma8();
        assert!(mask.dimensions() == (32, 24) && mask.pixels().all(|p| p[0] == 0 || p[0] == 255));
    }
    let log = std::fs::read_to_string(out.join("run.jsonl")).unwrap();
    assert!(log.contains("\"transients\":{"), "{log}");

    // Nor does a run that believes its photos keep them.
    let believing = folder.path().join("believing");
    std::fs::create_dir_all(believing.join("transients")).unwrap();
    (0..12).for_each(|i| std::fs::write(believing.join(format!("transients/{i:05}.png")), "old").unwrap());
    let config = config_file(folder.path(), "[density]\nenabled = false\n[refit]\niterations = 20");
    let said = succeed(train(&posed, &believing, &["--config", config.to_str().unwrap()]));
    assert!(
        !said.contains("transients") && believing.join("transients").read_dir().unwrap().next().is_none(),
        "{said}"
    );
}
