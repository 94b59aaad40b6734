//! Recorded camera paths: a NeRF `transforms.json` with a time per frame, which `spgs render --path` and `--cameras` read.

use std::path::{Path, PathBuf};

use engine::data::camera_file;
use engine::error::{Error, Result};
use engine::scene::Camera;

/// Seconds between two recorded frames.
pub(super) const INTERVAL_S: f64 = 1.0 / 30.0;
/// Longest path, frames: half an hour.
const MAX_FRAMES: usize = 54_000;

/// A path while it is recorded.
#[derive(Debug, Default)]
pub(super) struct Recording {
    cameras: Vec<Camera>,
    due: f64,
    /// Of the window when it began: a video has one size.
    size: Option<[u32; 2]>,
}

impl Recording {
    /// `dt` seconds passed, at whose end the camera was this one, of pictures of a size. The window may change its own.
    pub(super) fn frame(&mut self, dt: f64, window: [u32; 2], camera: impl Fn([u32; 2]) -> Camera) {
        let size = *self.size.get_or_insert(window);
        self.due += dt;
        while (self.due >= INTERVAL_S || self.cameras.is_empty()) && self.cameras.len() < MAX_FRAMES {
            self.due = (self.due - INTERVAL_S).max(0.0);
            self.cameras.push(camera(size));
        }
    }

    pub(super) fn len(&self) -> usize {
        self.cameras.len()
    }

    /// Writes the path as the next free `path-N.json` of a folder.
    pub(super) fn write(&self, folder: &Path) -> Result<PathBuf> {
        let path = free_name(folder, "path", "json")?;
        camera_file::write(&path, &self.cameras)?;
        Ok(path)
    }
}

/// `STEM-1.EXTENSION`, or the next number that is free.
pub(super) fn free_name(folder: &Path, stem: &str, extension: &str) -> Result<PathBuf> {
    crate::report::files::create_folder(folder)?;
    let name = |n: u32| folder.join(format!("{stem}-{n}.{extension}"));
    (1..100_000)
        .map(name)
        .find(|p| !p.exists())
        .ok_or_else(|| Error::usage("folder for images", folder.display().to_string(), "fewer than 100000 files"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use glam::DVec3;

    use super::*;

    #[test]
    fn a_recorded_path_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let mut recording = Recording::default();
        let camera = |i: f64, size: [u32; 2]| {
            let eye = DVec3::new(3.0 + i, -1.0, 2.0);
            Camera { time: 0.125 * i, ..Camera::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, 0.9, size) }
        };
        for i in 0..5 {
            // The window grows meanwhile; the pictures of the path do not.
            recording.frame(0.034, [320 + 10 * i, 200], |size| camera(f64::from(i), size));
        }
        let path = recording.write(folder.path()).unwrap();
        assert!(path.ends_with("path-1.json"));
        let set = engine::data::load_cameras(&path, None, None).unwrap();
        assert!(set.warnings.is_empty(), "{:?}", set.warnings);
        assert_eq!(set.cameras.len(), recording.len());
        for (back, expected) in set.cameras.iter().zip(&recording.cameras) {
            assert_eq!((back.width, back.height, back.time), (320, 200, expected.time));
            assert!(back.position.distance(expected.position) < 1e-6 && (back.fx - expected.fx).abs() < 1e-6);
            let turned = (back.rotation - expected.rotation).to_cols_array();
            assert!(turned.iter().all(|v| v.abs() < 1e-6), "{turned:?}");
        }
    }
}
