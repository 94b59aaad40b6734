//! The end of a run without network F.

use engine::scene::Scene;
use serde_json::Value;

use crate::common::{Posed, PosedOptions, checkpoints, config_file, log, posed, succeed, train};

const REFIT: &str =
    "iterations = 150\n[schedule]\nwarm_up = 10\n[density]\nenabled = false\n[refit]\niterations = 100\nerror = 0.02";

fn moving() -> Posed {
    posed(&PosedOptions { train: 12, swing: 0.5, ..PosedOptions::default() })
}

fn model(out: &std::path::Path) -> Scene {
    engine::file::load(&out.join("model.safetensors")).unwrap().scene
}

fn steps(out: &std::path::Path) -> Vec<u64> {
    log(out).iter().filter(|l| l["loss"].is_number()).map(|l| l["iteration"].as_u64().unwrap()).collect()
}

fn psnr(lines: &[Value]) -> f64 {
    lines.iter().rev().find_map(|l| l["evaluation"]["psnr"].as_f64()).unwrap()
}

#[test]
fn the_last_iterations_train_few_rigid_parts() {
    let (posed, folder) = (moving(), tempfile::tempdir().unwrap());
    let run = |name: &str, over: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let config = config_file(folder.path(), over);
        let given = if more.is_empty() { vec!["--config", config.to_str().unwrap()] } else { more.to_vec() };
        (succeed(train(&posed, &out, &given)), out)
    };
    let (said, out) = run("refitted", REFIT, &[]);
    assert!(said.contains("export  refit: ") && said.contains("8 before"), "{said}");
    assert_eq!(steps(&out), (1..=150).collect::<Vec<_>>(), "every iteration is one of the network's or of the parts'");
    assert!(checkpoints(&out).pop().unwrap().to_string_lossy().contains("50"), "{:?}", checkpoints(&out));
    let refitted = model(&out);
    assert!(refitted.deformation.superpoint_count() <= 8 && refitted.deformation.table().is_some());
    let config: Value = serde_json::from_str(&refitted.metadata["training"]).unwrap();
    assert_eq!(config["refit"]["iterations"], 100);
    let provenance: Value = serde_json::from_str(&refitted.metadata["provenance"]).unwrap();
    assert_eq!(provenance["iterations"], 150);

    // Without them the same run ends where they began.
    let (_, before) = run("before", &REFIT.replace("= 150", "= 50").replace("= 100", "= 0"), &[]);
    // Many Gaussians keep their superpoints, and learn too.
    let (said, kept) = run("kept", &format!("{REFIT}\nmost_divided = 10"), &[]);
    assert!(said.contains("refit: 8 superpoints, as before"), "{said}");
    assert_eq!(model(&kept).deformation.superpoint_count(), 8);
    let [with, kept, without] = [&out, &kept, &before].map(|out| psnr(&log(out)));
    println!("{with:.2} dB with parts, {kept:.2} dB with superpoints, {without:.2} dB without");
    assert!(with > without + 0.2 && kept > without + 0.2, "{with:.2} dB, {kept:.2} dB, {without:.2} dB without");

    // A run that was killed in them goes on at their beginning, with the same bits.
    std::fs::remove_file(out.join("model.safetensors")).unwrap();
    let (_, out) = run("refitted", REFIT, &["--resume"]);
    assert_eq!(steps(&out), (1..=150).collect::<Vec<_>>());
    let again = model(&out);
    assert!(again.gaussians == refitted.gaussians && again.deformation == refitted.deformation);
}

#[test]
fn a_model_that_keeps_network_f_is_trained_with_it_to_the_end() {
    let (posed, folder) = (moving(), tempfile::tempdir().unwrap());
    let out = folder.path().join("kept");
    let config = config_file(folder.path(), &format!("{REFIT}\n[export]\nkeep_network = true"));
    let said = succeed(train(&posed, &out, &["--config", config.to_str().unwrap()]));
    assert!(!said.contains("refit:"), "{said}");
    assert_eq!(steps(&out).len(), 150);
    assert!(model(&out).deformation.network().is_some());
}

#[test]
fn what_does_not_move_is_not_refitted() {
    let (posed, folder) = (moving(), tempfile::tempdir().unwrap());
    let out = folder.path().join("static");
    let config = config_file(folder.path(), REFIT);
    succeed(train(&posed, &out, &["--config", config.to_str().unwrap(), "--no-motion"]));
    assert_eq!(steps(&out).len(), 150);
    assert!(!model(&out).deformation.moves());
}
