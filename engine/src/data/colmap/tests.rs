//! Both encodings, all models, damage.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::fmt::Write as _;

use super::*;
use crate::data::{DatasetOptions, dataset, load_cameras};

type TestCamera = (u32, usize, [u64; 2], Vec<f64>);
type TestImage = (&'static str, [f64; 4], [f64; 3], u32, usize);

fn test_cameras() -> Vec<TestCamera> {
    let with_distortion = |count: usize| [vec![500.0; 4], vec![0.01; count - 4]].concat();
    let mut cameras = vec![
        (1, 0, [640, 480], vec![500.0, 320.0, 240.5]),
        (2, 1, [640, 480], vec![500.0, 510.0, 320.0, 240.5]),
        (3, 4, [640, 480], vec![500.0, 510.0, 320.0, 240.5, 0.0, 0.0, 0.0, 0.0]),
    ];
    cameras.extend((2..12).map(|model| (10 + model as u32, model, [8, 6], with_distortion(MODELS[model].1.max(4)))));
    cameras.iter_mut().for_each(|c| c.3.truncate(MODELS[c.1].1));
    cameras
}

fn test_images() -> Vec<TestImage> {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    vec![
        ("img10.png", [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 5.0], 2, 0),
        ("img2.png", [half, 0.0, half, 0.0], [1.0, 2.0, 3.0], 1, 2),
        ("img1.png", [2.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0], 3, 1),
    ]
}

fn binary_files(cameras: &[TestCamera], images: &[TestImage]) -> (Vec<u8>, Vec<u8>) {
    let mut c = (cameras.len() as u64).to_le_bytes().to_vec();
    for (id, model, size, parameters) in cameras {
        c.extend(id.to_le_bytes());
        c.extend((*model as u32).to_le_bytes());
        size.iter().for_each(|s| c.extend(s.to_le_bytes()));
        parameters.iter().for_each(|p| c.extend(p.to_le_bytes()));
    }
    let mut i = (images.len() as u64).to_le_bytes().to_vec();
    for (name, q, t, camera, points) in images {
        i.extend(7u32.to_le_bytes());
        q.iter().chain(t).for_each(|v| i.extend(v.to_le_bytes()));
        i.extend(camera.to_le_bytes());
        i.extend(name.bytes().chain([0]));
        i.extend((*points as u64).to_le_bytes());
        i.extend(vec![1; points * 24]);
    }
    (c, i)
}

fn text_files(cameras: &[TestCamera], images: &[TestImage]) -> (String, String) {
    let mut c = "# Camera list\n".to_string();
    for (id, model, size, parameters) in cameras {
        let numbers: Vec<String> = parameters.iter().map(ToString::to_string).collect();
        writeln!(c, "{id} {} {} {} {}", MODELS[*model].0, size[0], size[1], numbers.join(" ")).unwrap();
    }
    let mut i = "# Image list\n# two lines\n".to_string();
    for (name, q, t, camera, points) in images {
        let numbers: Vec<String> = q.iter().chain(t).map(ToString::to_string).collect();
        writeln!(i, "7 {} {camera} {name}", numbers.join(" ")).unwrap();
        writeln!(i, "{}", "1.5 2.5 -1 ".repeat(*points)).unwrap();
    }
    (c, i)
}

fn write_model(folder: &Path, text: bool) {
    std::fs::create_dir_all(folder).unwrap();
    let (cameras, images) = (test_cameras(), test_images());
    if text {
        let (c, i) = text_files(&cameras, &images);
        std::fs::write(folder.join("cameras.txt"), c).unwrap();
        std::fs::write(folder.join("images.txt"), i).unwrap();
    } else {
        let (c, i) = binary_files(&cameras, &images);
        std::fs::write(folder.join("cameras.bin"), c).unwrap();
        std::fs::write(folder.join("images.bin"), i).unwrap();
    }
}

#[test]
fn text_and_binary_agree_and_are_right() {
    for text in [false, true] {
        for sub in ["", "sparse", "sparse/0"] {
            let folder = tempfile::tempdir().unwrap();
            write_model(&folder.path().join(sub), text);
            let set = load_cameras(folder.path(), None, None).unwrap();
            let names: Vec<&str> = set.cameras.iter().map(|c| c.name.as_str()).collect();
            assert_eq!(names, ["img1.png", "img2.png", "img10.png"]);
            // By the numbers in the names.
            assert_eq!(set.cameras.iter().map(|c| c.time).collect::<Vec<_>>(), [0.0, 1.0 / 9.0, 1.0]);
            assert!(set.warnings.is_empty(), "{:?}", set.warnings);
            let [first, second, third] = &set.cameras[..] else { panic!() };
            assert_eq!((first.fx, first.fy, first.cx, first.cy), (500.0, 510.0, 320.0, 240.5));
            assert_eq!((second.fx, second.fy, second.cx, second.cy), (500.0, 500.0, 320.0, 240.5));
            assert_eq!((third.width, third.height, third.position), (640, 480, DVec3::new(0.0, 0.0, -5.0)));
            assert_eq!(first.position, DVec3::X);
            // A quarter turn about y maps world x to camera −z: x_camera = R x_world.
            let turned = second.rotation * DVec3::X;
            assert!((turned - DVec3::NEG_Z).length() < 1.0e-15);
            assert!((second.rotation * second.position + DVec3::new(1.0, 2.0, 3.0)).length() < 1.0e-14);
        }
    }
}

#[test]
fn distorted_cameras_are_named_once() {
    let names: Vec<&'static str> = (0..20).map(|i| &*format!("{i}.png").leak()).collect();
    let image = |(i, name): (usize, &&'static str)| (*name, [1.0, 0.0, 0.0, 0.0], [0.0; 3], 12 + (i % 10) as u32, 0);
    let images: Vec<TestImage> = names.iter().enumerate().map(image).collect();
    let folder = tempfile::tempdir().unwrap();
    let (c, i) = binary_files(&test_cameras(), &images);
    std::fs::write(folder.path().join("cameras.bin"), c).unwrap();
    std::fs::write(folder.path().join("images.bin"), i).unwrap();
    let set = load_cameras(folder.path(), None, None).unwrap();
    assert_eq!((set.cameras.len(), set.warnings.len()), (20, 10), "{:?}", set.warnings);
    let unsupported: Vec<&String> = set.warnings.iter().filter(|w| w.contains("is distorted (")).collect();
    assert_eq!(unsupported.len(), 3, "FOV and the thin prisms: {unsupported:?}");
    let message = dataset::load(folder.path(), &DatasetOptions::default()).unwrap_err().to_string();
    assert!(message.contains("found model FOV"), "{message}");
}

#[test]
fn splits_and_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let names: Vec<String> = (0..20).map(|i| format!("{i}.png")).collect();
    let leaked: Vec<&'static str> = names.into_iter().map(|n| &*n.leak()).collect();
    let images: Vec<TestImage> = leaked.iter().map(|n| (*n, [1.0, 0.0, 0.0, 0.0], [0.0; 3], 1, 0)).collect();
    let (c, i) = binary_files(&test_cameras(), &images);
    std::fs::write(folder.path().join("cameras.bin"), c).unwrap();
    std::fs::write(folder.path().join("images.bin"), i).unwrap();
    let count = |split| load_cameras(folder.path(), split, Some([320, 120])).unwrap().cameras.len();
    assert_eq!([count(None), count(Some("all")), count(Some("test")), count(Some("train"))], [20, 20, 3, 17]);
    let set = load_cameras(folder.path(), Some("test"), Some([320, 120])).unwrap();
    let c = &set.cameras[1];
    assert_eq!((c.name.as_str(), c.width, c.height, c.fx, c.fy, c.cx), ("8.png", 320, 120, 250.0, 125.0, 160.0));
    assert!((c.time - 8.0 / 19.0).abs() < 1.0e-15);
    assert!(load_cameras(folder.path(), Some("val"), None).is_err());
}

#[test]
fn a_cut_at_every_byte_is_an_error() {
    let file = Path::new("x.bin");
    let (c, i) = binary_files(&test_cameras(), &test_images());
    assert!(binary::cameras(&c, file).is_ok() && binary::images(&i, file).is_ok());
    (0..c.len()).for_each(|cut| assert!(binary::cameras(&c[..cut], file).is_err(), "cameras cut at {cut}"));
    (0..i.len()).for_each(|cut| assert!(binary::images(&i[..cut], file).is_err(), "images cut at {cut}"));
    assert!(binary::cameras(&[&c[..], &[0]].concat(), file).is_err());
    assert!(binary::images(&[&i[..], &[0]].concat(), file).is_err());
    let message = binary::cameras(&u64::MAX.to_le_bytes(), file).unwrap_err().to_string();
    assert!(message.contains("byte 0: found 18446744073709551615 cameras in 0 bytes"), "{message}");
}

#[test]
fn bad_values_name_the_place() {
    let folder = tempfile::tempdir().unwrap();
    let message = |cameras: &str, images: &str| {
        std::fs::write(folder.path().join("cameras.txt"), cameras).unwrap();
        std::fs::write(folder.path().join("images.txt"), images).unwrap();
        read(folder.path()).unwrap_err().to_string()
    };
    let (camera, image) = ("1 SIMPLE_PINHOLE 640 480 500 320 240\n", "1 1 0 0 0 0 0 0 1 a.png\n\n");
    for (cameras, images, expected) in [
        ("1 SIMPLE_PINHOLE 640 480 500 320\n", image, "cameras.txt: at line 1: found the end of the line"),
        ("1 SIMPLE_PINHOLE 640 480 500 320 240 1\n", image, "a further `1`"),
        ("1 SIMPLE_PINHOLE 640 480 -500 320 240\n", image, "(camera 1): found fx fy cx cy = [-500.0"),
        ("1 SIMPLE_PINHOLE 640 480 NaN 320 240\n", image, "fx fy cx cy = [NaN"),
        ("1 SIMPLE_PINHOLE 0 480 500 320 240\n", image, "found 0 x 480 pixels"),
        ("1 SIMPLE_PINHOLE 99999 480 500 320 240\n", image, "found 99999 x 480 pixels"),
        ("1 MAGIC 640 480 500 320 240\n", image, "camera model `MAGIC`"),
        (camera, "1 0 0 0 0 0 0 0 1 a.png\n\n", "line 1 (image `a.png`): found quaternion [0.0, 0.0, 0.0, 0.0]"),
        (camera, "1 1 0 0 0 0 inf 0 1 a.png\n\n", "translation [0.0, inf, 0.0]"),
        (camera, "1 1 0 0 0 0 0 0 7 a.png\n\n", "found camera 7 of image `a.png`, expected one of the 1 cameras"),
        (camera, "1 1 0 0 0 0 0 0 1 a.png\n2 1 0 0 0 0 0 0 1 b.png\n", "line 2: found 10 words"),
        (camera, "1 1 0 0 0 0 0 0 1\n\n", "expected an image name"),
        (camera, "# none\n", "no image"),
    ] {
        let found = message(cameras, images);
        assert!(found.contains(expected), "{expected} not in: {found}");
    }
    std::fs::remove_file(folder.path().join("cameras.txt")).unwrap();
    assert!(read(folder.path()).unwrap_err().to_string().contains("expected cameras.bin or cameras.txt"));
}

#[test]
fn names_sort_by_number() {
    let mut names = ["b1", "a10", "a9", "a010", "a", "a9b2", "a9b10", ""];
    names.sort_by(|a, b| natural_order(a, b));
    assert_eq!(names, ["", "a", "a9", "a9b2", "a9b10", "a010", "a10", "b1"]);
}
