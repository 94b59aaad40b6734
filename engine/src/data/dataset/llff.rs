//! Forward-facing and monocular captures: LLFF's `poses_bounds.npy`, `precomputed.json` of nonrigid_nerf, and the NVIDIA
//! Dynamic Scene data (Yoon et al. 2020) in LLFF's layout.
//!
//! Both files hold, per frame, a 3×5 matrix [R | t | (height, width, focal length)], camera to world, and the depths of
//! the nearest and farthest point. In `poses_bounds.npy` the columns of R point down, right and backward; in
//! `precomputed.json`, written after NeRF's conversion, right, up and backward (measured on real data: photos agree under
//! a plane sweep with these axes only). Principal point in the centre, no distortion, no change of units.
//!
//! Pictures are those of `images`, or `images_K` for a downscale of K or a multiple, in natural order, one per row. Times
//! are uniform over [0, 1] in that order. A folder with 12 rows, or with `mv_images`, is NVIDIA's: frame t comes from
//! camera t mod 12; test pictures are camera 0 over time, `mv_images/TTTTT/cam01.EXT` (DynamicNeRF's protocol), if they
//! are there, else the training pictures themselves. Other folders hold out every 8th frame.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use serde_json::Value;

use super::views::{self, Stored};
use super::{DatasetKind, DatasetOptions, Points, Posed, Source, SplitRule, pictures};
use crate::data::frame::Frame;
use crate::data::json::{self, finite, show};
use crate::data::lens::{Distortion, Lens};
use crate::data::{LLFF_HOLD, MAX_IMAGE_SIDE, npy, transforms, uniform_time};
use crate::error::{Error, Result};

/// Cameras of the NVIDIA rig.
const NVIDIA_CAMERAS: usize = 12;
/// First points, spread over the training frames.
const RANDOM_POINTS: usize = 20_000;

/// The file that makes a folder one of these.
pub(super) fn file(folder: &Path) -> Option<PathBuf> {
    ["precomputed.json", "poses_bounds.npy"].map(|name| folder.join(name)).into_iter().find(|p| p.is_file())
}

/// A row of the file.
struct Row {
    /// 3×5, row-major.
    pose: [f64; 15],
    near: f64,
    far: f64,
}

