//! Writing camera files: a recorded path is a NeRF `transforms.json`, which [`super::transforms`] and other programs read.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde_json::{Value, json};

use crate::error::{Error, Result};
use crate::file::durable::write_atomic;
use crate::scene::Camera;

/// Writes cameras in order, each with its time, intrinsics and camera-to-world matrix (OpenGL axes). The file is there
/// whole or not at all.
///
/// # Errors
/// `Usage` for an empty list, `NonFinite` for a camera that is not finite, [`Error::Io`].
pub fn write(path: &Path, cameras: &[Camera]) -> Result<()> {
    if cameras.is_empty() {
        return Err(Error::usage("camera file", "no cameras", "at least one"));
    }
    let frames = cameras.iter().enumerate().map(|(i, c)| frame(i, c)).collect::<Result<Vec<Value>>>()?;
    let text = serde_json::to_string_pretty(&json!({ "frames": frames }))
        .map_err(|e| Error::usage("camera file", e.to_string(), "serialisable values"))?;
    write_atomic(path, |out| out.write_all(text.as_bytes()))
}

fn frame(index: usize, camera: &Camera) -> Result<Value> {
    // OpenCV's y and z axes turned round.
    let axes = camera.rotation.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let row = |i: usize| [axes.x_axis[i], axes.y_axis[i], axes.z_axis[i], camera.position[i]];
    let values = [row(0), row(1), row(2), [camera.fx, camera.fy, camera.cx, camera.cy], [camera.time, 0.0, 0.0, 0.0]];
    if let Some(value) = values.iter().flatten().find(|v| !v.is_finite()) {
        return Err(Error::NonFinite { what: "camera".into(), index, value: value.to_string() });
    }
    let name = if camera.name.is_empty() { format!("{index:05}") } else { camera.name.clone() };
    Ok(json!({
        "file_path": name,
        "time": camera.time,
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
    }))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("path.json");
        let cameras: Vec<Camera> = (0..4)
            .map(|i| {
                let eye = DVec3::new(2.0, f64::from(i), 1.5);
                let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7 + 0.1 * f64::from(i), [64 + i as u32, 48]);
                Camera { time: 0.1 * f64::from(i), cx: 30.25, ..camera }
            })
            .collect();
        write(&path, &cameras).unwrap();
        let read = super::super::transforms::read(&path, None).unwrap();
        assert!(read.warnings.is_empty(), "{:?}", read.warnings);
        for (a, b) in cameras.iter().zip(&read.cameras) {
            assert_eq!([a.width, a.height], [b.width, b.height]);
            assert!((a.rotation - b.rotation).to_cols_array().iter().all(|v| v.abs() < 1e-9));
            assert!((a.position - b.position).length() < 1e-9);
            assert_eq!([a.fx, a.fy, a.cx, a.cy, a.time], [b.fx, b.fy, b.cx, b.cy, b.time]);
        }
        assert_eq!(read.cameras.len(), 4);
        assert!(write(&path, &[]).is_err());
        let broken = Camera { fx: f64::NAN, ..cameras[0].clone() };
        assert!(write(&path, &[broken]).is_err());
        assert_eq!(super::super::transforms::read(&path, None).unwrap().cameras.len(), 4, "the old file stays");
    }
}
