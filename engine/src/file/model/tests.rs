//! Round trips, damage at every byte and bit, inconsistent scenes.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::collections::HashMap;

use safetensors::tensor::{Dtype, TensorView};

use super::*;
use crate::error::Error;
use crate::file::tests::{Values, full_scene, gaussians, moving_scene};
use crate::scene::synthetic::random_blend;
use crate::scene::{Association, Blend, Deformation, Motion, Superpoints, Tensor};

fn path() -> &'static Path {
    Path::new("test.safetensors")
}

fn encoded(scene: &Scene) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("m.safetensors");
    write(&file, scene).unwrap();
    std::fs::read(&file).unwrap()
}

#[test]
fn everything_round_trips_and_equal_scenes_give_equal_bytes() {
    let static_scene = |degree| Scene { gaussians: gaussians(6, degree), ..Scene::default() };
    let mut scenes: Vec<Scene> = (0..=3).map(static_scene).collect();
    scenes.extend([moving_scene(5, 3, 4), full_scene(5, 3, 4), Scene::default()]);
    for scene in scenes {
        let bytes = encoded(&scene);
        let (back, warnings) = parse(&bytes, path()).unwrap();
        assert_eq!(back, scene);
        assert!(warnings.is_empty(), "{warnings:?}");
        assert_eq!(bytes, encoded(&scene));
        let names = tensors(&bytes, path()).unwrap();
        assert!(names.len() >= 5 && names.is_sorted_by(|a, b| a.name < b.name));
        if scene.deformation == Deformation::None {
            assert_eq!(names.len(), 5, "a static scene has only `gaussians.*`");
        }
    }
    // NaN payloads survive too (`==` cannot tell).
    let mut scene = static_scene(0);
    scene.gaussians.mean[2][1] = f32::from_bits(0x7fc0_1234);
    assert_eq!(parse(&encoded(&scene), path()).unwrap().0.gaussians.mean[2][1].to_bits(), 0x7fc0_1234);
}

#[test]
fn a_cut_at_every_byte_and_a_further_byte_are_errors() {
    let bytes = encoded(&moving_scene(3, 2, 2));
    for cut in 0..bytes.len() {
        assert!(matches!(parse(&bytes[..cut], path()), Err(Error::Corrupt { .. })), "cut at {cut}");
    }
    assert!(parse(&[&bytes[..], b"\0"].concat(), path()).is_err());
}

#[test]
fn every_flipped_bit_is_found() {
    let bytes = encoded(&moving_scene(20, 3, 3));
    let mut random = Values(99);
    let mut damaged = bytes.clone();
    for _ in 0..10_000 {
        let (byte, bit) = (random.bits() as usize % bytes.len(), random.bits() % 8);
        damaged[byte] ^= 1 << bit;
        let outcome = parse(&damaged, path());
        assert!(matches!(outcome, Err(Error::Corrupt { .. })), "bit {bit} of byte {byte} of {}", bytes.len());
        damaged[byte] = bytes[byte];
    }
}

#[test]
fn every_flipped_bit_of_the_header_is_found() {
    let bytes = encoded(&Scene { metadata: moving_scene(1, 1, 1).metadata, ..moving_scene(2, 1, 1) });
    let end = 8 + u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let mut damaged = bytes.clone();
    for byte in 0..end {
        for bit in 0..8 {
            damaged[byte] ^= 1 << bit;
            assert!(parse(&damaged, path()).is_err(), "bit {bit} of byte {byte}: {:?}", bytes[byte] as char);
            damaged[byte] = bytes[byte];
        }
    }
}

/// [`moving_scene`] with soft superpoints.
fn soft_scene(n: usize, m: usize, neighbors: usize) -> Scene {
    let mut scene = moving_scene(n, m, 2);
    set_blend(&mut scene, random_blend(n, m, neighbors, 3));
    scene
}

fn set_blend(scene: &mut Scene, blend: Blend) {
    let s = scene.deformation.superpoint_deformation_mut().unwrap();
    (s.superpoints.of_gaussian, s.blend) = (blend.of_gaussian(), Some(blend));
}

