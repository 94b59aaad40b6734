//! The f64 reference against results computed by independent implementations (`$SPGS_DATA/oracle`).

use std::io::Write as _;
use std::path::{Path, PathBuf};

use engine::Error;
use engine::reference::{Gaussians64, ReferenceOptions, render_gaussians};
use engine::scene::Camera;
use engine::scene::synthetic::random_gaussians;
use npyz::WriterBuilder;

use tools::dev::oracle;

/// Files of the oracle folder whose name starts with `prefix`; `None`, said loudly, when `SPGS_DATA` is not set.
fn oracle_files(prefix: &str) -> Option<Vec<PathBuf>> {
    let folder = tests_harness::data("oracle")?;
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)
        .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "npz"))
        .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix)))
        .collect();
    files.sort();
    assert!(!files.is_empty(), "{}: no {prefix}*.npz", folder.display());
    Some(files)
}

#[test]
fn images_agree_with_the_oracle() {
    for path in oracle_files("gaussians").unwrap_or_default() {
        let case = oracle::case::load(&path).unwrap();
        let difference = oracle::case::reference_difference(&case).unwrap();
        println!("{}: {difference:?}", path.display());
        assert!(difference.max <= 1.0e-12, "{}: {difference:?}", path.display());
    }
}

#[test]
fn network_and_motion_agree_with_the_oracle() {
    for path in oracle_files("superpoint").unwrap_or_default() {
        assert!(oracle::case::is_superpoint_file(&path).unwrap());
        let case = oracle::case::load_superpoint(&path).unwrap();
        let d = oracle::case::superpoint_difference(&case).unwrap();
        println!("{}: {d:?}", path.display());
        for error in [d.pose_rotation, d.pose_translation, d.mean, d.rotation] {
            assert!(error <= 1.0e-12, "{}: {d:?}", path.display());
        }
    }
}

/// Writes `arrays` (name, shape, values), plus the three integers, as an `.npz` file.
fn write_npz(path: &Path, integers: [(&str, i64); 3], arrays: &[(&str, Vec<u64>, Vec<f64>)]) {
    let mut file = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    for (name, value) in integers {
        write_entry(&mut file, name, &npy(&[], &[value]));
    }
    for (name, shape, values) in arrays {
        write_entry(&mut file, name, &npy(shape, values));
    }
    file.finish().unwrap();
}

fn write_entry(file: &mut zip::ZipWriter<std::fs::File>, name: &str, bytes: &[u8]) {
    file.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
    file.write_all(bytes).unwrap();
}

fn npy<T: npyz::AutoSerialize + Copy>(shape: &[u64], values: &[T]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(&mut bytes).begin_nd().unwrap();
    writer.extend(values.iter().copied()).unwrap();
    writer.finish().unwrap();
    bytes
}

fn widen<const W: usize>(rows: &[[f32; W]]) -> Vec<f64> {
    rows.iter().flatten().map(|&x| f64::from(x)).collect()
}

/// An oracle file of 40 Gaussians whose image is the reference's own.
fn own_case() -> Vec<(&'static str, Vec<u64>, Vec<f64>)> {
    let g = random_gaussians(40, 1, 1);
    let exact = Gaussians64 {
        mean: g.mean.iter().map(|v| v.map(f64::from)).collect(),
        log_scale: g.log_scale.iter().map(|v| v.map(f64::from)).collect(),
        rotation: g.rotation.iter().map(|v| v.map(f64::from)).collect(),
        opacity_logit: g.opacity_logit.iter().map(|&x| f64::from(x)).collect(),
        sh_degree: 1,
        sh: g.sh.iter().map(|&x| f64::from(x)).collect(),
        ..Gaussians64::default()
    };
    // x right, y down, z forward from (0, 0, −4).
    let view = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 4., 0., 0., 0., 1.];
    let matrix = glam::DMat4::from_cols_array(&view).transpose();
    let camera = Camera::from_world_to_camera(matrix, [30.0, 31.0, 9.5, 6.0], [20, 12]);
    let background = [0.2, 0.4, 0.6];
    let options = ReferenceOptions { near: oracle::case::NEAR, background, ..ReferenceOptions::default() };
    let image = render_gaussians(&exact, &camera, &options).unwrap();
    assert!(image.alpha.iter().any(|&a| a > 0.5));
    vec![
        ("means", vec![40, 3], widen(&g.mean)),
        ("log_scales", vec![40, 3], widen(&g.log_scale)),
        ("quats", vec![40, 4], widen(&g.rotation)),
        ("logit_opac", vec![40], exact.opacity_logit),
        ("sh", vec![40, 4, 3], exact.sh),
        ("viewmat", vec![4, 4], view.to_vec()),
        ("K", vec![3, 3], vec![30., 0., 9.5, 0., 31., 6., 0., 0., 1.]),
        ("bg", vec![3], background.to_vec()),
        ("image", vec![12, 20, 3], image.rgb),
    ]
}

const SIZES: [(&str, i64); 3] = [("width", 20), ("height", 12), ("sh_degree", 1)];

#[test]
fn a_file_of_our_own_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("case.npz");
    write_npz(&path, SIZES, &own_case());
    assert!(!oracle::case::is_superpoint_file(&path).unwrap());
    let case = oracle::case::load(&path).unwrap();
    // Only the camera position, which is recovered from the matrix, is rounded.
    assert!(oracle::case::reference_difference(&case).unwrap().max < 1.0e-13);
    let (scene, camera, background, near) = oracle::case::as_scene(&case);
    assert_eq!((scene.gaussians, near), (random_gaussians(40, 1, 1), 0.01));
    assert_eq!((camera.width, camera.height, background), (20, 12, [0.2, 0.4, 0.6]));
    let mut other = case;
    other.image[7] += 0.5;
    assert!((oracle::case::reference_difference(&other).unwrap().max - 0.5).abs() < 1.0e-12);
}

#[test]
fn damaged_files_are_named_not_believed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("case.npz");
    let refused_at = |expected: &str| match oracle::case::load(&path) {
        Err(Error::Corrupt { at, .. }) => assert_eq!(at, expected),
        other => panic!("{expected}: {other:?}"),
    };
    for (i, (name, ..)) in own_case().iter().enumerate() {
        let mut arrays = own_case();
        arrays.remove(i);
        write_npz(&path, SIZES, &arrays);
        refused_at(name);
    }
    let mut short = own_case();
    short[2] = ("quats", vec![39, 4], vec![0.5; 39 * 4]);
    write_npz(&path, SIZES, &short);
    refused_at("quats");
    write_npz(&path, [("width", 20), ("height", 12), ("sh_degree", 4)], &own_case());
    refused_at("sh_degree");
    write_npz(&path, [("width", -1), ("height", 12), ("sh_degree", 1)], &own_case());
    refused_at("width");
    write_npz(&path, SIZES, &own_case());
    let bytes = std::fs::read(&path).unwrap();
    for length in (0..bytes.len()).step_by(97) {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(matches!(oracle::case::load(&path), Err(Error::Corrupt { .. })), "{length} of {} bytes", bytes.len());
    }
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(oracle::case::load(&path), Err(Error::Io { .. })));
}
