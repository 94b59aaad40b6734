//! `cameras.bin`, `images.bin` and `points3D.bin`: little-endian, packed.

use std::path::Path;

use super::{MODELS, Observation, RawCamera, RawImage, RawPoint};
use crate::error::{Error, Result};

/// A position in a file whose reads are all checked.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
    path: &'a Path,
}

impl<'a> Cursor<'a> {
    fn corrupt(&self, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::corrupt(self.path, format!("byte {}", self.at), found, expected)
    }

    fn take<const N: usize>(&mut self, what: &str) -> Result<[u8; N]> {
        match self.bytes[self.at..].first_chunk::<N>() {
            Some(chunk) => {
                self.at += N;
                Ok(*chunk)
            }
            None => {
                let found = format!("{} bytes to the end of the file", self.bytes.len() - self.at);
                Err(self.corrupt(found, format!("{N} bytes for the {what}")))
            }
        }
    }

    fn u32(&mut self, what: &str) -> Result<u32> {
        Ok(u32::from_le_bytes(self.take(what)?))
    }

    fn u64(&mut self, what: &str) -> Result<u64> {
        Ok(u64::from_le_bytes(self.take(what)?))
    }

    fn f64s<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.take(what)?);
        }
        Ok(values)
    }

    /// A count of things of at least `least` bytes each, checked against what is left of the file.
    fn count(&mut self, least: u64, what: &str) -> Result<usize> {
        let begin = self.at;
        let count = self.u64(what)?;
        let left = self.bytes.len() - self.at;
        if u128::from(count) * u128::from(least) > left as u128 {
            let found = format!("{count} {what} in {left} bytes");
            let expected = format!("at most {}, of at least {least} bytes each", left as u64 / least);
            return Err(Error::corrupt(self.path, format!("byte {begin}"), found, expected));
        }
        Ok(count as usize)
    }

    fn name(&mut self) -> Result<String> {
        let rest: &'a [u8] = &self.bytes[self.at..];
        let Some(end) = rest.iter().position(|&b| b == 0) else {
            return Err(self.corrupt("no end of the name", "a name that ends with a zero byte"));
        };
        self.at += end + 1;
        Ok(String::from_utf8_lossy(&rest[..end]).into_owned())
    }

    fn end(&self) -> Result<()> {
        match self.bytes.len() - self.at {
            0 => Ok(()),
            left => Err(self.corrupt(format!("{left} more bytes"), "the end of the file")),
        }
    }
}

/// u64 count; per camera i32 id, i32 model, u64 width, u64 height, f64 parameters.
pub(super) fn cameras(bytes: &[u8], path: &Path) -> Result<Vec<RawCamera>> {
    let mut cursor = Cursor { bytes, at: 0, path };
    let count = cursor.count(24 + 3 * 8, "cameras")?;
    let mut cameras = Vec::with_capacity(count);
    for _ in 0..count {
        let at = format!("byte {}", cursor.at);
        let id = cursor.u32("camera id")?;
        let begin = cursor.at;
        let model = cursor.u32("camera model")? as usize;
        let Some(&(_, parameter_count, _)) = MODELS.get(model) else {
            let expected = format!("a model id from 0 to {}", MODELS.len() - 1);
            return Err(Error::corrupt(path, format!("byte {begin}"), format!("camera model {model}"), expected));
        };
        let size = [cursor.u64("image width")?, cursor.u64("image height")?];
        let parameters =
            (0..parameter_count).map(|_| Ok(cursor.f64s::<1>("camera parameters")?[0])).collect::<Result<_>>()?;
        cameras.push(RawCamera { id, model, size, parameters, at });
    }
    cursor.end()?;
    Ok(cameras)
}

/// u64 count; per image i32 id, f64 quaternion wxyz, f64 translation, i32 camera, name ending in 0, u64 count of 2-D points
/// of (f64 x, f64 y, i64 point).
pub(super) fn images(bytes: &[u8], path: &Path) -> Result<Vec<RawImage>> {
    let mut cursor = Cursor { bytes, at: 0, path };
    let count = cursor.count(4 + 56 + 4 + 1 + 8, "images")?;
    let mut images = Vec::with_capacity(count);
    for _ in 0..count {
        let at = format!("byte {}", cursor.at);
        cursor.u32("image id")?;
        let rotation = cursor.f64s("rotation")?;
        let translation = cursor.f64s("translation")?;
        let camera = cursor.u32("camera id")?;
        let name = cursor.name()?;
        let count = cursor.count(24, "2-D points")?;
        let mut observations = Vec::new();
        for _ in 0..count {
            let pixel = cursor.f64s("2-D point")?;
            // −1 for a pixel that belongs to no point.
            if let Ok(point) = u64::try_from(i64::from_le_bytes(cursor.take("point id")?)) {
                observations.push(Observation { pixel, point });
            }
        }
        images.push(RawImage { rotation, translation, camera, name, observations, at });
    }
    cursor.end()?;
    Ok(images)
}

/// u64 count; per point u64 id, f64 position, u8 colour, f64 error, u64 length of the track, of (i32 image, i32 index).
pub(super) fn points(bytes: &[u8], path: &Path) -> Result<Vec<RawPoint>> {
    let mut cursor = Cursor { bytes, at: 0, path };
    let count = cursor.count(8 + 24 + 3 + 8 + 8, "points")?;
    let mut points = Vec::with_capacity(count);
    for _ in 0..count {
        let at = format!("byte {}", cursor.at);
        let id = cursor.u64("point id")?;
        let position = cursor.f64s("position")?;
        let colour = cursor.take("colour")?;
        cursor.f64s::<1>("error")?;
        let track = cursor.count(8, "images of a point")?;
        // Checked by `count`: the track lies within the file.
        cursor.at += track * 8;
        points.push(RawPoint { id, position, colour, at });
    }
    cursor.end()?;
    Ok(points)
}