pub(super) fn read(folder: &Path, file: &Path, options: &DatasetOptions) -> Result<Source> {
    let converted = file.extension().is_some_and(|e| e == "json");
    let rows = if converted { precomputed(file)? } else { poses_bounds(file)? };
    let count = rows.len();
    let downscale = views::downscale(options, 1)?;
    let (pictures, factor) = pictures::listed(folder, downscale)?;
    if !pictures.is_empty() && pictures.len() != count {
        let found = format!("{count} poses for {} images of {}", pictures.len(), folder.display());
        return Err(Error::corrupt(file, "number of rows", found, "one pose per image"));
    }
    let mut posed = Vec::with_capacity(count);
    for (i, row) in rows.iter().enumerate() {
        let frame = frame(row, converted, i, count, file)?;
        let missing = || folder.join("images").join(format!("image {i}"));
        let path = pictures.get(i).cloned().unwrap_or_else(missing);
        posed.push(Posed { frame, image: Stored { path, factor, mask: None } });
    }
    name_frames(&mut posed);
    let kind = if count == NVIDIA_CAMERAS && !converted || folder.join("mv_images").is_dir() {
        DatasetKind::Nvidia
    } else if converted {
        DatasetKind::NonrigidNerf
    } else {
        DatasetKind::Llff
    };
    let (near, far) = rows.iter().fold((f64::INFINITY, 0.0f64), |(n, f), r| (n.min(r.near), f.max(r.far)));
    let mut decisions = vec![
        format!(
            "poses: {count} of {} (axes {})",
            file_name(file),
            if converted { "right, up, back" } else { "LLFF's" }
        ),
        format!("bounds: depths {near:.4} to {far:.4}; units as stored"),
        format!("time rule: index / {} in the order of the images' names", (count - 1).max(1)),
    ];
    let points = random_points(&rows, &posed);
    decisions.push(format!(
        "points: none stored, {} random grey ones between the depth bounds of the cameras",
        points.position.len()
    ));
    let (train, test) = split(kind, folder, posed, options, &mut decisions);
    Ok(Source { kind, train, test, val: Vec::new(), points: Some(points), default_downscale: 1, decisions })
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

fn name_frames(posed: &mut [Posed]) {
    for p in posed {
        p.frame.name = file_name(&p.image.path);
    }
}

fn split(
    kind: DatasetKind,
    folder: &Path,
    all: Vec<Posed>,
    options: &DatasetOptions,
    decisions: &mut Vec<String>,
) -> (Vec<Posed>, Vec<Posed>) {
    let rule = match (options.split, kind) {
        (SplitRule::Auto, DatasetKind::Nvidia) => {
            let test = fixed_view(folder, &all);
            if test.is_empty() {
                decisions
                    .push("split: all frames train; NO TEST PICTURES (mv_images/TTTTT/cam01): test = train".into());
                return (all.clone(), all);
            }
            decisions.push("split: frame t of camera t trains, camera 0 at the other times tests (DynamicNeRF)".into());
            return (all, test);
        }
        (SplitRule::Auto | SplitRule::Lists, _) => SplitRule::Hold(LLFF_HOLD),
        (rule, _) => rule,
    };
    decisions.push(rule.describe());
    rule.divide(all)
}

/// Camera 0 at every time but its own, where the picture exists.
fn fixed_view(folder: &Path, all: &[Posed]) -> Vec<Posed> {
    let Some(first) = all.first() else { return Vec::new() };
    let at = |(t, own): (usize, &Posed)| {
        let stem = folder.join("mv_images").join(format!("{t:05}"));
        let path = pictures::EXTENSIONS.map(|e| stem.join(format!("cam01.{e}"))).into_iter().find(|p| p.is_file())?;
        let frame = Frame { time: own.frame.time, name: format!("v000_t{t:03}"), ..first.frame.clone() };
        Some(Posed { frame, image: Stored { path, factor: 1, mask: None } })
    };
    all.iter().enumerate().skip(1).filter_map(at).collect()
}

// ------------------------------------------------------------------------------------------------ files

fn poses_bounds(path: &Path) -> Result<Vec<Row>> {
    let matrix = npy::read(path, 17)?;
    let row = |row: &[f64]| {
        let mut pose = [0.0; 15];
        pose.copy_from_slice(&row[..15]);
        Row { pose, near: row[15], far: row[16] }
    };
    matrix.rows().enumerate().map(|(i, values)| checked(row(values), i, path)).collect()
}

fn precomputed(path: &Path) -> Result<Vec<Row>> {
    let top = json::file(path, "nonrigid_nerf's precomputed.json")?;
    let list = |key: &str| {
        top.get(key).and_then(Value::as_array).filter(|l| !l.is_empty()).ok_or_else(|| {
            let found = top.get(key).map_or("nothing".into(), show);
            Error::corrupt(path, format!("key `{key}`"), found, "a list with an entry per frame")
        })
    };
    let (poses, bounds) = (list("poses")?, list("bds")?);
    if poses.len() != bounds.len() {
        let found = format!("{} for {} poses", bounds.len(), poses.len());
        return Err(Error::corrupt(path, "key `bds`", found, "one pair per pose"));
    }
    let row = |(i, (pose, bound)): (usize, (&Value, &Value))| {
        let at = |key: &str| format!("key `{key}[{i}]`");
        let wrong = |key: &str, value: &Value, expected| Error::corrupt(path, at(key), show(value), expected);
        let expected = "3 rows of 5 finite numbers";
        let numbers: Option<Vec<f64>> = pose.as_array().filter(|rows| rows.len() == 3).and_then(|rows| {
            let row = |row: &Value| row.as_array().filter(|row| row.len() == 5).cloned();
            rows.iter().map(row).collect::<Option<Vec<_>>>()?.iter().flatten().map(finite).collect()
        });
        let pose: [f64; 15] = numbers.and_then(|n| n.try_into().ok()).ok_or_else(|| wrong("poses", pose, expected))?;
        let pair = bound.as_array().filter(|pair| pair.len() == 2);
        let pair = pair.and_then(|p| Some((finite(&p[0])?, finite(&p[1])?)));
        let (near, far) = pair.ok_or_else(|| wrong("bds", bound, "2 finite numbers"))?;
        checked(Row { pose, near, far }, i, path)
    };
    poses.iter().zip(bounds).enumerate().map(row).collect()
}

fn checked(row: Row, i: usize, path: &Path) -> Result<Row> {
    let (near, far) = (row.near, row.far);
    if near > 0.0 && near < far {
        return Ok(row);
    }
    let at = format!("row {i} (bounds)");
    Err(Error::corrupt(path, at, format!("depths {near} to {far}"), "0 < near < far"))
}

fn frame(row: &Row, converted: bool, i: usize, count: usize, path: &Path) -> Result<Frame> {
    let p = &row.pose;
    let column = |c: usize| DVec3::new(p[c], p[5 + c], p[10 + c]);
    // OpenCV's axes: right, down, forward.
    let axes = if converted {
        DMat3::from_cols(column(0), -column(1), -column(2))
    } else {
        DMat3::from_cols(column(1), column(0), -column(2))
    };
    let corrupt =
        |what: &str, found: String, expected: &str| Error::corrupt(path, format!("row {i} ({what})"), found, expected);
    let (rotation, scale) =
        transforms::rigid(axes).map_err(|found| corrupt("pose", found, "a right-handed rotation"))?;
    if (scale - 1.0).abs() > 1.0e-3 {
        return Err(corrupt("pose", format!("a scale of {scale:.6}"), "a rotation"));
    }
    let (height, width, focal) = (p[4], p[9], p[14]);
    let side = |s: f64| s.fract() == 0.0 && s >= 1.0 && s <= f64::from(MAX_IMAGE_SIDE);
    if !(side(height) && side(width) && focal > 1.0e-9 && focal < 1.0e9) {
        let expected = format!("whole sides of 1 to {MAX_IMAGE_SIDE} and a focal length above 0");
        return Err(corrupt("height, width, focal length", format!("{height}, {width}, {focal}"), &expected));
    }
    let lens =
        Lens { focal: [focal; 2], principal: [0.5 * width, 0.5 * height], skew: 0.0, distortion: Distortion::None };
    let size = [width as u32, height as u32];
    let (rotation, position) = (rotation.transpose(), column(3));
    Ok(Frame { name: String::new(), lens, size, rotation, position, time: uniform_time(i, count), mask: None })
}

// ------------------------------------------------------------------------------------------------ first points

/// Points spread evenly over the pixels and the depths between the bounds of every camera; the same on every run.
fn random_points(rows: &[Row], posed: &[Posed]) -> Points {
    let each = RANDOM_POINTS.div_ceil(rows.len());
    let mut random = Random(0x5eed);
    let mut position = Vec::with_capacity(each * rows.len());
    for (row, Posed { frame, .. }) in rows.iter().zip(posed) {
        for _ in 0..each {
            let [u, v] = frame.size.map(|side| random.next() * f64::from(side));
            let [x, y] = frame.lens.pinhole_direction(u, v);
            let depth = row.near + random.next() * (row.far - row.near);
            let point = frame.position + frame.rotation.transpose() * (depth * DVec3::new(x, y, 1.0));
            position.push(point.as_vec3().to_array());
        }
    }
    Points { colour: vec![[128; 3]; position.len()], position }
}

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    /// Uniform in [0, 1).
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) as f64 / 2.0f64.powi(64)
    }
}
