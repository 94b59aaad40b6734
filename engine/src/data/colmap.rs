//! COLMAP sparse models: `cameras` and `images`, `.bin` or `.txt` (the layouts of COLMAP's `reconstruction_io`).
//!
//! Poses are world-to-camera with OpenCV axes; the centre of the first pixel is at (0.5, 0.5), as here.

mod binary;
mod text;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};

use super::{CameraSet, MAX_IMAGE_SIDE, uniform_time};
use crate::error::{Error, Result};
use crate::scene::Camera;

/// Camera models by COLMAP's id: name and number of parameters. The parameters begin with one or two focal lengths and
/// the principal point; the rest is distortion.
const MODELS: [(&str, usize, usize); 12] = [
    ("SIMPLE_PINHOLE", 3, 1),
    ("PINHOLE", 4, 2),
    ("SIMPLE_RADIAL", 4, 1),
    ("RADIAL", 5, 1),
    ("OPENCV", 8, 2),
    ("OPENCV_FISHEYE", 8, 2),
    ("FULL_OPENCV", 12, 2),
    ("FOV", 5, 2),
    ("SIMPLE_RADIAL_FISHEYE", 4, 1),
    ("RADIAL_FISHEYE", 5, 1),
    ("THIN_PRISM_FISHEYE", 12, 2),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16, 2),
];

/// A camera as the file has it.
#[derive(Debug, Clone, PartialEq)]
struct RawCamera {
    id: u32,
    model: usize,
    size: [u64; 2],
    parameters: Vec<f64>,
    /// Place in the file.
    at: String,
}

/// An image as the file has it.
#[derive(Debug, Clone, PartialEq)]
struct RawImage {
    rotation: [f64; 4],
    translation: [f64; 3],
    camera: u32,
    name: String,
    /// Place in the file.
    at: String,
}

/// The folder that holds a COLMAP model: `folder`, `folder/sparse/0` or `folder/sparse`.
pub fn find(folder: &Path) -> Option<PathBuf> {
    ["", "sparse/0", "sparse"].iter().map(|sub| folder.join(sub)).find(|f| file(f, "images").is_some())
}

/// `stem.bin`, else `stem.txt`.
fn file(folder: &Path, stem: &str) -> Option<PathBuf> {
    ["bin", "txt"].iter().map(|extension| folder.join(format!("{stem}.{extension}"))).find(|f| f.is_file())
}

/// Reads the model in `folder`: all images, by name in natural order (`img2` before `img10`), times uniform over [0, 1].
/// Distorted cameras are taken as pinholes, with a warning.
///
/// # Errors
/// [`Error::Corrupt`] naming the byte or line; [`Error::Usage`] when a file is missing; [`Error::Io`].
pub fn read(folder: &Path) -> Result<CameraSet> {
    let open = |stem: &str| -> Result<(PathBuf, Vec<u8>)> {
        let expected = format!("{stem}.bin or {stem}.txt");
        let file = file(folder, stem)
            .ok_or_else(|| Error::usage(format!("COLMAP model in {}", folder.display()), "no such file", expected))?;
        let bytes = std::fs::read(&file).map_err(|e| Error::io(&file, "read", e))?;
        Ok((file, bytes))
    };
    let is_text = |path: &Path| path.extension().is_some_and(|e| e == "txt");
    let (camera_path, bytes) = open("cameras")?;
    let cameras = if is_text(&camera_path) {
        text::cameras(&bytes, &camera_path)?
    } else {
        binary::cameras(&bytes, &camera_path)?
    };
    let (image_path, bytes) = open("images")?;
    let images =
        if is_text(&image_path) { text::images(&bytes, &image_path)? } else { binary::images(&bytes, &image_path)? };
    assemble(cameras, images, &camera_path, &image_path)
}