#[test]
fn soft_superpoints_round_trip_in_the_types_that_hold_them() {
    let types = |scene: &Scene| {
        let bytes = encoded(scene);
        assert_eq!(parse(&bytes, path()).unwrap().0, *scene);
        let named = tensors(&bytes, path()).unwrap().into_iter().filter(|t| t.name.contains("blend"));
        named.map(|t| (t.dtype, t.shape)).collect::<Vec<_>>()
    };
    let pair = |index: &str, weight: &str, shape: [usize; 2]| [index, weight].map(|t| (t.to_string(), shape.to_vec()));
    for neighbors in 1..=4 {
        let mut scene = soft_scene(40, 5, neighbors);
        assert_eq!(types(&scene), pair("U16", "F32", [40, neighbors]));
        let rounded = scene.deformation.blend().unwrap().quantized();
        set_blend(&mut scene, rounded);
        assert_eq!(types(&scene), pair("U16", "U8", [40, neighbors]));
    }
    for (m, index) in [(1 << 16, "U16"), ((1 << 16) + 1, "U32")] {
        let mut scene = soft_scene(3, m, 2);
        let last = Blend { neighbors: 1, index: vec![m as u32 - 1; 3], weight: vec![1.0; 3] };
        set_blend(&mut scene, last);
        assert_eq!(types(&scene), pair(index, "U8", [3, 1]));
    }
}

/// [`moving_tensors`] with a blend of two superpoints, of which there is one.
fn soft_tensors(index: Dtype, weight: Dtype) -> Vec<Foreign> {
    let mut tensors = moving_tensors();
    let levels = if weight == Dtype::F32 { vec![0.25_f32, 0.5, 2.0, 0.0] } else { Vec::new() };
    let bytes = if weight == Dtype::F32 {
        levels.iter().flat_map(|w| w.to_le_bytes()).collect()
    } else {
        vec![51, 0, 255, 255]
    };
    tensors.push(zeros("superpoints.blend_index", index, &[2, 2]));
    tensors.push(("superpoints.blend_weight", weight, vec![2, 2], bytes));
    tensors
}

#[test]
fn soft_superpoints_of_other_programs_are_read_in_all_types() {
    for index in [Dtype::U16, Dtype::U32] {
        for (weight, expected) in [(Dtype::F32, [0.25, 0.5, 2.0, 0.0]), (Dtype::U8, [0.2, 0.0, 1.0, 1.0])] {
            let (scene, _) = parse(&foreign(&soft_tensors(index, weight), &SPGS), path()).unwrap();
            let expected = Blend { neighbors: 2, index: vec![0; 4], weight: expected.to_vec() };
            assert_eq!(scene.deformation.blend(), Some(&expected));
        }
    }
}

type TensorsEdit = fn(&mut Vec<Foreign>);

