//! Data sets with something wrong: one typed error naming the file, never a panic.

use proptest::prelude::*;

use super::*;

#[test]
fn a_bad_picture_is_one_error_naming_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("vrig/s");
    nerfies_scene(&scene, 6, true);
    let file = scene.join("rgb/2x/f002.png");
    let good = std::fs::read(&file).unwrap();
    let error = || dataset::load(&scene, &DatasetOptions::default()).unwrap_err();
    picture(file.clone(), [12, 4], |_, _| [0.0; 3]);
    let message = error().to_string();
    assert!(message.contains("f002.png: at image size: found 12 x 4 pixels, expected the 16 x 8"), "{message}");
    std::fs::remove_file(&file).unwrap();
    assert!(matches!(error(), Error::Io { path, .. } if path == file));
    write(file.clone(), &good[..20]);
    assert!(matches!(error(), Error::Corrupt { path, .. } if path == file));
    // A header that is right and data that is cut is found on decoding.
    write(file.clone(), &good[..good.len() - 20]);
    let d = load(&scene);
    assert!(matches!(d.train[2].image.decode(), Err(Error::Corrupt { path, .. }) if path == file));
}

/// Small scenes of every format, and the files that describe them.
fn small_scenes(folder: &Path) -> Vec<(PathBuf, Vec<&'static str>)> {
    let nerfies = folder.join("vrig/n");
    nerfies_scene(&nerfies, 5, true);
    write(nerfies.join("points.npy"), npy(&[1, 3], &[1.0, 2.0, 3.0]));
    let llff = folder.join("l");
    let row = [0.0, 1.0, 0.0, 5.0, 8.0, 1.0, 0.0, 0.0, 6.0, 8.0, 0.0, 0.0, -1.0, 7.0, 9.0, 1.0, 2.0];
    write(llff.join("poses_bounds.npy"), npy(&[2, 17], &[row, row].concat()));
    let converted = folder.join("c");
    let pose = "[[1,0,0,0,8],[0,1,0,0,8],[0,0,1,0,9]]";
    let json = format!("{{\"poses\":[{pose},{pose}],\"bds\":[[1,2],[1,3]]}}");
    write(converted.join("precomputed.json"), json);
    let blender = folder.join("b");
    let matrix = "[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]";
    let frame = |i| format!("{{\"file_path\":\"images/{i}\",\"time\":0.5,\"k1\":0.1,\"transform_matrix\":{matrix}}}");
    let frames = format!("{{\"fl_x\":9,\"w\":8,\"h\":8,\"frames\":[{},{}]}}", frame(0), frame(1));
    write(blender.join("transforms.json"), frames);
    let colmap = folder.join("m");
    write(colmap.join("sparse/cameras.txt"), "1 OPENCV 8 8 10 10 4 4 0.1 0 0 0\n");
    write(colmap.join("sparse/images.txt"), "1 1 0 0 0 0 0 0 1 0.png\n1 2 1\n2 1 0 0 0 0 0 0 1 1.png\n\n");
    write(colmap.join("sparse/points3D.txt"), "1 1 2 3 4 5 6 0.1 1 0\n");
    write(colmap.join("times.txt"), "0.png 0\n1.png 1\n");
    for scene in [&llff, &converted, &blender, &colmap] {
        (0..2).for_each(|i| picture(scene.join(format!("images/{i}.png")), [8, 8], |_, _| [1.0; 3]));
    }
    vec![
        (nerfies, vec!["dataset.json", "metadata.json", "scene.json", "camera/f001.json", "points.npy"]),
        (llff, vec!["poses_bounds.npy"]),
        (converted, vec!["precomputed.json"]),
        (blender, vec!["transforms.json"]),
        (colmap, vec!["sparse/cameras.txt", "sparse/images.txt", "sparse/points3D.txt", "times.txt"]),
    ]
}

/// What loads is usable: finite cameras, pictures that decode.
fn check_consistent(scene: &Path) {
    let _ = load_cameras(scene, None, None);
    let Ok(d) = dataset::load(scene, &DatasetOptions { downscale: Some(2), ..DatasetOptions::default() }) else {
        return;
    };
    assert!(!d.train.is_empty() && d.extent.is_finite() && d.time_range.iter().all(|t| t.is_finite()));
    for view in d.train.iter().chain(&d.test) {
        let c = &view.camera;
        let pixels = view.image.decode().unwrap();
        assert_eq!([pixels.width, pixels.height, c.width, c.height].map(|s| s > 0), [true; 4]);
        assert!(c.position.is_finite() && c.rotation.is_finite() && c.fx > 0.0 && c.fy > 0.0 && view.time.is_finite());
    }
}

#[test]
fn small_scenes_load_and_every_cut_is_survived() {
    let folder = tempfile::tempdir().unwrap();
    for (scene, files) in small_scenes(folder.path()) {
        let d = load(&scene);
        assert!(!d.train.is_empty() && d.points.is_some() != (d.kind == DatasetKind::Nerfstudio), "{scene:?}");
        for file in files {
            let path = scene.join(file);
            let whole = std::fs::read(&path).unwrap();
            for cut in (0..whole.len()).step_by(7) {
                std::fs::write(&path, &whole[..cut]).unwrap();
                check_consistent(&scene);
                if file.ends_with("json") {
                    let error = dataset::load(&scene, &DatasetOptions::default()).unwrap_err();
                    assert!(error.to_string().contains(file), "{file} cut at {cut}: {error}");
                }
            }
            std::fs::write(&path, &whole).unwrap();
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn damaged_files_never_panic(edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4)) {
        const WORDS: [&str; 6] = ["NaN", "1e999", "-1", "null", "[]", "99999999999"];
        let folder = tempfile::tempdir().unwrap();
        for (scene, files) in small_scenes(folder.path()) {
            for file in files {
                let path = scene.join(file);
                let whole = std::fs::read(&path).unwrap();
                let mut bytes = whole.clone();
                for (place, byte) in &edits {
                    let at = place.index(bytes.len());
                    match WORDS.get(usize::from(*byte) / 8) {
                        Some(word) => drop(bytes.splice(at..at + 1, word.bytes())),
                        None => bytes[at] = *byte,
                    }
                }
                std::fs::write(&path, &bytes).unwrap();
                check_consistent(&scene);
                std::fs::write(&path, &whole).unwrap();
            }
        }
    }
}

#[test]
fn nothing_known_says_what_was_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path().join("readme.md"), "x");
    let message = dataset::load(folder.path(), &DatasetOptions::default()).unwrap_err().to_string();
    assert!(message.contains("found readme.md") && message.contains("dataset.json"), "{message}");
    assert!(matches!(dataset::load(&folder.path().join("none"), &DatasetOptions::default()), Err(Error::Io { .. })));
}
