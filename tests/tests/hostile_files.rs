//! Hostile bytes into every parser: nothing may panic, and what is accepted must be consistent.

use std::path::Path;

use engine::data::transforms;
use engine::file::{self, model, picture, ply};
use engine::scene::{Association, Blend, Camera, Gaussians, Motion, Scene, SuperpointDeformation, Superpoints};
use proptest::prelude::*;

fn small_scene() -> Scene {
    let deformation = SuperpointDeformation {
        superpoints: Superpoints { of_gaussian: vec![0, 1, 0], position: vec![[0.0; 3]; 2] },
        blend: Some(Blend { neighbors: 2, index: vec![0, 1, 0, 1, 0, 0], weight: vec![0.5, 0.0, 0.25, 1.0, 3.0, 2.0] }),
        table: Some(Motion { times: vec![0.0, 1.0], rotation: vec![[0.0; 3]; 4], translation: vec![[0.1; 3]; 4] }),
        association: Some(Association { neighbors: 1, neighbor: vec![0, 1, 1], logit: vec![0.0; 3] }),
        ..SuperpointDeformation::default()
    };
    Scene {
        gaussians: Gaussians {
            mean: vec![[1.0, 2.0, 3.0]; 3],
            log_scale: vec![[-1.0; 3]; 3],
            rotation: vec![[1.0, 0.0, 0.0, 0.0]; 3],
            opacity_logit: vec![0.5; 3],
            sh_degree: 1,
            sh: vec![0.25; 36],
            ..Gaussians::default()
        },
        deformation: deformation.into(),
        ..Scene::default()
    }
}

fn bytes_of(name: &str) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    file::save(&path, &small_scene()).unwrap();
    std::fs::read(&path).unwrap()
}

fn ascii_ply() -> Vec<u8> {
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
    let rotation = ["rot_0", "rot_1", "rot_2", "rot_3"];
    let properties: String = names.iter().chain(&rotation).map(|name| format!("property float {name}\n")).collect();
    let row = "1 2 3 0.5 0.5 0.5 1 -1 -2 -3 1 0 0 0 2 7 8\n";
    format!(
        "ply\nformat ascii 1.0\nelement vertex 2\n{properties}property list uchar int tracks\nend_header\n{row}{row}"
    )
    .into_bytes()
}

fn transforms_text() -> Vec<u8> {
    br#"{"camera_angle_x": 0.69, "w": 800, "h": 600, "frames": [{"file_path": "./r_0", "time": 0.5,
        "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}]}"#
        .to_vec()
}

/// One change to a file.
#[derive(Debug, Clone)]
enum Edit {
    Set(prop::sample::Index, u8),
    Remove(prop::sample::Index, usize),
    Repeat(prop::sample::Index, usize),
    Insert(prop::sample::Index, Vec<u8>),
}

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let at = any::<prop::sample::Index>;
    let edit = prop_oneof![
        (at(), any::<u8>()).prop_map(|(i, v)| Edit::Set(i, v)),
        (at(), prop::sample::select(b"0123456789 \n-.eE\"[]{}\xff".to_vec())).prop_map(|(i, v)| Edit::Set(i, v)),
        (at(), 1usize..40).prop_map(|(i, n)| Edit::Remove(i, n)),
        (at(), 1usize..200).prop_map(|(i, n)| Edit::Repeat(i, n)),
        (at(), prop::collection::vec(any::<u8>(), 1..16)).prop_map(|(i, v)| Edit::Insert(i, v)),
    ];
    prop::collection::vec(edit, 1..6)
}

fn apply(mut bytes: Vec<u8>, edits: &[Edit]) -> Vec<u8> {
    for edit in edits {
        if bytes.is_empty() {
            break;
        }
        let length = bytes.len();
        match edit {
            Edit::Set(i, value) => bytes[i.index(length)] = *value,
            Edit::Remove(i, n) => {
                let i = i.index(length);
                bytes.drain(i..(i + n).min(length));
            }
            Edit::Repeat(i, n) => {
                let i = i.index(length);
                let part = bytes[i..(i + n).min(length)].to_vec();
                bytes.splice(i..i, part);
            }
            Edit::Insert(i, part) => {
                let i = i.index(length);
                bytes.splice(i..i, part.iter().copied());
            }
        }
    }
    bytes
}

fn feed(bytes: &[u8]) {
    let path = Path::new("/nowhere/hostile");
    if let Ok(g) = ply::parse(bytes, path) {
        assert_eq!(g.sh.len(), g.len() * g.sh_coefficients() * 3);
    }
    if let Ok((scene, _)) = model::parse(bytes, path) {
        let m = scene.deformation.superpoint_count();
        assert!(scene.deformation.superpoint_of_gaussian().iter().all(|&s| (s as usize) < m));
        let blend = scene.deformation.blend().cloned().unwrap_or_default();
        assert!(blend.index.iter().all(|&s| (s as usize) < m));
        assert!((0..blend.len()).flat_map(|i| blend.slots(i)).all(|(_, w)| (0.0..=1.0).contains(&w)));
    }
    if let Ok(set) = transforms::parse(bytes, path, None) {
        assert!(set.cameras.iter().all(is_finite));
    }
    let _ = picture::parse(bytes, path);
}

