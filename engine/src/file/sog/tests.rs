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

/// Two leaves at three levels: level 0 in one folder, level 1 in two, level 2 not there; an environment of another degree.
fn several_levels(root: &Path) -> [Gaussians; 3] {
    let unpack = |name: &str, g: &Gaussians| {
        let path = root.join("a.sog");
        write(&path, g).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let mut archive = Archive::open(&bytes, &path).unwrap();
        std::fs::create_dir(root.join(name)).unwrap();
        for file in archive.names() {
            std::fs::write(root.join(name).join(&file), archive.read(&file, u64::MAX - 1).unwrap()).unwrap();
        }
        std::fs::remove_file(&path).unwrap();
        read_folder(&root.join(name)).unwrap()
    };
    let fine = unpack("0_0", &random_gaussians(90, 5, 3));
    let mut coarse = unpack("1_0", &random_gaussians(20, 6, 1));
    coarse.append(&unpack("1_1", &random_gaussians(10, 7, 1)), 0..10);
    let around = unpack("env", &random_gaussians(7, 8, 0));
    std::fs::write(root.join(LOD_META), LEVELS).unwrap();
    [fine, coarse, around]
}

const LEVELS: &str = r#"{"version":1,"lodLevels":3,"environment":"env/meta.json",
    "filenames":["0_0/meta.json","1_1/meta.json","1_0/meta.json","2_0/meta.json"],"tree":{"bound":{},"children":[
    {"lods":{"0":{"file":0,"offset":40,"count":50},"1":{"file":2,"offset":0,"count":20}}},
    {"lods":{"0":{"file":0,"offset":0,"count":40},"1":{"file":1,"offset":0,"count":10},"2":{"file":3,"offset":0,"count":9}}}]}}"#;

#[test]
fn a_level_is_all_leaves_and_the_environment() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let [fine, coarse, around] = several_levels(root);
    let (g, warnings) = read_level(root, None).unwrap();
    let mut expected = fine.clone();
    expected.append(&around, 0..7);
    assert_eq!(g, expected);
    assert_eq!((g.len(), g.sh_degree, g.sh.len()), (97, 3, 97 * 48));
    assert!(g.sh[90 * 48 + 3..91 * 48].iter().all(|v| *v == 0.0), "the environment has SH degree 0");
    let text = &warnings[0];
    assert!(text.contains("level of detail 0 is read (90 Gaussians), the finest; others: 1 (1_1, 1_0)"), "{text}");
    assert!(text.contains("level 2 lacks 2_0/meta.json") && warnings.len() == 1, "{warnings:?}");
    assert_eq!(read_level(&root.join(LOD_META), Some(0)).unwrap(), (expected, vec![]));

    // In the files' order: 1_1 is the first of them.
    let (g, _) = read_level(root, Some(1)).unwrap();
    let mut expected = Gaussians::default();
    expected.append(&coarse, 20..30);
    expected.append(&coarse, 0..20);
    expected.append(&around, 0..7);
    assert_eq!((g.sh_degree, g), (1, expected));
    let message = |level: u32| read_level(root, Some(level)).unwrap_err().to_string();
    assert!(message(2).contains("2, which lacks 2_0/meta.json") && message(3).contains("found 3, expected 0, 1, 2"));

    // A picture that is missing makes the level incomplete, too.
    std::fs::remove_file(root.join("0_0/quats.webp")).unwrap();
    let (g, warnings) = read_level(root, None).unwrap();
    assert_eq!(g.len(), 37);
    let text = &warnings[0];
    assert!(text.contains("level of detail 1") && text.contains("level 0 lacks 0_0/quats.webp"), "{text}");
    let listed = levels(root).unwrap();
    let summary: Vec<_> = listed.iter().map(|l| (l.level, l.gaussians, l.missing.is_some(), l.is_default)).collect();
    assert_eq!(summary, [(0, 90, true, false), (1, 30, false, true), (2, 9, true, false)]);
    std::fs::remove_dir_all(root.join("env")).unwrap();
    assert!(read_level(root, None).unwrap().1[1].contains("environment is left out: env/meta.json is missing"));
    std::fs::remove_dir_all(root.join("1_0")).unwrap();
    assert!(read_level(root, None).unwrap_err().to_string().contains("level 1 lacks 1_0/meta.json"));
}

#[test]
fn levels_that_make_no_sense_are_named() {
    let folder = tempfile::tempdir().unwrap();
    several_levels(folder.path());
    let message = |from: &str, to: &str| {
        assert!(LEVELS.contains(from), "{from}");
        std::fs::write(folder.path().join(LOD_META), LEVELS.replace(from, to)).unwrap();
        read_level(folder.path(), Some(1)).unwrap_err().to_string()
    };
    assert!(message("\"version\":1", "\"version\":2").contains("`version`: found 2, expected 1"));
    assert!(message("\"lodLevels\":3", "\"lodLevels\":2").contains("level `2`, expected below 2"));
    assert!(message("\"0\":{\"file\":0,\"offset\":0", "\"x\":{\"file\":0,\"offset\":0").contains("level `x`"));
    assert!(message("\"file\":3", "\"file\":4").contains("file 4 at level 2, expected below 4"));
    assert!(message("\"file\":3", "\"file\":-1").contains("integer"));
    assert!(
        message("\"count\":50", "\"count\":51")
            .contains("Gaussians 40 to 91 of file 0 at level 0, expected at most 90")
    );
    assert!(message("\"count\":50", "\"count\":18446744073709551615").contains("expected at most 90"));
    assert!(message("\"count\":40", "\"count\":41").contains("Gaussian 40 of file 0 twice at level 0"));
    for name in ["../0_0/meta.json", "/0_0/meta.json", "0_0/../0_0/meta.json", "", "0_0/", "0_0", "0_0/xmeta.json"] {
        let text = message("0_0/meta.json", name);
        assert!(text.contains("filenames") && text.contains("folder within"), "{name}: {text}");
    }
    assert!(message("env/meta.json", "../env/meta.json").contains("`environment`"));
    // Nested deeper than the parser goes.
    let deep = format!("{}{}", "{\"children\":[".repeat(100_000), "]}".repeat(100_000));
    let tree = format!("{{\"lodLevels\":3,\"filenames\":[],\"tree\":{deep}}}");
    assert!(message(LEVELS, &tree).contains("recursion limit"));
    let both = message("{\"bound\":{},", "{\"lods\":{},");
    assert!(both.contains("a node with `children` and `lods`"), "{both}");
}
