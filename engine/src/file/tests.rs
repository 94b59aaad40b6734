//! Loading and saving, cleaning, pictures; the scenes that the format tests share.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use super::*;
use crate::scene::network::DeformSize;
use crate::scene::{
    Association, DeformNetwork, Gaussians, Linear, Motion, NonrigidNetwork, SuperpointDeformation, Superpoints, Tensor,
};

/// A small deterministic generator (a 64-bit LCG's high bits): values over several magnitudes.
pub(crate) struct Values(pub(crate) u64);

impl Values {
    pub(crate) fn bits(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 32) as u32
    }

    pub(crate) fn next(&mut self) -> f32 {
        let unit = self.bits() as f32 / 4294967296.0 - 0.5;
        unit * [1.0e-3, 1.0, 10.0][self.bits() as usize % 3]
    }

    fn many<const W: usize>(&mut self, n: usize) -> Vec<[f32; W]> {
        (0..n).map(|_| std::array::from_fn(|_| self.next())).collect()
    }

    fn floats(&mut self, n: usize) -> Vec<f32> {
        (0..n).map(|_| self.next()).collect()
    }
}

pub(crate) fn gaussians(n: usize, sh_degree: u32) -> Gaussians {
    let mut v = Values(n as u64 * 31 + u64::from(sh_degree));
    let k = ((sh_degree + 1) * (sh_degree + 1)) as usize;
    let (mean, log_scale, rotation, opacity_logit) = (v.many(n), v.many(n), v.many(n), v.floats(n));
    Gaussians { mean, log_scale, rotation, opacity_logit, sh_degree, sh: v.floats(n * k * 3), ..Gaussians::default() }
}

/// A scene with every feature.
pub(crate) fn full_scene(n: usize, m: usize, t: usize) -> Scene {
    let mut v = Values(7);
    let mut layer = |inputs: usize, outputs: usize| Linear {
        inputs,
        outputs,
        weight: v.floats(inputs * outputs),
        bias: v.floats(outputs),
    };
    let size = DeformSize { layers: 3, width: 64 };
    let deform = DeformNetwork {
        linear: (0..size.layers).map(|i| layer(size.layer_inputs(i), size.width)).collect(),
        translation: layer(size.width, 3),
        rotation: layer(size.width, 3),
    };
    let mut scene = moving_scene(n, m, t);
    let superpoints = scene.deformation.superpoint_deformation_mut().unwrap();
    (superpoints.network, superpoints.nonrigid) = (Some(deform), Some(NonrigidNetwork::init(5)));
    scene
}

/// A scene with everything but the networks (whose 2 MB would slow tests over every byte).
pub(crate) fn moving_scene(n: usize, m: usize, t: usize) -> Scene {
    let mut v = Values(8);
    let deformation = SuperpointDeformation {
        superpoints: Superpoints { of_gaussian: (0..n).map(|i| (i % m) as u32).collect(), position: v.many(m) },
        table: Some(Motion {
            times: (0..t).map(|i| i as f32 * 0.25 - 0.1).collect(),
            rotation: v.many(t * m),
            translation: v.many(t * m),
        }),
        association: Some(Association {
            neighbors: 2,
            neighbor: (0..2 * n).map(|i| (i * 5 % m) as u32).collect(),
            logit: v.floats(2 * n),
        }),
        ..SuperpointDeformation::default()
    };
    Scene {
        gaussians: gaussians(n, 1),
        deformation: deformation.into(),
        extra: [
            ("nonrigid.notes".to_string(), Tensor { shape: vec![2, 3], data: v.floats(6) }),
            ("gaussians.age".to_string(), Tensor { shape: vec![n, 2], data: v.floats(2 * n) }),
        ]
        .into(),
        metadata: [("dataset".to_string(), "lego \"test\" µ".to_string()), ("training".into(), "{\"n\":1}".into())]
            .into(),
    }
}

fn poisoned() -> (Scene, usize) {
    let mut scene = moving_scene(40, 4, 3);
    let g = &mut scene.gaussians;
    for (j, bad) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY].into_iter().enumerate() {
        g.mean[j][j] = bad;
        g.log_scale[3 + j][j] = bad;
        g.rotation[6 + j][j] = bad;
        g.sh[(9 + j) * 12 + 11] = bad;
    }
    g.opacity_logit[12] = f32::NAN;
    g.rotation[13] = [0.0; 4];
    g.rotation[14] = [1.0e30; 4];
    g.log_scale[15] = [31.0, 0.0, 0.0];
    g.log_scale[16] = [-1.0e9, 0.0, 0.0];
    g.mean[17] = [2.0e15, 0.0, 0.0];
    g.sh[18 * 12] = -2.0e6;
    // Limits that stay.
    g.opacity_logit[20] = f32::INFINITY;
    g.opacity_logit[21] = f32::NEG_INFINITY;
    g.log_scale[22] = [30.0, -30.0, 0.0];
    (scene, 19)
}

#[test]
fn formats_keep_that_a_scene_is_antialiased_or_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = Scene { gaussians: gaussians(5, 1), ..Scene::default() };
    scene.gaussians.antialiased = true;
    let warnings = save(&folder.path().join("a.ply"), &scene).unwrap();
    assert!(warnings.len() == 1 && warnings[0].contains("antialiased"), "{warnings:?}");
    for name in ["a.safetensors", "a.spz"] {
        assert!(save(&folder.path().join(name), &scene).unwrap().is_empty());
        assert!(load(&folder.path().join(name)).unwrap().scene.gaussians.antialiased, "{name}");
    }
    assert_eq!(load(&folder.path().join("a.safetensors")).unwrap().scene, scene);
    scene.metadata.insert("antialiased".into(), "maybe".into());
    scene.gaussians.antialiased = false;
    save(&folder.path().join("b.safetensors"), &scene).unwrap();
    let error = load(&folder.path().join("b.safetensors")).unwrap_err().to_string();
    assert!(error.contains("antialiased") && error.contains("maybe"), "{error}");
}