fn is_finite(c: &Camera) -> bool {
    c.rotation.is_finite() && c.position.is_finite() && [c.fx, c.fy, c.cx, c.cy, c.time].iter().all(|v| v.is_finite())
}

/// COLMAP files are read from a folder.
fn feed_colmap(folder: &Path, cameras: &[u8], images: &[u8], extension: &str) {
    std::fs::write(folder.join(format!("cameras.{extension}")), cameras).unwrap();
    std::fs::write(folder.join(format!("images.{extension}")), images).unwrap();
    if let Ok(set) = engine::data::colmap::read(folder) {
        assert!(set.cameras.iter().all(is_finite));
    }
}

fn colmap_binary() -> (Vec<u8>, Vec<u8>) {
    let mut cameras = 1u64.to_le_bytes().to_vec();
    cameras.extend([1u32, 1].iter().flat_map(|v| v.to_le_bytes()));
    cameras.extend([640u64, 480].iter().flat_map(|v| v.to_le_bytes()));
    cameras.extend([500.0f64, 500.0, 320.0, 240.0].iter().flat_map(|v| v.to_le_bytes()));
    let mut images = 1u64.to_le_bytes().to_vec();
    images.extend(1u32.to_le_bytes());
    images.extend([1.0f64, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0].iter().flat_map(|v| v.to_le_bytes()));
    images.extend(1u32.to_le_bytes());
    images.extend(b"a.png\0");
    images.extend(1u64.to_le_bytes());
    images.extend([0; 24]);
    (cameras, images)
}

/// Beginnings that lead random bytes past the first check of each parser.
const MAGICS: [&[u8]; 6] = [
    b"ply\n",
    b"ply\nformat ascii 1.0\n",
    b"\x40\0\0\0\0\0\0\0{",
    b"{\"frames\":[",
    b"\x76\x2f\x31\x01\x02\0\0\0",
    b"\x89PNG\r\n\x1a\n",
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        feed(&bytes);
        MAGICS.iter().for_each(|magic| feed(&[magic, &bytes[..]].concat()));
    }

    #[test]
    fn edited_ply_never_panics(edits in edits()) {
        feed(&apply(bytes_of("a.ply"), &edits));
        feed(&apply(ascii_ply(), &edits));
    }

    #[test]
    fn edited_model_is_an_error_or_unchanged(edits in edits()) {
        let edited = apply(bytes_of("a.safetensors"), &edits);
        feed(&edited);
        if let Ok((scene, _)) = model::parse(&edited, Path::new("x")) {
            prop_assert!(scene == small_scene(), "an edited model was accepted as something else");
        }
    }

    #[test]
    fn edited_transforms_never_panic(edits in edits()) {
        feed(&apply(transforms_text(), &edits));
    }

    #[test]
    fn edited_colmap_never_panics(
        camera_edits in edits(),
        image_edits in edits(),
        raw in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let (cameras, images) = colmap_binary();
        feed_colmap(folder.path(), &apply(cameras.clone(), &camera_edits), &images, "bin");
        feed_colmap(folder.path(), &cameras, &apply(images, &image_edits), "bin");
        feed_colmap(folder.path(), &raw, &raw, "bin");
        let text = tempfile::tempdir().unwrap();
        let (cameras, images) = (b"1 PINHOLE 8 8 5 5 4 4\n".to_vec(), b"1 1 0 0 0 0 0 0 1 a.png\n\n".to_vec());
        feed_colmap(text.path(), &apply(cameras.clone(), &camera_edits), &images, "txt");
        feed_colmap(text.path(), &cameras, &apply(images, &image_edits), "txt");
    }
}

#[test]
fn the_unedited_files_are_accepted() {
    let path = Path::new("x");
    assert_eq!(ply::parse(&bytes_of("a.ply"), path).unwrap(), small_scene().gaussians);
    assert_eq!(ply::parse(&ascii_ply(), path).unwrap().len(), 2);
    assert_eq!(model::parse(&bytes_of("a.safetensors"), path).unwrap().0, small_scene());
    assert_eq!(transforms::parse(&transforms_text(), path, None).unwrap().cameras.len(), 1);
    let folder = tempfile::tempdir().unwrap();
    let (cameras, images) = colmap_binary();
    feed_colmap(folder.path(), &cameras, &images, "bin");
    assert_eq!(engine::data::colmap::read(folder.path()).unwrap().cameras.len(), 1);
}
