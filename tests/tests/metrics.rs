//! Metrics against the values of independent implementations.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::{Path, PathBuf};

use engine::file::{picture, tensors};
use engine::metrics::lpips::{Lpips, Network, Range, Weights, WeightsFile};
use engine::metrics::{self, Planes};
use serde_json::Value;
use tests_harness::procedural_lpips;

fn planes(path: &Path) -> Planes {
    Planes::quantised(&picture::read(path).unwrap()).unwrap()
}

fn oracle() -> Option<(PathBuf, Value)> {
    let folder = tests_harness::data("oracle/metrics")?;
    let text = std::fs::read(folder.join("metrics.json")).unwrap();
    Some((folder, serde_json::from_slice(&text).unwrap()))
}

fn pair(folder: &Path, pair: &Value) -> [Planes; 2] {
    ["reference", "test"].map(|k| planes(&folder.join(pair[k].as_str().unwrap())))
}

fn check(pair: &Value, key: &str, ours: f64, bound: f64) {
    let truth = pair[key].as_f64().unwrap();
    println!("{} {key}: {ours} (theirs {truth}, {:+.1e})", pair["test"], ours - truth);
    assert!((ours - truth).abs() <= bound, "{key}: {ours}, expected {truth}");
}

#[test]
fn published_implementations_agree() {
    let Some((folder, oracle)) = oracle() else { return };
    let pairs = oracle["pairs"].as_array().unwrap();
    assert!(!pairs.is_empty());
    for p in pairs {
        let [reference, test] = pair(&folder, p);
        let begin = std::time::Instant::now();
        let (scores, _) = metrics::score(&reference, &test, None).unwrap();
        println!("{:?} for {} pixels", begin.elapsed(), reference.pixels());
        check(p, "psnr", scores.psnr, 1e-6);
        check(p, "ssim_zero_padded", scores.ssim, 1e-5);
        check(p, "ssim_valid", scores.ssim_valid.unwrap(), 1e-5);
        check(p, "ms_ssim", scores.ms_ssim.unwrap(), 1e-5);
        check(p, "flip_ldr", scores.flip, 1e-3);
    }
}

fn oracle_weights(oracle: &Value, network: Network) -> Weights {
    let names = oracle["lpips_tensors"][network.name()].as_array().unwrap();
    procedural_lpips::weights(network, &names.iter().map(|n| n.as_str().unwrap().to_owned()).collect::<Vec<_>>())
}

fn lpips_agrees(network: Network, of_pair: impl Fn(usize) -> bool) {
    let Some((folder, oracle)) = oracle() else { return };
    let gpu = tests_harness::gpu();
    let lpips = Lpips::new(&gpu, &oracle_weights(&oracle, network)).unwrap();
    let key = format!("lpips_{}", network.name());
    for (i, p) in oracle["pairs"].as_array().unwrap().iter().enumerate().filter(|(i, _)| of_pair(*i)) {
        let [reference, test] = pair(&folder, p);
        let begin = std::time::Instant::now();
        let ours = lpips.distance(&reference, &test, Range::default()).unwrap();
        println!("pair {i}, {:?}", begin.elapsed());
        check(p, &key, ours, 1e-3);
    }
}

#[test]
fn lpips_alex_agrees_with_the_package() {
    lpips_agrees(Network::Alex, |_| true);
}

#[test]
fn lpips_vgg_agrees_with_the_package_on_the_smallest_pair() {
    lpips_agrees(Network::Vgg, |i| i == 2);
}

#[test]
#[ignore = "minutes on software Vulkan: 0.2 and 0.7 Tflop"]
fn lpips_vgg_agrees_with_the_package_on_the_large_pairs() {
    lpips_agrees(Network::Vgg, |i| i != 2);
}

#[test]
fn bad_weights_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.safetensors");
    let write = |list: Vec<(&str, Vec<usize>, Vec<f32>)>| {
        let tensors = list.iter().map(|(n, s, v)| tensors::floats(*n, s.clone(), v)).collect();
        tensors::write(&path, ["test", "1"], tensors, &Default::default()).unwrap();
        WeightsFile::read(&path).unwrap_err().to_string()
    };
    assert!(write(vec![("x", vec![1], vec![1.0])]).contains("net.slice1.0.weight"));
    assert!(write(vec![("net.slice1.0.weight", vec![1, 2], vec![1.0; 2])]).contains("[1, 2]"));
    let first = ("net.slice1.0.weight", vec![64, 3, 11, 11], vec![1.0; 64 * 363]);
    assert!(write(vec![first.clone()]).contains("net.slice1.0.bias"));
    let bias = ("net.slice1.0.bias", vec![64], vec![f32::NAN; 64]);
    let message = write(vec![first, bias]);
    assert!(message.contains("net.slice1.0.bias") && message.contains("NaN"), "{message}");
    std::fs::write(&path, b"no tensors").unwrap();
    assert_eq!(WeightsFile::read(&path).unwrap_err().exit_code(), 3);
}