#[test]
fn soft_superpoints_that_make_no_sense_are_named() {
    let message = |change: TensorsEdit| {
        let mut tensors = soft_tensors(Dtype::U16, Dtype::F32);
        change(&mut tensors);
        parse(&foreign(&tensors, &SPGS), path()).unwrap_err().to_string()
    };
    fn set(tensors: &mut Vec<Foreign>, tensor: Foreign) {
        tensors.retain(|t| t.0 != tensor.0);
        tensors.push(tensor);
    }
    const INDEX: &str = "superpoints.blend_index";
    const WEIGHT: &str = "superpoints.blend_weight";
    let cases: [(&str, TensorsEdit); 12] = [
        ("tensor `superpoints.blend_weight`: found nothing", |t| t.retain(|t| t.0 != WEIGHT)),
        ("tensor `superpoints.blend_index`: found nothing", |t| t.retain(|t| t.0 != INDEX)),
        ("found F32 [2, 2], expected U16 or U32 [2, any]", |t| set(t, floats(INDEX, &[2, 2]))),
        ("found U16 [3, 2], expected U16 or U32 [2, any]", |t| set(t, zeros(INDEX, Dtype::U16, &[3, 2]))),
        ("found F32 [2, 3], expected F32 or U8 [2, 2]", |t| set(t, floats(WEIGHT, &[2, 3]))),
        ("found F16 [2, 2], expected F32 or U8 [2, 2]", |t| set(t, zeros(WEIGHT, Dtype::F16, &[2, 2]))),
        ("`superpoints.blend_index`: found K = 5, expected K = 1 to 4", |t| {
            set(t, zeros(INDEX, Dtype::U16, &[2, 5]));
            set(t, floats(WEIGHT, &[2, 5]));
        }),
        ("`superpoints.blend_index`: found K = 0", |t| {
            set(t, zeros(INDEX, Dtype::U16, &[2, 0]));
            set(t, floats(WEIGHT, &[2, 0]));
        }),
        ("`superpoints.blend_index`: found 256 at element 3, expected indices below M = 1", |t| {
            set(t, (INDEX, Dtype::U16, vec![2, 2], vec![0, 0, 0, 0, 0, 0, 0, 1]));
        }),
        ("`superpoints.blend_weight`: found NaN at element 2", |t| {
            let bytes = [1.0, 1.0, f32::NAN, 1.0].iter().flat_map(|w| w.to_le_bytes()).collect();
            set(t, (WEIGHT, Dtype::F32, vec![2, 2], bytes));
        }),
        ("`superpoints.blend_weight`: found -1 at element 1", |t| {
            let bytes = [1.0_f32, -1.0, 1.0, 1.0].iter().flat_map(|w| w.to_le_bytes()).collect();
            set(t, (WEIGHT, Dtype::F32, vec![2, 2], bytes));
        }),
        ("`superpoints.blend_weight`: found a sum of 0 from element 2 on", |t| {
            set(t, (WEIGHT, Dtype::U8, vec![2, 2], vec![1, 0, 0, 0]));
        }),
    ];
    for (expected, change) in cases {
        let found = message(change);
        assert!(found.contains(expected), "{expected} not in: {found}");
    }
    let mut scene = soft_scene(6, 3, 2);
    let own = &mut superpoints(&mut scene).of_gaussian[4];
    *own = (*own + 1) % 3;
    let folder = tempfile::tempdir().unwrap();
    let message = write(&folder.path().join("m.safetensors"), &scene).unwrap_err().to_string();
    assert!(message.contains("`superpoints.of_gaussian`") && message.contains("at element 4"), "{message}");
    assert!(message.contains("the largest weight in `superpoints.blend_index`"), "{message}");
}

#[test]
fn what_cannot_be_drawn_leaves_its_row_of_the_blend() {
    let mut scene = soft_scene(30, 4, 3);
    scene.gaussians.mean[1][0] = f32::NAN;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("m.safetensors");
    write(&file, &scene).unwrap();
    let loaded = crate::file::load(&file).unwrap().scene;
    let (before, after) = (scene.deformation.blend().unwrap(), loaded.deformation.blend().unwrap());
    assert_eq!((after.len(), after.row(0), after.row(1)), (29, before.row(0), before.row(2)));
    loaded.deformation.check(29).unwrap();
    let described = crate::file::describe(&file).unwrap();
    let blend = described.blend.clone().unwrap();
    assert_eq!((blend.neighbors, blend.soft), (3, after.soft_count() as f64 / 29.0));
    assert!(described.to_string().contains("up to 3 superpoints per Gaussian"), "{described}");
}

