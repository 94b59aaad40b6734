//! Metrics against the values of independent implementations.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use engine::file::picture;
use engine::metrics::{self, Planes};

fn planes(path: &Path) -> Planes {
    Planes::quantised(&picture::read(path).unwrap()).unwrap()
}

#[test]
fn published_implementations_agree() {
    let Some(folder) = tests_harness::data("oracle/metrics") else { return };
    let text = std::fs::read(folder.join("metrics.json")).unwrap();
    let oracle: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let pairs = oracle["pairs"].as_array().unwrap();
    assert!(!pairs.is_empty());
    for pair in pairs {
        let [reference, test] = ["reference", "test"].map(|k| planes(&folder.join(pair[k].as_str().unwrap())));
        let (scores, _) = metrics::score(&reference, &test, None).unwrap();
        let check = |key: &str, ours: f64, bound: f64| {
            let truth = pair[key].as_f64().unwrap();
            println!("{} {key}: {ours} (theirs {truth}, {:+.1e})", pair["test"], ours - truth);
            assert!((ours - truth).abs() <= bound, "{key}: {ours}, expected {truth}");
        };
        check("psnr", scores.psnr, 1e-6);
        check("ssim_zero_padded", scores.ssim, 1e-5);
        check("ssim_valid", scores.ssim_valid.unwrap(), 1e-5);
        check("ms_ssim", scores.ms_ssim.unwrap(), 1e-5);
        check("flip_ldr", scores.flip, 1e-3);
    }
}
