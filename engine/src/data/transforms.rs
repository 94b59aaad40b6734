//! NeRF `transforms*.json`: camera-to-world matrices with OpenGL axes (x right, y up, z backward).
//!
//! Keys, each per frame or at the top (the frame's wins): `fl_x fl_y cx cy w h` in pixels, or `camera_angle_x`
//! (`camera_angle_y`) in radians, f = W / (2 tan(a/2)); `time`; `file_path`; `transform_matrix`. Sources: NeRF's Blender
//! data, D-NeRF, instant-ngp and nerfstudio.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use serde_json::Value;

use super::frame::Frame;
use super::json::{self, Keys, finite, show};
use super::lens::{Distortion, Lens};
use super::{CameraSet, MAX_IMAGE_SIDE, uniform_time};
use crate::error::{Error, Result};

/// How far the columns may be from orthonormal, after a uniform scale is taken out.
const ORTHONORMAL: f64 = 1.0e-3;

/// Reads one camera file; see [`super::load_cameras`] for `size_override`.
///
/// # Errors
/// [`Error::Corrupt`] naming the frame and the key; [`Error::Io`]; [`Error::Limit`] for a file above 64 MiB.
pub fn read(path: &Path, size_override: Option<[u32; 2]>) -> Result<CameraSet> {
    let text = json::text(path)?;
    parse(&text, path, size_override)
}

/// [`read`] from memory; `path` names the source in errors, and images are looked for beside it.
///
/// # Errors
/// As [`read`].
pub fn parse(text: &[u8], path: &Path, size_override: Option<[u32; 2]>) -> Result<CameraSet> {
    let file = frames(text, path, size_override)?;
    let cameras = file.frames.iter().map(Frame::pinhole).collect();
    let mut warnings = file.assumed;
    if file.distorted > 0 {
        let (n, count) = (file.distorted, file.frames.len());
        let name = path.display();
        warnings.push(format!("{name}: {n} of {count} frames have lens distortion: images are rendered undistorted"));
    }
    Ok(CameraSet { cameras, warnings, source: path.display().to_string() })
}

/// A camera file with its lenses.
#[derive(Debug)]
pub(super) struct File {
    /// In the order of the file; at least one.
    pub(super) frames: Vec<Frame>,
    /// The keys beside `frames`.
    pub(super) top: Keys,
    /// What was assumed, one line each.
    pub(super) assumed: Vec<String>,
    /// Number of frames with lens distortion.
    distorted: usize,
}

/// [`parse`] with lens distortion kept.
pub(super) fn frames(text: &[u8], path: &Path, size_override: Option<[u32; 2]>) -> Result<File> {
    let mut top = json::object(text, path, "a NeRF transforms.json")?;
    let list = match top.remove("frames") {
        Some(Value::Array(frames)) if !frames.is_empty() => frames,
        other => {
            let found = other.as_ref().map_or("nothing".into(), show);
            return Err(Error::corrupt(path, "key `frames`", found, "a list of at least one frame"));
        }
    };
    let count = list.len();
    let mut notes = Notes::default();
    let frames = list
        .iter()
        .enumerate()
        .map(|(index, frame)| {
            let frame = frame.as_object().ok_or_else(|| {
                Error::corrupt(path, format!("frame {index}"), show(frame), "an object with `transform_matrix`")
            })?;
            Reader { path, top: &top, frame, index }.frame(count, size_override, &mut notes)
        })
        .collect::<Result<Vec<_>>>()?;
    let assumed = notes.lines(count, path);
    Ok(File { frames, top, assumed, distorted: notes.distorted })
}

/// What had to be assumed, counted over the frames.
#[derive(Debug, Default)]
struct Notes {
    without_time: usize,
    distorted: usize,
    scaled: usize,
}

impl Notes {
    fn lines(&self, count: usize, path: &Path) -> Vec<String> {
        let name = path.display();
        let mut lines = Vec::new();
        if self.without_time > 0 {
            lines.push(format!(
                "{name}: {} of {count} frames have no `time`: index / (n − 1) is used",
                self.without_time
            ));
        }
        if self.scaled > 0 {
            lines.push(format!("{name}: {} of {count} poses contain a scale: it is ignored", self.scaled));
        }
        lines
    }
}

struct Reader<'a> {
    path: &'a Path,
    top: &'a Keys,
    frame: &'a Keys,
    index: usize,
}

