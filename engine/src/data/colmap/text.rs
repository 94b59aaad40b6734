//! `cameras.txt` and `images.txt`.

use std::path::Path;
use std::str::FromStr;

use super::{MODELS, Observation, RawCamera, RawImage, RawPoint};
use crate::error::{Error, Result};

fn lines<'a>(bytes: &'a [u8], path: &'a Path) -> impl Iterator<Item = (usize, Result<&'a str>)> {
    bytes.split(|&b| b == b'\n').enumerate().map(move |(i, line)| {
        let text = std::str::from_utf8(line)
            .map(str::trim)
            .map_err(|_| Error::corrupt(path, format!("line {}", i + 1), "bytes that are no text", "UTF-8 text"));
        (i + 1, text)
    })
}

/// The words of one line, each read with its meaning.
struct Words<'a> {
    words: std::str::SplitWhitespace<'a>,
    line: usize,
    path: &'a Path,
}

impl<'a> Words<'a> {
    fn new(text: &'a str, line: usize, path: &'a Path) -> Self {
        Self { words: text.split_whitespace(), line, path }
    }

    fn corrupt(&self, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::corrupt(self.path, format!("line {}", self.line), found, expected)
    }

    fn word(&mut self, what: &str) -> Result<&'a str> {
        self.words.next().ok_or_else(|| self.corrupt("the end of the line", what))
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T> {
        let word = self.word(what)?;
        word.parse().map_err(|_| self.corrupt(format!("`{word}`"), what))
    }

    fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.number(what)?;
        }
        Ok(values)
    }
}

/// `CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]`.
pub(super) fn cameras(bytes: &[u8], path: &Path) -> Result<Vec<RawCamera>> {
    let mut cameras = Vec::new();
    for (line, text) in lines(bytes, path) {
        let text = text?;
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let mut words = Words::new(text, line, path);
        let id = words.number("a camera id")?;
        let name = words.word("a camera model")?;
        let Some(model) = MODELS.iter().position(|m| m.0 == name) else {
            let known = MODELS.map(|m| m.0).join(", ");
            return Err(words.corrupt(format!("camera model `{name}`"), format!("one of {known}")));
        };
        let size = [words.number("an image width")?, words.number("an image height")?];
        let what = format!("{} parameters of {name}", MODELS[model].1);
        let parameters = (0..MODELS[model].1).map(|_| words.number(&what)).collect::<Result<Vec<f64>>>()?;
        if let Some(extra) = words.words.next() {
            return Err(words.corrupt(format!("a further `{extra}`"), what));
        }
        cameras.push(RawCamera { id, model, size, parameters, at: format!("line {line}") });
    }
    Ok(cameras)
}

/// Two lines per image: `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME` and the 2-D points `X Y POINT3D_ID`…, which may be
/// none.
pub(super) fn images(bytes: &[u8], path: &Path) -> Result<Vec<RawImage>> {
    let mut images = Vec::new();
    let mut all = lines(bytes, path);
    while let Some((line, text)) = all.next() {
        let text = text?;
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let mut words = Words::new(text, line, path);
        words.number::<u32>("an image id")?;
        let rotation = words.numbers("a quaternion w x y z")?;
        let translation = words.numbers("a translation x y z")?;
        let camera = words.number("a camera id")?;
        let name = words.words.clone().collect::<Vec<_>>().join(" ");
        if name.is_empty() {
            return Err(words.corrupt("the end of the line", "an image name"));
        }
        let observations = match all.next() {
            None => Vec::new(),
            Some((line, points)) => observations(points?, line, path)?,
        };
        images.push(RawImage { rotation, translation, camera, name, observations, at: format!("line {line}") });
    }
    Ok(images)
}

fn observations(text: &str, line: usize, path: &Path) -> Result<Vec<Observation>> {
    let count = text.split_whitespace().count();
    if !count.is_multiple_of(3) {
        let expected = "the image's 2-D points, three numbers each (the line may be empty)";
        return Err(Error::corrupt(path, format!("line {line}"), format!("{count} words"), expected));
    }
    let mut words = Words::new(text, line, path);
    let mut list = Vec::new();
    for _ in 0..count / 3 {
        let pixel = words.numbers("two numbers")?;
        // −1 for a pixel that belongs to no point.
        if let Ok(point) = u64::try_from(words.number::<i64>("a point id")?) {
            list.push(Observation { pixel, point });
        }
    }
    Ok(list)
}

/// `POINT3D_ID X Y Z R G B ERROR TRACK[]`.
pub(super) fn points(bytes: &[u8], path: &Path) -> Result<Vec<RawPoint>> {
    let mut points = Vec::new();
    for (line, text) in lines(bytes, path) {
        let text = text?;
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let mut words = Words::new(text, line, path);
        let id = words.number("a point id")?;
        let position = words.numbers("a position x y z")?;
        let mut colour = [0; 3];
        for channel in &mut colour {
            *channel = words.number("a colour from 0 to 255")?;
        }
        points.push(RawPoint { id, position, colour, at: format!("line {line}") });
    }
    Ok(points)
}
