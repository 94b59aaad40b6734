//! Lossless WebP pictures.

use std::io::Cursor;
use std::path::Path;

use image_webp::{ColorType, WebPDecoder, WebPEncoder};

use crate::error::{Error, Result};
use crate::file::archive::Files;

/// Largest file of a picture, bytes: 4096² pixels that do not compress are 64 MiB.
const MAX_FILE: u64 = 512 << 20;

/// A picture in memory, alpha 255 where it has none.
pub(super) struct Picture {
    pub(super) width: usize,
    channels: usize,
    pixels: Vec<u8>,
}

impl Picture {
    /// Number of pixels.
    pub(super) fn len(&self) -> usize {
        self.pixels.len() / self.channels
    }

    /// Red, green, blue, alpha of pixel `i`.
    #[inline]
    pub(super) fn pixel(&self, i: usize) -> [u8; 4] {
        match &self.pixels[i * self.channels..(i + 1) * self.channels] {
            [r, g, b, a] => [*r, *g, *b, *a],
            [r, g, b] => [*r, *g, *b, 255],
            _ => [0; 4],
        }
    }
}

/// Reads a picture of at most `most` pixels.
pub(super) fn read(files: &mut Files<'_>, name: &str, most: u64, path: &Path) -> Result<Picture> {
    let bytes = files.read(name, MAX_FILE)?;
    let corrupt = |e: image_webp::DecodingError| Error::corrupt(path, name, e.to_string(), "a WebP image");
    let mut decoder = WebPDecoder::new(Cursor::new(bytes.as_slice())).map_err(corrupt)?;
    let (width, height) = decoder.dimensions();
    let channels = if decoder.has_alpha() { 4 } else { 3 };
    let size = u64::from(width) * u64::from(height);
    if size > most {
        let what = format!("{}: pixels of {name}", path.display());
        return Err(Error::Limit { what, need: size.into(), have: most.into() });
    }
    let mut pixels = vec![0; size as usize * channels];
    decoder.read_image(&mut pixels).map_err(corrupt)?;
    Ok(Picture { width: width as usize, channels, pixels })
}

/// A lossless picture of `[height, width]` pixels, missing ones 0.
pub(super) fn encode(path: &Path, mut pixels: Vec<u8>, [width, height]: [usize; 2]) -> Result<Vec<u8>> {
    pixels.resize(width * height * 4, 0);
    let mut encoded = Vec::new();
    WebPEncoder::new(&mut encoded)
        .encode(&pixels, width as u32, height as u32, ColorType::Rgba8)
        .map_err(|e| Error::io(path, "encode WebP", std::io::Error::other(e)))?;
    Ok(encoded)
}