/// A tensor for the foreign writer.
type Foreign = (&'static str, Dtype, Vec<usize>, Vec<u8>);

/// A file as other programs write it, through the crate.
fn foreign(tensors: &[Foreign], metadata: &[(&str, &str)]) -> Vec<u8> {
    let views =
        tensors.iter().map(|(name, dtype, shape, data)| (*name, TensorView::new(*dtype, shape.clone(), data).unwrap()));
    let metadata: HashMap<String, String> = metadata.iter().map(|(k, v)| (k.to_string(), v.to_string())).collect();
    safetensors::serialize(views, Some(metadata)).unwrap()
}

fn floats(name: &'static str, shape: &[usize]) -> Foreign {
    let count = shape.iter().product::<usize>();
    (name, Dtype::F32, shape.to_vec(), (0..count).flat_map(|i| (i as f32 + 1.0).to_le_bytes()).collect())
}

fn zeros(name: &'static str, dtype: Dtype, shape: &[usize]) -> Foreign {
    (name, dtype, shape.to_vec(), vec![0; shape.iter().product::<usize>() * dtype.bitsize() / 8])
}

fn static_tensors() -> Vec<Foreign> {
    vec![
        floats("gaussians.mean", &[2, 3]),
        floats("gaussians.log_scale", &[2, 3]),
        floats("gaussians.rotation", &[2, 4]),
        floats("gaussians.opacity_logit", &[2]),
        floats("gaussians.sh", &[2, 4, 3]),
    ]
}

fn moving_tensors() -> Vec<Foreign> {
    let mut tensors = static_tensors();
    tensors.extend([
        zeros("superpoints.of_gaussian", Dtype::U32, &[2]),
        floats("superpoints.position", &[1, 3]),
        floats("motion.times", &[2]),
        floats("motion.rotation", &[2, 1, 3]),
        floats("motion.translation", &[2, 1, 3]),
        zeros("association.neighbor", Dtype::U32, &[2, 3]),
        floats("association.logit", &[2, 3]),
    ]);
    tensors
}

const SPGS: [(&str, &str); 2] = [("format", "spgs"), ("version", "1")];

#[test]
fn files_of_other_programs_are_read_with_a_warning() {
    let mut tensors = moving_tensors();
    tensors.push(zeros("optimizer.step", Dtype::I64, &[1]));
    tensors.push(floats("camera.exposure", &[2, 1]));
    let (scene, warnings) = parse(&foreign(&tensors, &[SPGS[0], SPGS[1], ("author", "x")]), path()).unwrap();
    assert!(warnings[0].contains("no checksums") && warnings[1].contains("optimizer.step"), "{warnings:?}");
    assert_eq!(scene.gaussians.sh_degree, 1);
    assert_eq!(scene.extra.keys().collect::<Vec<_>>(), ["camera.exposure"]);
    assert_eq!((scene.metadata.len(), scene.metadata["author"].as_str()), (1, "x"));
    assert_eq!(scene.deformation.association().unwrap().neighbors, 3);
}

#[test]
fn wrong_versions_and_formats_name_both() {
    let message =
        |metadata: &[(&str, &str)]| parse(&foreign(&static_tensors(), metadata), path()).unwrap_err().to_string();
    let version = message(&[("format", "spgs"), ("version", "2")]);
    assert!(version.contains("found version `2`, expected version `1`"), "{version}");
    assert!(message(&[("format", "pt"), ("version", "1")]).contains("found format `pt`, expected format `spgs`"));
    assert!(message(&[]).contains("`format`: found nothing"));
}

#[test]
fn wrong_shapes_types_and_groups_name_the_tensor() {
    let replaced = |tensor: Foreign| {
        let mut tensors = moving_tensors();
        tensors.retain(|t| t.0 != tensor.0);
        tensors.push(tensor);
        foreign(&tensors, &SPGS)
    };
    let mut cases: Vec<(Vec<u8>, String)> = moving_tensors()
        .iter()
        .map(|absent| {
            let tensors: Vec<Foreign> = moving_tensors().into_iter().filter(|t| t.0 != absent.0).collect();
            (foreign(&tensors, &SPGS), format!("tensor `{}`: found nothing", absent.0))
        })
        .collect();
    for (tensor, expected) in [
        (floats("gaussians.mean", &[2, 4]), "found F32 [2, 4], expected F32 [any, 3]"),
        (floats("gaussians.rotation", &[3, 4]), "found F32 [3, 4], expected F32 [2, 4]"),
        (floats("gaussians.sh", &[2, 5, 3]), "found K = 5"),
        (floats("gaussians.sh", &[2, 25, 3]), "found K = 25"),
        (zeros("gaussians.mean", Dtype::F16, &[2, 3]), "found F16 [2, 3]"),
        (floats("superpoints.of_gaussian", &[2]), "found F32 [2], expected U32 [2]"),
        (zeros("superpoints.of_gaussian", Dtype::I64, &[2]), "found I64 [2], expected U32 [2]"),
        (
            floats("motion.rotation", &[2, 2, 3]),
            "tensor `motion.translation`: found F32 [2, 1, 3], expected F32 [2, 2, 3]",
        ),
        (floats("superpoints.position", &[2, 3]), "tensor `motion.rotation`: found 2 poses, expected T·M = 2·2"),
        (floats("motion.times", &[3]), "expected F32 [3, any, 3]"),
        (zeros("motion.times", Dtype::F32, &[2]), "found 0 then 0 at element 1, expected strictly increasing"),
        (floats("association.logit", &[2, 4]), "expected F32 [2, 3]"),
        (floats("deform.linear.0.weight", &[256, 75]), "found F32 [256, 75], expected F32 [256, 76]"),
        (zeros("nonrigid.linear.0.weight", Dtype::F16, &[2]), "tensor `nonrigid.linear.0.weight`: found F16 [2]"),
    ] {
        cases.push((replaced(tensor), expected.into()));
    }
    for (bytes, expected) in cases {
        let message = parse(&bytes, path()).unwrap_err().to_string();
        assert!(message.contains(&expected), "{expected} not in: {message}");
    }
}

#[test]
fn indices_and_numbers_are_checked_in_both_directions() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("m.safetensors");
    let edits: [(&str, SceneEdit); 10] = [
        ("`superpoints.of_gaussian`: found 3 at element 1", |s| superpoints(s).of_gaussian[1] = 3),
        ("`superpoints.position`: found NaN at element 4", |s| superpoints(s).position[1][1] = f32::NAN),
        ("`motion.times`: found inf", |s| motion(s).times[1] = f32::INFINITY),
        ("`motion.times`: found 0.15 then -1", |s| motion(s).times[2] = -1.0),
        ("`motion.rotation`: found NaN", |s| motion(s).rotation[0][0] = f32::NAN),
        ("`motion.translation`: found -inf", |s| motion(s).translation[5][2] = f32::NEG_INFINITY),
        ("`motion.translation`: found 8 poses", |s| motion(s).translation.truncate(8)),
        ("`motion.times`: found no key time", |s| *motion(s) = Motion::default()),
        ("`association.neighbor`: found 9", |s| association(s).neighbor[3] = 9),
        ("`association.neighbor`: found K' = 0", |s| *association(s) = Default::default()),
    ];
    for (expected, edit) in edits {
        let mut scene = moving_scene(4, 3, 3);
        edit(&mut scene);
        let message = write(&file, &scene).unwrap_err().to_string();
        assert!(message.contains(expected), "{expected} not in: {message}");
        assert!(!file.exists(), "a half-written file");
    }
    let mut scene = moving_scene(4, 3, 3);
    scene.extra.insert("motion.times".into(), Tensor { shape: vec![1], data: vec![0.0] });
    assert!(write(&file, &scene).is_err());
    scene = moving_scene(4, 3, 3);
    scene.extra.insert("nonrigid.x".into(), Tensor { shape: vec![usize::MAX, 2], data: vec![0.0] });
    assert!(write(&file, &scene).is_err());
    // The same checks when reading: an index beyond M.
    let mut tensors = moving_tensors();
    tensors.iter_mut().filter(|t| t.0 == "association.neighbor").for_each(|t| t.3[4] = 1);
    let message = parse(&foreign(&tensors, &SPGS), path()).unwrap_err().to_string();
    assert!(
        message.contains("`association.neighbor`: found 1 at element 1, expected indices below M = 1"),
        "{message}"
    );
}