impl Reader<'_> {
    fn corrupt(&self, key: &str, found: impl Into<String>, expected: &str) -> Error {
        Error::corrupt(self.path, format!("frame {} key `{key}`", self.index), found, expected)
    }

    /// The frame's value, else the top's.
    fn get(&self, key: &str) -> Option<&Value> {
        self.frame.get(key).or_else(|| self.top.get(key))
    }

    fn frame(&self, count: usize, size_override: Option<[u32; 2]>, notes: &mut Notes) -> Result<Frame> {
        let name = self.string("file_path")?.unwrap_or_default();
        let (rotation, position, scale) = self.pose()?;
        notes.scaled += usize::from((scale - 1.0).abs() > ORTHONORMAL);
        let distortion = self.distortion()?;
        notes.distorted += usize::from(distortion != Distortion::None);
        let time = match self.frame.get("time") {
            None => {
                notes.without_time += 1;
                uniform_time(self.index, count)
            }
            Some(value) => finite(value).ok_or_else(|| self.corrupt("time", show(value), "a finite number"))?,
        };
        let (intrinsics, size) = self.intrinsics(&name, size_override)?;
        let [fx, fy, cx, cy] = intrinsics;
        let lens = Lens { focal: [fx, fy], principal: [cx, cy], skew: 0.0, distortion };
        Ok(Frame { name, lens, size, rotation, position, time, mask: self.string("mask_path")? })
    }

    fn string(&self, key: &str) -> Result<Option<String>> {
        match self.frame.get(key) {
            None => Ok(None),
            Some(Value::String(text)) => Ok(Some(text.clone())),
            Some(other) => Err(self.corrupt(key, show(other), "a string")),
        }
    }

    /// `camera_model` *FISHEYE or `is_fisheye`: k1 to k4 on the angle. Else OpenCV's k1 k2 k3 p1 p2, and nerfstudio's k4
    /// on r⁸.
    fn distortion(&self) -> Result<Distortion> {
        let model = self.get("camera_model").and_then(Value::as_str).unwrap_or("");
        let fisheye = self.get("is_fisheye").and_then(Value::as_bool).unwrap_or(false);
        let value = |key: &str| Ok::<_, Error>(self.number(key)?.unwrap_or(0.0));
        let k = [value("k1")?, value("k2")?, value("k3")?, value("k4")?];
        let p = [value("p1")?, value("p2")?];
        Ok(if fisheye || model.contains("FISHEYE") {
            Distortion::Fisheye(k)
        } else {
            Distortion::brown(k, [0.0; 3], p)
        })
    }

    // ------------------------------------------------------------------------------------ intrinsics

    /// (fx, fy, cx, cy) and the image size, both after the override.
    fn intrinsics(&self, name: &str, size_override: Option<[u32; 2]>) -> Result<([f64; 4], [u32; 2])> {
        let native = self.size(name)?;
        let Some(size) = size_override.or(native) else {
            let expected = "`w` and `h`, or an image at `file_path` (as is, .png, .jpg), or a size given by the caller";
            return Err(self.corrupt("w", format!("no size and no image `{name}`"), expected));
        };
        let (w, h) = (f64::from(size[0]), f64::from(size[1]));
        let scale = native.map_or([1.0, 1.0], |n| [w / f64::from(n[0]), h / f64::from(n[1])]);
        let (fx, fy) = self.focal(w, h, scale)?;
        let cx = self.number("cx")?.map_or(0.5 * w, |c| c * scale[0]);
        let cy = self.number("cy")?.map_or(0.5 * h, |c| c * scale[1]);
        Ok(([fx, fy, cx, cy], size))
    }

    /// The frame's focal length or angle wins over the top's; at one level pixels win over the angle.
    fn focal(&self, w: f64, h: f64, scale: [f64; 2]) -> Result<(f64, f64)> {
        for level in [self.frame, self.top] {
            if let Some(fx) = self.positive(level, "fl_x")? {
                let fy = self.positive(level, "fl_y")?.unwrap_or(fx);
                return Ok((fx * scale[0], fy * scale[1]));
            }
            if let Some(fx) = self.angle(level, "camera_angle_x", w)? {
                let fy = self.angle(level, "camera_angle_y", h)?.unwrap_or(fx);
                return Ok((fx, fy));
            }
        }
        Err(self.corrupt("camera_angle_x", "neither it nor `fl_x`, here or at the top", "one of them"))
    }

    fn angle(&self, level: &Keys, key: &str, side: f64) -> Result<Option<f64>> {
        let Some(angle) = self.positive(level, key)? else { return Ok(None) };
        if angle >= std::f64::consts::PI {
            return Err(self.corrupt(key, angle.to_string(), "an angle between 0 and π, radians"));
        }
        Ok(Some(0.5 * side / (0.5 * angle).tan()))
    }

    fn positive(&self, level: &Keys, key: &str) -> Result<Option<f64>> {
        let Some(value) = level.get(key) else { return Ok(None) };
        match finite(value) {
            Some(v) if v > 1.0e-9 && v < 1.0e9 => Ok(Some(v)),
            _ => Err(self.corrupt(key, show(value), "a number above 0")),
        }
    }

    fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some(value) = self.get(key) else { return Ok(None) };
        match finite(value) {
            Some(v) if v.abs() < 1.0e9 => Ok(Some(v)),
            _ => Err(self.corrupt(key, show(value), "a finite number")),
        }
    }

    /// Size by `w` and `h`, else by the image's header; `None` when there is neither.
    fn size(&self, name: &str) -> Result<Option<[u32; 2]>> {
        let side = |key: &str| -> Result<Option<u32>> {
            match self.number(key)? {
                None => Ok(None),
                Some(v) if v.fract() == 0.0 && v >= 1.0 && v <= f64::from(MAX_IMAGE_SIDE) => Ok(Some(v as u32)),
                Some(v) => {
                    let expected = format!("a whole number of pixels from 1 to {MAX_IMAGE_SIDE}");
                    Err(self.corrupt(key, v.to_string(), &expected))
                }
            }
        };
        match (side("w")?, side("h")?) {
            (Some(w), Some(h)) => Ok(Some([w, h])),
            (None, None) => {
                Ok(image_size(self.path, name).filter(|s| s.iter().all(|s| (1..=MAX_IMAGE_SIDE).contains(s))))
            }
            (Some(_), None) => Err(self.corrupt("h", "only `w`", "both `w` and `h`")),
            (None, Some(_)) => Err(self.corrupt("w", "only `h`", "both `w` and `h`")),
        }
    }

    // ------------------------------------------------------------------------------------------ pose

    /// Rotation world → camera (OpenCV), camera centre, and the scale that the matrix contained.
    fn pose(&self) -> Result<(DMat3, DVec3, f64)> {
        const KEY: &str = "transform_matrix";
        let Some(value) = self.frame.get(KEY) else {
            return Err(self.corrupt(KEY, "nothing", "a 4x4 camera-to-world matrix"));
        };
        let rows = value.as_array().filter(|rows| matches!(rows.len(), 3 | 4));
        let rows = rows.ok_or_else(|| self.corrupt(KEY, show(value), "4 rows of 4 numbers"))?;
        let mut m = [[0.0, 0.0, 0.0, 0.0], [0.0; 4], [0.0; 4], [0.0, 0.0, 0.0, 1.0]];
        for (r, row) in rows.iter().enumerate() {
            let numbers = row.as_array().filter(|row| row.len() == 4);
            let numbers = numbers.ok_or_else(|| self.corrupt(&format!("{KEY}[{r}]"), show(row), "4 numbers"))?;
            for (c, number) in numbers.iter().enumerate() {
                m[r][c] = finite(number).ok_or_else(|| {
                    let found = if number.is_null() { "NaN, Infinity or null".into() } else { show(number) };
                    self.corrupt(&format!("{KEY}[{r}][{c}]"), found, "a finite number")
                })?;
            }
        }
        if m[3].iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(a, b)| (a - b).abs() > ORTHONORMAL) {
            return Err(self.corrupt(&format!("{KEY}[3]"), format!("{:?}", m[3]), "[0, 0, 0, 1]"));
        }
        let column = |c: usize| DVec3::new(m[0][c], m[1][c], m[2][c]);
        let c2w = DMat3::from_cols(column(0), column(1), column(2));
        let (rotation, scale) = rigid(c2w).map_err(|found| {
            self.corrupt(KEY, found, "a rotation (columns orthonormal up to one scale, right-handed)")
        })?;
        // OpenGL's camera looks along −z with y up: flip both axes for OpenCV.
        let opencv = DMat3::from_cols(rotation.x_axis, -rotation.y_axis, -rotation.z_axis);
        Ok((opencv.transpose(), column(3), scale))
    }
}

