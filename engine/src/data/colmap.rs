//! COLMAP sparse models: `cameras`, `images` and `points3D`, `.bin` or `.txt` (the layouts of COLMAP's `reconstruction_io`).
//!
//! Poses are world-to-camera with OpenCV axes; the centre of the first pixel is at (0.5, 0.5), as here.

mod binary;
mod text;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};

use super::frame::Frame;
use super::lens::{Distortion, Lens};
use super::{CameraSet, MAX_IMAGE_SIDE, uniform_time};
use crate::error::{Error, Result};

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
    /// Those that belong to a point.
    observations: Vec<Observation>,
    /// Place in the file.
    at: String,
}

/// Where an image shows a point of the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Observation {
    /// Pixels.
    pub(super) pixel: [f64; 2],
    /// Id of the point.
    pub(super) point: u64,
}

/// A point as the file has it.
#[derive(Debug, Clone, PartialEq)]
struct RawPoint {
    id: u64,
    position: [f64; 3],
    colour: [u8; 3],
    /// Place in the file.
    at: String,
}

/// An image with its camera.
#[derive(Debug, Clone)]
pub(super) struct ModelImage {
    /// The lens is that of the model; what it has beyond the formulas of [`crate::data::lens`] is left out and named in
    /// `unsupported`.
    pub(super) frame: Frame,
    /// Id of the camera.
    pub(super) camera: u32,
    /// Name of a camera model whose distortion is not supported.
    pub(super) unsupported: Option<&'static str>,
    /// Pixels at which it shows points.
    pub(super) observations: Vec<Observation>,
}

/// A point of the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ModelPoint {
    pub(super) id: u64,
    pub(super) position: DVec3,
    pub(super) colour: [u8; 3],
}

/// The folder that holds a COLMAP model: `folder`, `folder/sparse/0` or `folder/sparse`.
pub fn find(folder: &Path) -> Option<PathBuf> {
    ["", "sparse/0", "sparse"].iter().find_map(|sub| model_at(&folder.join(sub)))
}

/// The folder itself, if it holds a model.
pub(super) fn model_at(folder: &Path) -> Option<PathBuf> {
    Some(folder.to_path_buf()).filter(|f| file(f, "images").is_some())
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
    let images = images(folder)?;
    let source = folder.display().to_string();
    let mut warnings = BTreeMap::new();
    for image in &images {
        let lens = &image.frame.lens;
        if image.unsupported.is_some() || !lens.is_pinhole() {
            let camera = image.camera;
            let name = image.unsupported.map_or(String::new(), |name| format!(" ({name})"));
            warnings.entry(camera).or_insert_with(|| {
                format!("{source}: camera {camera} is distorted{name}: images are rendered undistorted (as PINHOLE)")
            });
        }
    }
    let cameras = images.iter().map(|image| image.frame.pinhole()).collect();
    Ok(CameraSet { cameras, warnings: warnings.into_values().collect(), source })
}

/// Path and content of `stem.bin` or `stem.txt`.
fn open(folder: &Path, stem: &str) -> Result<(PathBuf, Vec<u8>)> {
    let expected = format!("{stem}.bin or {stem}.txt");
    let file = file(folder, stem)
        .ok_or_else(|| Error::usage(format!("COLMAP model in {}", folder.display()), "no such file", expected))?;
    let bytes = std::fs::read(&file).map_err(|e| Error::io(&file, "read", e))?;
    Ok((file, bytes))
}

fn is_text(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "txt")
}

/// All images of a model, by name in natural order, with lenses; times uniform over [0, 1].
pub(super) fn images(folder: &Path) -> Result<Vec<ModelImage>> {
    let (camera_path, bytes) = open(folder, "cameras")?;
    let cameras = if is_text(&camera_path) {
        text::cameras(&bytes, &camera_path)?
    } else {
        binary::cameras(&bytes, &camera_path)?
    };
    let (image_path, bytes) = open(folder, "images")?;
    let images =
        if is_text(&image_path) { text::images(&bytes, &image_path)? } else { binary::images(&bytes, &image_path)? };
    assemble(cameras, images, &camera_path, &image_path)
}

/// The points of a model, in the order of the file; `None` without a `points3D` file.
pub(super) fn points(folder: &Path) -> Result<Option<Vec<ModelPoint>>> {
    if file(folder, "points3D").is_none() {
        return Ok(None);
    }
    let (path, bytes) = open(folder, "points3D")?;
    let raw = if is_text(&path) { text::points(&bytes, &path)? } else { binary::points(&bytes, &path)? };
    let point = |p: RawPoint| {
        let finite = p.position.iter().all(|c| c.is_finite());
        let found = || format!("position {:?} of point {}", p.position, p.id);
        let model = ModelPoint { id: p.id, position: DVec3::from_array(p.position), colour: p.colour };
        if finite { Ok(model) } else { Err(Error::corrupt(&path, p.at.clone(), found(), "finite numbers")) }
    };
    raw.into_iter().map(point).collect::<Result<Vec<_>>>().map(Some)
}

