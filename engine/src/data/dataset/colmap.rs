//! COLMAP models with their photos in `images` (or `images_K` for a downscale of K or a multiple), distorted or not.
//!
//! Times: `times.json` ({"name": t} or a list in the order of the names), else `times.txt` (lines `NAME t`, or `t` alone in
//! that order; `#` comments), else the last number in each name, else uniform; the last two are scaled to [0, 1]. Masks:
//! `masks/NAME.png` (COLMAP's rule) or `masks/NAME`.

use std::collections::HashMap;
use std::path::Path;

use serde_json::Value;

use super::views::{self, Stored};
use super::{DatasetKind, DatasetOptions, Points, Posed, Source, SplitRule, pictures};
use crate::data::{LLFF_HOLD, colmap, json, uniform_time};
use crate::error::{Error, Result};

pub(super) fn read(folder: &Path, model: &Path, options: &DatasetOptions) -> Result<Source> {
    let images = colmap::images(model)?;
    let downscale = views::downscale(options, 1)?;
    let (photos, factor) = pictures::level(folder, downscale);
    let masks = folder.join("masks");
    let mut posed = Vec::with_capacity(images.len());
    for image in images {
        if let Some(name) = image.unsupported {
            let found = format!("model {name}");
            let expected = "a pinhole, *RADIAL, OPENCV or *FISHEYE model (or photos undistorted by COLMAP)";
            return Err(Error::corrupt(model, format!("camera {}", image.camera), found, expected));
        }
        let frame = image.frame;
        let path = photos.join(&frame.name);
        let mask = [format!("{}.png", frame.name), frame.name.clone()].map(|name| masks.join(name));
        let mask = mask.into_iter().find(|p| p.is_file());
        posed.push(Posed { frame, image: Stored { path, factor, mask } });
    }
    let mut decisions = vec![format!("model: {}, {} images", model.display(), posed.len())];
    let names: Vec<&str> = posed.iter().map(|p| p.frame.name.as_str()).collect();
    let (times, rule) = times(folder, &names)?;
    decisions.push(rule);
    posed.iter_mut().zip(times).for_each(|(p, t)| p.frame.time = t);
    let points = colmap::points(model)?.filter(|p| !p.is_empty()).map(|list| Points {
        position: list.iter().map(|p| p.position.as_vec3().to_array()).collect(),
        colour: list.iter().map(|p| p.colour).collect(),
    });
    if let Some(points) = &points {
        decisions.push(format!("points: {} of the model", points.position.len()));
    }
    let rule = match options.split {
        SplitRule::Auto | SplitRule::Lists => SplitRule::Hold(LLFF_HOLD),
        rule => rule,
    };
    decisions.push(format!("{}, by name", rule.describe()));
    let (train, test) = rule.divide(posed);
    Ok(Source { kind: DatasetKind::Colmap, train, test, val: Vec::new(), points, default_downscale: 1, decisions })
}

// ------------------------------------------------------------------------------------------------ times

/// Times of images that are in the order of their names, and the rule that was found.
pub(super) fn times(folder: &Path, names: &[&str]) -> Result<(Vec<f64>, String)> {
    for (name, read) in [("times.json", json_list as ReadTimes), ("times.txt", text_list)] {
        let path = folder.join(name);
        if path.is_file() {
            return Ok((read(&path)?.of_all(&path, names)?, format!("time rule: {name}")));
        }
    }
    let numbers: Option<Vec<f64>> = names.iter().map(|name| last_number(name)).collect();
    let least = |n: &[f64]| n.iter().copied().fold(f64::INFINITY, f64::min);
    let largest = |n: &[f64]| n.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    match numbers {
        Some(numbers) if largest(&numbers) > least(&numbers) => {
            let (first, last) = (least(&numbers), largest(&numbers));
            let times = numbers.iter().map(|n| (n - first) / (last - first)).collect();
            Ok((times, format!("time rule: the last number in each name, {first} to {last}, scaled to [0, 1]")))
        }
        _ => {
            let times = (0..names.len()).map(|i| uniform_time(i, names.len())).collect();
            Ok((times, "time rule: uniform in the order of the names".into()))
        }
    }
}

