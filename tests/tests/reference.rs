//! The f64 reference against results computed by independent implementations (`$SPGS_DATA/oracle`).

use std::path::PathBuf;

use tools::oracle;

/// Files of the oracle folder whose name starts with `prefix`; `None`, said loudly, when `SPGS_DATA` is not set.
fn oracle_files(prefix: &str) -> Option<Vec<PathBuf>> {
    let Some(data) = std::env::var_os("SPGS_DATA") else {
        eprintln!("SKIPPED: SPGS_DATA is not set, so the reference is NOT compared with outside truth");
        return None;
    };
    let folder = PathBuf::from(data).join("oracle");
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
        let case = oracle::load(&path).unwrap();
        let difference = oracle::reference_difference(&case).unwrap();
        println!("{}: {difference:?}", path.display());
        assert!(difference.max <= 1.0e-12, "{}: {difference:?}", path.display());
    }
}

#[test]
fn network_and_motion_agree_with_the_oracle() {
    for path in oracle_files("superpoint").unwrap_or_default() {
        assert!(oracle::is_superpoint_file(&path).unwrap());
        let case = oracle::load_superpoint(&path).unwrap();
        let d = oracle::superpoint_difference(&case).unwrap();
        println!("{}: {d:?}", path.display());
        for error in [d.pose_rotation, d.pose_translation, d.mean, d.rotation] {
            assert!(error <= 1.0e-12, "{}: {d:?}", path.display());
        }
    }
}