fn assemble(
    cameras: Vec<RawCamera>,
    mut images: Vec<RawImage>,
    camera_path: &Path,
    image_path: &Path,
) -> Result<Vec<ModelImage>> {
    let mut by_id = BTreeMap::new();
    for camera in cameras {
        if by_id.insert(camera.id, calibration(&camera, camera_path)?).is_some() {
            let found = format!("a second camera {}", camera.id);
            return Err(Error::corrupt(camera_path, camera.at, found, "each id once"));
        }
    }
    if images.is_empty() {
        return Err(Error::corrupt(image_path, "byte 0", "no image", "at least one"));
    }
    images.sort_by(|a, b| natural_order(&a.name, &b.name));
    let count = images.len();
    images
        .into_iter()
        .enumerate()
        .map(|(i, image)| {
            let Some(calibration) = by_id.get(&image.camera) else {
                let found = format!("camera {} of image `{}`", image.camera, image.name);
                let expected = format!("one of the {} cameras of {}", by_id.len(), camera_path.display());
                return Err(Error::corrupt(image_path, image.at, found, expected));
            };
            posed(image, calibration, uniform_time(i, count), image_path)
        })
        .collect()
}

/// Lens and size of a camera, and the name of its model where the distortion is not supported.
struct Calibration {
    lens: Lens,
    size: [u32; 2],
    unsupported: Option<&'static str>,
}

fn calibration(camera: &RawCamera, path: &Path) -> Result<Calibration> {
    let corrupt = |found: String, expected: &str| {
        Err(Error::corrupt(path, format!("{} (camera {})", camera.at, camera.id), found, expected))
    };
    if camera.size.iter().any(|side| !(1..=u64::from(MAX_IMAGE_SIDE)).contains(side)) {
        let expected = format!("1 to {MAX_IMAGE_SIDE} pixels a side");
        return corrupt(format!("{} x {} pixels", camera.size[0], camera.size[1]), &expected);
    }
    let p = &camera.parameters;
    let (name, _, focal_lengths) = MODELS[camera.model];
    let [fx, fy, cx, cy] = if focal_lengths == 1 { [p[0], p[0], p[1], p[2]] } else { [p[0], p[1], p[2], p[3]] };
    let focal_ok = [fx, fy].iter().all(|f| *f > 1.0e-9 && *f < 1.0e9);
    if !(focal_ok && [cx, cy].iter().all(|c| c.abs() < 1.0e9)) {
        return corrupt(format!("fx fy cx cy = {:?}", [fx, fy, cx, cy]), "focal lengths above 0, finite numbers");
    }
    let coefficients = &p[focal_lengths + 2..];
    if !coefficients.iter().all(|c| c.abs() < 1.0e9) {
        return corrupt(format!("distortion {coefficients:?}"), "finite numbers");
    }
    let distortion = distortion(name, coefficients);
    let lens =
        Lens { focal: [fx, fy], principal: [cx, cy], skew: 0.0, distortion: distortion.unwrap_or(Distortion::None) };
    let unsupported = distortion.is_none().then_some(name);
    Ok(Calibration { lens, size: [camera.size[0] as u32, camera.size[1] as u32], unsupported })
}

/// COLMAP's camera models (`src/colmap/sensor/models.h`) in the terms of [`Distortion`]; `None` for those that are not.
fn distortion(model: &str, coefficients: &[f64]) -> Option<Distortion> {
    let radial = |k1, k2| Distortion::brown([k1, k2, 0.0, 0.0], [0.0; 3], [0.0; 2]);
    match (model, coefficients) {
        ("FULL_OPENCV", &[k1, k2, p1, p2, k3, k4, k5, k6]) => {
            Some(Distortion::brown([k1, k2, k3, 0.0], [k4, k5, k6], [p1, p2]))
        }
        ("OPENCV", &[k1, k2, p1, p2]) => Some(Distortion::brown([k1, k2, 0.0, 0.0], [0.0; 3], [p1, p2])),
        ("RADIAL", &[k1, k2]) => Some(radial(k1, k2)),
        ("SIMPLE_RADIAL", &[k]) => Some(radial(k, 0.0)),
        ("OPENCV_FISHEYE", &[k1, k2, k3, k4]) => Some(Distortion::Fisheye([k1, k2, k3, k4])),
        ("RADIAL_FISHEYE", &[k1, k2]) => Some(Distortion::Fisheye([k1, k2, 0.0, 0.0])),
        ("SIMPLE_RADIAL_FISHEYE", &[k]) => Some(Distortion::Fisheye([k, 0.0, 0.0, 0.0])),
        (_, []) => Some(Distortion::None),
        _ => None,
    }
}

fn posed(image: RawImage, calibration: &Calibration, time: f64, path: &Path) -> Result<ModelImage> {
    let [w, x, y, z] = image.rotation;
    let norm2 = image.rotation.iter().map(|q| q * q).sum::<f64>();
    let finite = image.translation.iter().all(|t| t.is_finite());
    if !(norm2 > 1.0e-12 && norm2 < 1.0e12 && finite) {
        let found = format!("quaternion {:?}, translation {:?}", image.rotation, image.translation);
        let at = format!("{} (image `{}`)", image.at, image.name);
        return Err(Error::corrupt(path, at, found, "a quaternion of length 1 and finite numbers"));
    }
    let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let position = -(rotation.transpose() * DVec3::from_array(image.translation));
    let Calibration { lens, size, unsupported } = *calibration;
    let frame = Frame { name: image.name, lens, size, rotation, position, time, mask: None };
    Ok(ModelImage { frame, camera: image.camera, unsupported, observations: image.observations })
}

/// Compares names with runs of digits by value, so that unpadded frame numbers are in order.
pub(super) fn natural_order(a: &str, b: &str) -> std::cmp::Ordering {
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