type ReadTimes = fn(&Path) -> Result<Times>;

enum Times {
    ByName(HashMap<String, f64>),
    InOrder(Vec<f64>),
}

impl Times {
    fn of_all(&self, path: &Path, names: &[&str]) -> Result<Vec<f64>> {
        match self {
            Self::InOrder(times) if times.len() == names.len() => Ok(times.clone()),
            Self::InOrder(times) => {
                let expected = format!("one for each of {} images", names.len());
                Err(Error::corrupt(path, "number of times", times.len().to_string(), expected))
            }
            Self::ByName(_) => {
                let missing =
                    |name| Error::corrupt(path, format!("image `{name}`"), "no time", "a time for each image");
                names.iter().map(|name| self.of(name).ok_or_else(|| missing(*name))).collect()
            }
        }
    }

    /// By name, with or without the extension.
    fn of(&self, name: &str) -> Option<f64> {
        let Self::ByName(times) = self else { return None };
        let stem = || name.rsplit_once('.').map(|(stem, _)| stem);
        times.get(name).or_else(|| times.get(stem()?)).copied()
    }
}

fn json_list(path: &Path) -> Result<Times> {
    let time = |at: String, value: &Value| {
        json::finite(value).ok_or_else(|| Error::corrupt(path, at, json::show(value), "a finite number"))
    };
    match json::value(path, "times: a list, or names with times")? {
        Value::Array(list) => {
            let times = list.iter().enumerate().map(|(i, v)| time(format!("entry {i}"), v));
            Ok(Times::InOrder(times.collect::<Result<_>>()?))
        }
        Value::Object(map) => {
            let times = map.iter().map(|(name, v)| Ok((name.clone(), time(format!("key `{name}`"), v)?)));
            Ok(Times::ByName(times.collect::<Result<_>>()?))
        }
        other => Err(Error::corrupt(path, "content", json::show(&other), "a list, or names with times")),
    }
}

fn text_list(path: &Path) -> Result<Times> {
    let bytes = json::text(path)?;
    let text = String::from_utf8_lossy(&bytes);
    let (mut by_name, mut in_order) = (HashMap::new(), Vec::new());
    for (i, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty() && !l.trim().starts_with('#')) {
        let wrong = || Error::corrupt(path, format!("line {}", i + 1), format!("`{line}`"), "`NAME TIME` or `TIME`");
        let (name, word) = line.trim().rsplit_once(char::is_whitespace).unwrap_or(("", line.trim()));
        let time = word.parse().ok().filter(|t: &f64| t.is_finite()).ok_or_else(wrong)?;
        if name.is_empty() {
            in_order.push(time);
        } else {
            by_name.insert(name.trim().to_owned(), time);
        }
    }
    match (by_name.is_empty(), in_order.is_empty()) {
        (false, true) => Ok(Times::ByName(by_name)),
        (true, false) => Ok(Times::InOrder(in_order)),
        (true, true) => Err(Error::corrupt(path, "content", "no time", "`NAME TIME` or `TIME` on each line")),
        (false, false) => Err(Error::corrupt(path, "content", "lines with and without names", "one of the two")),
    }
}

/// The last run of digits in the file's stem.
fn last_number(name: &str) -> Option<f64> {
    let stem = Path::new(name).file_stem()?.to_str()?;
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let begin = stem[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |i| i + stem[i..].chars().next().map_or(1, char::len_utf8));
    // More digits than a double holds are no frame number.
    stem[begin..end].parse().ok().filter(|n| *n < 1.0e15)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names() {
        for (name, number) in [
            ("00012.png", Some(12.0)),
            ("cam01/frame_0003.jpg", Some(3.0)),
            ("é7x.png", Some(7.0)),
            ("a.png", None),
            ("v2", Some(2.0)),
            ("99999999999999999999999.png", None),
        ] {
            assert_eq!(last_number(name), number, "{name}");
        }
    }
}