#[test]
fn models_of_motion_that_exclude_each_other_are_rejected() {
    let message = |tensors: &[Foreign]| parse(&foreign(tensors, &SPGS), path()).unwrap_err().to_string();
    let without = |space: &str| moving_tensors().into_iter().filter(|t| !t.0.starts_with(space)).collect::<Vec<_>>();
    let found = message(&without("superpoints."));
    assert!(found.contains("`superpoints.of_gaussian`: found nothing, though `motion.times` is there"), "{found}");
    let mut both = moving_tensors();
    both.extend([floats("field.head.weight", &[10, 4]), floats("field.head.bias", &[10])]);
    let found = message(&both);
    assert!(found.contains("a deformation field beside superpoints or network G"), "{found}");
}

type SceneEdit = fn(&mut Scene);

fn superpoints(scene: &mut Scene) -> &mut Superpoints {
    scene.deformation.superpoints_mut().unwrap()
}

fn association(scene: &mut Scene) -> &mut Association {
    scene.deformation.superpoint_deformation_mut().unwrap().association.as_mut().unwrap()
}

fn motion(scene: &mut Scene) -> &mut Motion {
    scene.deformation.table_mut().unwrap()
}

#[test]
fn reserved_metadata_is_the_formats_own() {
    let mut scene = moving_scene(2, 2, 2);
    scene.metadata.insert("version".into(), "99".into());
    scene.metadata.insert("checksum".into(), "mine".into());
    let (back, _) = parse(&encoded(&scene), path()).unwrap();
    assert_eq!(back.metadata, moving_scene(2, 2, 2).metadata);
}