/// Splits `m` into a rotation and a uniform scale, or says why that cannot be.
pub(super) fn rigid(m: DMat3) -> Result<(DMat3, f64), String> {
    let determinant = m.determinant();
    if !(determinant > 1.0e-12 && determinant.is_finite()) {
        return Err(format!("determinant {determinant:.3e}"));
    }
    let scale = determinant.cbrt();
    let mut r = m * (1.0 / scale);
    let error = |r: DMat3| {
        let gram = r.transpose() * r - DMat3::IDENTITY;
        gram.to_cols_array().into_iter().fold(0.0, |worst: f64, v| if v.abs() <= worst { worst } else { v.abs() })
    };
    let found = error(r);
    if found.is_nan() || found > ORTHONORMAL {
        return Err(format!("columns {found:.2e} from orthonormal"));
    }
    // Newton's iteration to the nearest rotation: files hold f32 values; three steps take 1e-3 below 1e-16.
    for _ in 0..3 {
        r = 0.5 * (r + r.inverse().transpose());
    }
    Ok((r, scale))
}

/// Size of the frame's image by its header: `file_path` as is, then with the usual extensions.
fn image_size(path: &Path, name: &str) -> Option<[u32; 2]> {
    find_image(path, name).and_then(|file| {
        let reader = image::ImageReader::open(file).ok()?.with_guessed_format().ok()?;
        reader.into_dimensions().ok().map(|(w, h)| [w, h])
    })
}

/// The image of a frame, relative to the camera file's folder.
pub fn find_image(camera_file: &Path, name: &str) -> Option<PathBuf> {
    if name.is_empty() {
        return None;
    }
    let base = camera_file.parent().unwrap_or(Path::new("")).join(name);
    ["", ".png", ".jpg", ".jpeg", ".JPG", ".PNG"]
        .iter()
        .map(|extension| {
            let mut file = base.clone().into_os_string();
            file.push(extension);
            PathBuf::from(file)
        })
        .find(|file| file.is_file())
}