fn assemble(
    cameras: Vec<RawCamera>,
    mut images: Vec<RawImage>,
    camera_path: &Path,
    image_path: &Path,
) -> Result<CameraSet> {
    let mut by_id = BTreeMap::new();
    let mut warnings = Vec::new();
    for camera in cameras {
        let pinhole = pinhole(&camera, camera_path)?;
        let distortion = &camera.parameters[MODELS[camera.model].2 + 2..];
        if distortion.iter().any(|&d| d != 0.0) {
            let (name, id) = (MODELS[camera.model].0, camera.id);
            let file = camera_path.display();
            warnings.push(format!("{file}: camera {id} is {name}: images are rendered undistorted (as PINHOLE)"));
        }
        if by_id.insert(camera.id, pinhole).is_some() {
            let found = format!("a second camera {}", camera.id);
            return Err(Error::corrupt(camera_path, camera.at, found, "each id once"));
        }
    }
    if images.is_empty() {
        return Err(Error::corrupt(image_path, "byte 0", "no image", "at least one"));
    }
    images.sort_by(|a, b| natural_order(&a.name, &b.name));
    let count = images.len();
    let cameras = images
        .into_iter()
        .enumerate()
        .map(|(i, image)| {
            let Some(pinhole) = by_id.get(&image.camera) else {
                let found = format!("camera {} of image `{}`", image.camera, image.name);
                let expected = format!("one of the {} cameras of {}", by_id.len(), camera_path.display());
                return Err(Error::corrupt(image_path, image.at, found, expected));
            };
            pose(image, pinhole, uniform_time(i, count), image_path)
        })
        .collect::<Result<Vec<_>>>()?;
    let source = image_path.parent().unwrap_or(image_path).display().to_string();
    Ok(CameraSet { cameras, warnings, source })
}

/// (fx, fy, cx, cy) and size.
type Pinhole = ([f64; 4], [u32; 2]);

fn pinhole(camera: &RawCamera, path: &Path) -> Result<Pinhole> {
    let corrupt = |found: String, expected: &str| {
        Err(Error::corrupt(path, format!("{} (camera {})", camera.at, camera.id), found, expected))
    };
    if camera.size.iter().any(|side| !(1..=u64::from(MAX_IMAGE_SIDE)).contains(side)) {
        let expected = format!("1 to {MAX_IMAGE_SIDE} pixels a side");
        return corrupt(format!("{} x {} pixels", camera.size[0], camera.size[1]), &expected);
    }
    let p = &camera.parameters;
    let intrinsics = if MODELS[camera.model].2 == 1 { [p[0], p[0], p[1], p[2]] } else { [p[0], p[1], p[2], p[3]] };
    let focal_ok = intrinsics[..2].iter().all(|f| *f > 1.0e-9 && *f < 1.0e9);
    if !(focal_ok && intrinsics[2..].iter().all(|c| c.abs() < 1.0e9)) {
        return corrupt(format!("fx fy cx cy = {intrinsics:?}"), "focal lengths above 0, finite numbers");
    }
    Ok((intrinsics, [camera.size[0] as u32, camera.size[1] as u32]))
}

fn pose(image: RawImage, (intrinsics, size): &Pinhole, time: f64, path: &Path) -> Result<Camera> {
    let [w, x, y, z] = image.rotation;
    let norm2 = image.rotation.iter().map(|q| q * q).sum::<f64>();
    let finite = image.translation.iter().all(|t| t.is_finite());
    if !(norm2 > 1.0e-12 && norm2 < 1.0e12 && finite) {
        let found = format!("quaternion {:?}, translation {:?}", image.rotation, image.translation);
        let at = format!("{} (image `{}`)", image.at, image.name);
        return Err(Error::corrupt(path, at, found, "a quaternion of length 1 and finite numbers"));
    }
    let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let [fx, fy, cx, cy] = *intrinsics;
    let position = -(rotation.transpose() * DVec3::from_array(image.translation));
    Ok(Camera { name: image.name, width: size[0], height: size[1], fx, fy, cx, cy, rotation, position, time })
}

/// Compares names with runs of digits by value, so that unpadded frame numbers are in order.
fn natural_order(a: &str, b: &str) -> std::cmp::Ordering {
    let (mut x, mut y) = (a.as_bytes(), b.as_bytes());
    while let (Some(&p), Some(&q)) = (x.first(), y.first()) {
        let order = if p.is_ascii_digit() && q.is_ascii_digit() {
            let (m, n) = (digits(&mut x), digits(&mut y));
            m.len().cmp(&n.len()).then_with(|| m.cmp(n))
        } else {
            (x, y) = (&x[1..], &y[1..]);
            p.cmp(&q)
        };
        if order.is_ne() {
            return order;
        }
    }
    x.len().cmp(&y.len()).then_with(|| a.cmp(b))
}

/// Takes the leading digits, returned without leading zeros.
fn digits<'a>(text: &mut &'a [u8]) -> &'a [u8] {
    let end = text.iter().position(|b| !b.is_ascii_digit()).unwrap_or(text.len());
    let (run, rest) = text.split_at(end);
    *text = rest;
    let zeros = run.iter().take_while(|&&b| b == b'0').count();
    &run[zeros..]
}

#[cfg(test)]
mod tests;
