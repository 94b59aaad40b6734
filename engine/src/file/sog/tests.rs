//! Round trips, version 1, names that lead elsewhere.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::f32::consts::FRAC_1_SQRT_2;

use super::*;
use crate::file::codec::{morton_order, sigmoid, unit};
use crate::scene::synthetic::random_gaussians;

#[test]
fn a_written_archive_is_read_back_within_its_precision() {
    let folder = tempfile::tempdir().unwrap();
    for degree in [0, 3] {
        let g = random_gaussians(900, 5, degree);
        let path = folder.path().join("a.sog");
        write(&path, &g).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let back = parse(&bytes, &path).unwrap();
        let g = g.selected(&morton_order(&g.mean));
        assert_eq!((back.len(), back.sh_degree), (900, degree));
        let far = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(far(back.mean.as_flattened(), g.mean.as_flattened()) < 1e-4);
        assert!(far(back.log_scale.as_flattened(), g.log_scale.as_flattened()) < 0.05);
        assert!(far(&back.sh, &g.sh) < 0.05, "{}", far(&back.sh, &g.sh));
        for i in 0..900 {
            assert!((sigmoid(back.opacity_logit[i]) - sigmoid(g.opacity_logit[i])).abs() < 0.5 / 254.0);
            let dot: f64 = unit(back.rotation[i]).iter().zip(unit(g.rotation[i])).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 1.0 - 5e-5, "{dot}");
        }
    }
}

/// Version 1, one Gaussian.
fn version_1(folder: &Path) {
    let save = |name: &str, pixel: [u8; 4]| {
        std::fs::write(folder.join(name), picture::encode(folder, pixel.to_vec(), [1, 1]).unwrap()).unwrap();
    };
    save("l.webp", [0, 255, 0, 255]);
    save("u.webp", [0, 255, 128, 255]);
    save("q.webp", [255, 128, 128, 253]);
    save("s.webp", [0, 51, 255, 255]);
    save("c.webp", [255, 0, 51, 204]);
    let meta = r#"{"means":{"shape":[1,3],"dtype":"float32","mins":[-1,0,0],"maxs":[0,2,1],"files":["l.webp","u.webp"]},
        "scales":{"shape":[1,3],"mins":[-5,-5,-5],"maxs":[0,0,0],"files":["s.webp"]},
        "quats":{"shape":[1,4],"encoding":"quaternion_packed","files":["q.webp"]},
        "sh0":{"shape":[1,1,4],"mins":[-1,-1,-1,-5],"maxs":[1,1,1,5],"files":["c.webp"]}}"#;
    std::fs::write(folder.join("meta.json"), meta).unwrap();
}

#[test]
fn version_1_uses_ends_instead_of_codebooks() {
    let folder = tempfile::tempdir().unwrap();
    version_1(folder.path());
    let g = read_folder(folder.path()).unwrap();
    let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-3);
    assert!(close(&g.mean[0], &[1.0 - 1.0f32.exp(), 2.0f32.exp() - 1.0, 0.5f32.exp() - 1.0]), "{:?}", g.mean);
    assert!(close(&g.log_scale[0], &[-5.0, -4.0, 0.0]) && close(&g.sh, &[1.0, -1.0, -0.6]));
    assert!(close(&g.opacity_logit, &[3.0]) && close(&g.rotation[0], &[FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0028, 0.0028]));
}

#[test]
fn names_that_leave_the_folder_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    version_1(folder.path());
    let meta = folder.path().join("meta.json");
    for name in ["../l.webp", "/etc/hosts", ""] {
        let text = std::fs::read_to_string(&meta).unwrap().replace("l.webp", name);
        let other = tempfile::tempdir().unwrap();
        std::fs::write(other.path().join("meta.json"), text).unwrap();
        assert!(read_folder(other.path()).unwrap_err().to_string().contains("plain file name"));
    }
}
