//! A scene written in each format and read back is the same within the format's precision.

use engine::file::{self, Output};
use engine::scene::synthetic::{moving_scene, random_gaussians};
use engine::scene::{Gaussians, Scene};

/// How far values may be off: positions (of the extent), log scales, quaternions (1 − |dot|), opacity, SH of degree 0, SH
/// above.
struct Precision {
    position: f64,
    log_scale: f64,
    rotation: f64,
    opacity: f64,
    color: f64,
    sh: f64,
}

/// Fields of 11 and 10 bits between the bounds of 256 Gaussians; 8 bits for colour and SH, SH within ±4.
const COMPRESSED: Precision =
    Precision { position: 5e-4, log_scale: 4e-3, rotation: 3e-6, opacity: 0.002, color: 0.02, sh: 0.0157 };
/// f32, f32, 8 bits per part, 8 bits.
const SPLAT: Precision =
    Precision { position: 0.0, log_scale: 1e-5, rotation: 2e-4, opacity: 0.002, color: 0.007, sh: 0.0 };
/// 24 bits, 1/16, 10 bits, 8 bits, 8 bits over ±3.33, 8 bits within ±1.
const SPZ: Precision =
    Precision { position: 1e-6, log_scale: 0.03126, rotation: 4e-6, opacity: 0.002, color: 0.0131, sh: 0.00392 };
/// 16 bits, 256 values, 8 bits per part, 8 bits, 256 values.
const SOG: Precision =
    Precision { position: 2e-5, log_scale: 0.06, rotation: 5e-5, opacity: 0.002, color: 0.05, sh: 0.05 };
const GLTF: Precision =
    Precision { position: 0.0, log_scale: 2e-6, rotation: 1e-7, opacity: 2e-6, color: 0.0, sh: 0.0 };

fn sigmoid(v: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(v)).exp())
}

/// The nearest Gaussian: formats may change the order.
fn partner(of: &[f32; 3], among: &Gaussians) -> usize {
    let squared = |m: &[f32; 3]| of.iter().zip(m).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
    (0..among.len()).min_by(|&a, &b| squared(&among.mean[a]).total_cmp(&squared(&among.mean[b]))).unwrap()
}

fn check(name: &str, before: &Gaussians, after: &Gaussians, p: &Precision) {
    assert_eq!(before.len(), after.len(), "{name}");
    let extent = before.mean.as_flattened().iter().fold(0.0f32, |m, v| m.max(v.abs())) * 2.0;
    let (k, k_after) = (before.sh_coefficients() * 3, after.sh_coefficients() * 3);
    for i in 0..before.len() {
        let j = partner(&before.mean[i], after);
        let near = |what: &str, a: f32, b: f32, tolerance: f64| {
            let off = (f64::from(a) - f64::from(b)).abs();
            assert!(off <= tolerance, "{name}, Gaussian {i}, {what}: {a} became {b}, off by {off}");
        };
        for c in 0..3 {
            near("position", before.mean[i][c], after.mean[j][c], p.position * f64::from(extent));
            near("log scale", before.log_scale[i][c], after.log_scale[j][c], p.log_scale);
        }
        let (a, b) = (glam::Vec4::from(before.rotation[i]).as_dvec4(), glam::Vec4::from(after.rotation[j]).as_dvec4());
        let dot = a.normalize().dot(b.normalize()).abs();
        assert!(1.0 - dot <= p.rotation, "{name}, Gaussian {i}, rotation: {a} became {b}");
        let off = (sigmoid(before.opacity_logit[i]) - sigmoid(after.opacity_logit[j])).abs();
        assert!(off <= p.opacity, "{name}, Gaussian {i}, opacity off by {off}");
        for c in 0..k_after {
            let tolerance = if c < 3 { p.color } else { p.sh };
            near("SH", before.sh[i * k + c], after.sh[j * k_after + c], tolerance);
        }
    }
}

/// Colours within [0, 1], which `.splat` clamps to.
fn gaussians(degree: u32) -> Gaussians {
    let mut g = random_gaussians(1500, 11, degree);
    let k3 = g.sh_coefficients() * 3;
    for sh in g.sh.chunks_exact_mut(k3) {
        sh[..3].iter_mut().for_each(|v| *v = v.clamp(-1.7, 1.7));
        sh[3..].iter_mut().for_each(|v| *v = v.clamp(-0.9, 0.9));
    }
    g
}

#[test]
fn every_format_keeps_its_precision() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [("a.compressed.ply", COMPRESSED), ("a.splat", SPLAT), ("a.spz", SPZ), ("a.sog", SOG), ("a.glb", GLTF)];
    for degree in [0, 1, 3] {
        let scene = Scene { gaussians: gaussians(degree), ..Scene::default() };
        for (name, precision) in &cases {
            let path = folder.path().join(name);
            let warnings = file::save(&path, &scene).unwrap();
            assert_eq!(warnings.len(), usize::from(*name == "a.splat" && degree > 0), "{warnings:?}");
            let loaded = file::load(&path).unwrap();
            assert_eq!(loaded.rejected.total(), 0);
            check(&format!("{name} of degree {degree}"), &scene.gaussians, &loaded.scene.gaussians, precision);
        }
    }
}

#[test]
fn ply_and_model_keep_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    let scene = moving_scene(300, 7, 5, 3, true);
    for name in ["a.ply", "a.safetensors"] {
        let path = folder.path().join(name);
        file::save(&path, &scene).unwrap();
        let back = file::load(&path).unwrap().scene;
        assert_eq!(back.gaussians, scene.gaussians);
        let again = folder.path().join(format!("again.{name}"));
        file::save(&again, &back).unwrap();
        assert!(std::fs::read(&path).unwrap() == std::fs::read(&again).unwrap(), "{name}");
        if name == "a.safetensors" {
            assert_eq!(back, scene);
        }
    }
}

/// Writing what was read changes nothing more: the second loss is none, or rounding.
#[test]
fn a_second_round_trip_loses_next_to_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene { gaussians: gaussians(2), ..Scene::default() };
    let tight = Precision { position: 5e-4, log_scale: 3e-3, rotation: 1e-4, opacity: 1e-6, color: 0.009, sh: 1e-5 };
    for name in ["a.spz", "a.splat", "a.sog", "a.compressed.ply", "a.glb"] {
        let (first, second) = (folder.path().join(name), folder.path().join(format!("b{}", &name[1..])));
        file::save(&first, &scene).unwrap();
        let once = file::load(&first).unwrap().scene;
        file::save(&second, &once).unwrap();
        check(name, &once.gaussians, &file::load(&second).unwrap().scene.gaussians, &tight);
    }
}

#[test]
fn endings_decide_and_others_are_refused() {
    let of = |name: &str| Output::of_name(std::path::Path::new(name));
    assert_eq!(of("x/a.compressed.PLY").unwrap(), Output::CompressedPly);
    assert_eq!(of("a.ply").unwrap(), Output::Ply);
    for bad in ["a", "a.obj", "ply", "a.ply.zip"] {
        assert!(matches!(of(bad), Err(engine::Error::Usage { .. })), "{bad}");
    }
    let empty = Scene::default();
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.sog", "a.glb"] {
        assert!(matches!(file::save(&folder.path().join(name), &empty), Err(engine::Error::Usage { .. })), "{name}");
    }
    for name in ["a.spz", "a.splat", "a.compressed.ply", "a.ply"] {
        let path = folder.path().join(name);
        file::save(&path, &empty).unwrap();
        let loaded = file::load(&path);
        assert!(loaded.is_ok_and(|l| l.scene.gaussians.is_empty()), "{name}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 4, "a refused file leaves nothing behind");
}