#[test]
fn formats_without_lifespans_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = Scene { gaussians: gaussians(5, 1), ..Scene::default() };
    scene.gaussians.optional = crate::scene::synthetic::random_optional(5, 1);
    let warnings = save(&folder.path().join("a.ply"), &scene).unwrap();
    assert!(warnings.len() == 1 && warnings[0].contains("lifespans"), "{warnings:?}");
    assert!(save(&folder.path().join("a.safetensors"), &scene).unwrap().is_empty());
    assert_eq!(load(&folder.path().join("a.safetensors")).unwrap().scene, scene);
}

#[test]
fn formats_without_a_smoothing_have_it_in_scales_and_opacities() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = Scene { gaussians: gaussians(5, 1), ..Scene::default() };
    let plain = scene.gaussians.clone();
    scene.gaussians.optional.set(crate::scene::parameter::SMOOTHING, vec![0.0, 0.1, 0.2, 0.3, 0.4]);
    assert!(save(&folder.path().join("a.ply"), &scene).unwrap().is_empty());
    scene.gaussians.fold_smoothing();
    let found = load(&folder.path().join("a.ply")).unwrap().scene.gaussians;
    assert_eq!((&found.log_scale, &found.opacity_logit), (&scene.gaussians.log_scale, &scene.gaussians.opacity_logit));
    assert!(found.log_scale[1] != plain.log_scale[1] && found.opacity_logit[1] < plain.opacity_logit[1]);
}

#[test]
fn poison_values_are_dropped_everywhere_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, bad) = poisoned();
    let clean_part = |i: usize| scene.gaussians.mean[i];
    for name in ["p.safetensors", "p.ply"] {
        let path = folder.path().join(name);
        let warnings = save(&path, &scene).unwrap();
        assert_eq!(warnings.len(), usize::from(name == "p.ply"), "{warnings:?}");
        let loaded = load(&path).unwrap();
        let expected = Rejected { not_finite: 13, zero_rotation: 2, absurd_scale: 2, out_of_range: 2 };
        assert_eq!(loaded.rejected, expected);
        let g = &loaded.scene.gaussians;
        assert_eq!((g.len(), g.mean[0], g.sh.len()), (40 - bad, clean_part(bad), (40 - bad) * 12));
        assert!(loaded.warnings.iter().any(|w| w.contains("19 of 40") && w.contains("13 not finite")));
        let described = describe(&path).unwrap();
        assert_eq!((described.gaussians, described.rejected.total()), (40, bad));
        assert!(described.statistics.iter().filter(|s| !s.name.contains("logit")).all(|s| s.max.is_finite()));
        if name == "p.safetensors" {
            let s = loaded.scene;
            let of_gaussian = scene.deformation.superpoint_of_gaussian();
            assert_eq!(*s.deformation.superpoint_of_gaussian(), of_gaussian[bad..]);
            assert_eq!(
                s.deformation.association().unwrap().neighbor,
                scene.deformation.association().unwrap().neighbor[2 * bad..]
            );
            assert_eq!(s.extra["gaussians.age"].shape, [40 - bad, 2]);
            assert_eq!(s.extra["gaussians.age"].data, scene.extra["gaussians.age"].data[2 * bad..]);
            assert_eq!(described.motion.unwrap().key_times, 3);
        }
    }
}

#[test]
fn the_format_is_told_by_content_and_other_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene { gaussians: gaussians(3, 0), ..Scene::default() };
    for extension in ["ply", "safetensors"] {
        let path = folder.path().join(format!("a.{extension}"));
        save(&path, &scene).unwrap();
        let disguised = folder.path().join("b.bin");
        std::fs::copy(&path, &disguised).unwrap();
        assert_eq!(load(&disguised).unwrap().scene.gaussians, scene.gaussians);
        let text = describe(&disguised).unwrap();
        assert!(text.to_string().contains("Gaussians       3 (SH degree 0)"), "{text}");
        assert!(serde_json::to_string(&text).unwrap().contains("\"sh_degree\":0"));
    }
    let other = folder.path().join("c.ply");
    std::fs::write(&other, b"\x89PNG\r\n").unwrap();
    assert!(load(&other).unwrap_err().to_string().contains("PNG"));
    std::fs::write(&other, b"").unwrap();
    assert!(matches!(load(&other), Err(Error::Corrupt { .. })));
    assert!(matches!(load(&folder.path().join("none.ply")), Err(Error::Io { .. })));
    assert!(matches!(save(&folder.path().join("x.obj"), &scene), Err(Error::Usage { .. })));
    let wrong = Scene { gaussians: Gaussians { sh: vec![0.0], ..gaussians(3, 0) }, ..Scene::default() };
    for name in ["x.ply", "x.safetensors"] {
        assert!(matches!(save(&folder.path().join(name), &wrong), Err(Error::Usage { .. })));
    }
}

#[test]
fn a_model_without_gaussians_loads_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["e.ply", "e.safetensors"] {
        let path = folder.path().join(name);
        save(&path, &Scene { gaussians: gaussians(0, 3), ..Scene::default() }).unwrap();
        let loaded = load(&path).unwrap();
        assert!(loaded.scene.gaussians.is_empty() && loaded.warnings.len() == 1);
        assert_eq!(describe(&path).unwrap().bounds, None);
    }
}
