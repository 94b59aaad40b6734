//! Pictures of a data set as 8-bit pixels: decoded, undistorted, scaled down.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::{ImageReader, RgbaImage};

use super::MAX_IMAGE_SIDE;
use super::lens::Lens;
use super::resample::{self, Plane};
use crate::error::{Error, Result};
use crate::image::Image;

/// Colour premultiplied by alpha, 8 bits a channel, row-major, top row first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pixels {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// `[height, width]`: r in the low byte, then g, b, a; r, g, b ≤ a. Opaque pictures have a = 255.
    pub rgba: Vec<u32>,
}

impl Pixels {
    /// Bytes of the pixels.
    pub fn bytes(&self) -> u64 {
        4 * self.rgba.len() as u64
    }

    /// An image in 8 bits a channel; what is behind the scene is in its colours, so it is opaque.
    pub fn opaque(image: &Image) -> Self {
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let pixel = |p: &[f32; 4]| u32::from_le_bytes([byte(p[0]), byte(p[1]), byte(p[2]), 255]);
        let rgba = image.rgba.as_chunks().0.iter().map(pixel).collect();
        Self { width: image.width, height: image.height, rgba }
    }

    /// The picture over a background, A kept.
    pub fn over(&self, background: [f32; 3]) -> Image {
        let pixel = |p: &u32| {
            let [r, g, b, a] = p.to_le_bytes().map(|c| f32::from(c) / 255.0);
            let over = |c: f32, i: usize| c + (1.0 - a) * background[i];
            [over(r, 0), over(g, 1), over(b, 2), a]
        };
        let rgba = self.rgba.iter().flat_map(pixel).collect();
        Image { width: self.width, height: self.height, rgba, depth: Vec::new() }
    }

    /// Premultiplied R, G, B, A of pixel (x, y) in [0, 1].
    pub fn at(&self, x: u32, y: u32) -> Option<[f32; 4]> {
        let index = (x < self.width).then_some(y as usize * self.width as usize + x as usize)?;
        self.rgba.get(index).map(|p| p.to_le_bytes().map(|c| f32::from(c) / 255.0))
    }
}

/// A pixel that takes no part in training: a colour without opacity, which no premultiplied picture has.
pub const LEFT_OUT: u32 = 0x00ff_ffff;
/// A pixel takes part when at least this share of it does, of 255: what is left out must not shine through at its edge.
const TAKES_PART: u8 = 230;

/// The pixels of a mask that take part in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MaskColour {
    /// Black ones; white ones are left out.
    Black,
    /// White ones; black ones are left out.
    White,
}

/// A stored picture and what to do with it on decoding: undistort at the stored size, then average down to `size`.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageSource {
    /// The file.
    pub path: PathBuf,
    /// Width and height of the stored picture; another size is an error.
    pub stored: [u32; 2],
    /// Width and height of the decoded picture.
    pub size: [u32; 2],
    /// Lens of the stored picture; `None` for a pinhole.
    pub lens: Option<Lens>,
    /// Mask picture, if the data set has one: of the stored size, or larger and of the same shape.
    pub mask: Option<PathBuf>,
    /// Which pixels of the mask take part in training; `None`: all.
    pub used: Option<MaskColour>,
}

impl ImageSource {
    /// The picture, premultiplied. Undistortion samples bilinearly, pixels beyond the photo repeat its edge; scaling
    /// down averages the area of each pixel. Both work on premultiplied values, rounded once, at the end.
    ///
    /// # Errors
    /// [`Error::Corrupt`] for a file that is no picture or has another size; [`Error::Io`]. Both name the file.
    pub fn decode(&self) -> Result<Pixels> {
        let picture = read(&self.path)?;
        self.check_stored(&self.path, &picture)?;
        self.process(picture)
    }

    /// The picture with [`LEFT_OUT`] where its mask says so.
    ///
    /// # Errors
    /// As [`ImageSource::decode`], of the mask too.
    pub fn decode_for_training(&self) -> Result<Pixels> {
        let mut picture = self.decode()?;
        let Some(used) = self.used else { return Ok(picture) };
        let white = used == MaskColour::White;
        for (pixel, mask) in picture.rgba.iter_mut().zip(self.decode_mask()?.unwrap_or_default()) {
            let share = if white { mask } else { u8::MAX - mask };
            *pixel = if share < TAKES_PART { LEFT_OUT } else { *pixel };
        }
        Ok(picture)
    }

    /// The mask at the picture's size, `[height, width]`, as the file has it (what 0 and 255 mean is the data set's
    /// matter); `None` where there is none.
    ///
    /// # Errors
    /// As [`ImageSource::decode`].
    pub fn decode_mask(&self) -> Result<Option<Vec<u8>>> {
        let Some(path) = &self.mask else { return Ok(None) };
        let mut mask = read(path)?;
        // Grey of an opaque picture; where the file has colours, their mean says least wrong.
        for pixel in mask.pixels_mut() {
            let [r, g, b, _] = pixel.0.map(u16::from);
            let grey = ((r + g + b + 1) / 3) as u8;
            pixel.0 = [grey, grey, grey, u8::MAX];
        }
        let found = [mask.width(), mask.height()];
        if found != self.stored && is_larger_copy(found, self.stored) {
            // Smaller copies of photos often share the masks of the full ones.
            let smaller = Plane::premultiplied(mask.as_raw(), found).averaged(self.stored).packed();
            mask = RgbaImage::from_fn(self.stored[0], self.stored[1], |x, y| {
                image::Rgba(smaller[(y * self.stored[0] + x) as usize].to_le_bytes())
            });
        }
        self.check_stored(path, &mask)?;
        Ok(Some(self.process(mask)?.rgba.into_iter().map(|p| p as u8).collect()))
    }

    /// Bytes of the decoded picture.
    pub fn decoded_bytes(&self) -> u64 {
        4 * u64::from(self.size[0]) * u64::from(self.size[1])
    }

    /// Share of the undistorted picture that lies beyond the photo, where its edge is repeated; `None` for a pinhole.
    pub fn share_beyond_the_photo(&self) -> Option<f64> {
        let lens = self.lens.as_ref()?;
        let valid = lens.distortion.valid_radius(lens.picture_radius(self.stored));
        // A grid of 64 x 64 places is exact to a quarter of a percent.
        let [w, h] = self.stored.map(f64::from);
        let place = |i: u32, side: f64| (f64::from(i) + 0.5) / 64.0 * side;
        let outside = (0..64 * 64).filter(|i| {
            let [u, v] = resample::source_pixel(lens, valid, place(i % 64, w), place(i / 64, h));
            !((0.0..=w).contains(&u) && (0.0..=h).contains(&v))
        });
        Some(outside.count() as f64 / (64.0 * 64.0))
    }

    fn check_stored(&self, path: &Path, picture: &RgbaImage) -> Result<()> {
        let found = [picture.width(), picture.height()];
        if found != self.stored {
            let text = |[w, h]: [u32; 2]| format!("{w} x {h} pixels");
            return Err(Error::corrupt(path, "image size", text(found), text(self.stored)));
        }
        Ok(())
    }

    fn process(&self, picture: RgbaImage) -> Result<Pixels> {
        let [width, height] = self.size;
        let rgba = match &self.lens {
            None => match resample::whole_factor(self.stored, self.size) {
                Some(factor) => resample::average_blocks(picture.as_raw(), self.stored, factor),
                None => Plane::premultiplied(picture.as_raw(), self.stored).averaged(self.size).packed(),
            },
            Some(lens) => {
                let flat = Plane::premultiplied(picture.as_raw(), self.stored).undistorted(lens);
                drop(picture);
                if self.size == self.stored { flat.packed() } else { flat.averaged(self.size).packed() }
            }
        };
        Ok(Pixels { width, height, rgba })
    }
}

/// Whether a picture is larger than another and of the same shape, to a pixel.
fn is_larger_copy(found: [u32; 2], stored: [u32; 2]) -> bool {
    let factor = f64::from(found[0]) / f64::from(stored[0]);
    factor >= 1.0 && (f64::from(found[1]) / factor - f64::from(stored[1])).abs() <= 1.0
}

fn read(path: &Path) -> Result<RgbaImage> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    decode(&bytes, path)
}

/// Width and height by the header of a picture.
pub(super) fn dimensions(path: &Path) -> Result<[u32; 2]> {
    let reader = ImageReader::open(path).map_err(|e| Error::io(path, "open", e))?;
    let reader = reader.with_guessed_format().map_err(|e| Error::io(path, "read", e))?;
    let (width, height) = reader.into_dimensions().map_err(|e| not_a_picture(path, &e))?;
    check_size(path, width, height)
}

fn check_size(path: &Path, width: u32, height: u32) -> Result<[u32; 2]> {
    if [width, height].iter().all(|side| (1..=MAX_IMAGE_SIDE).contains(side)) {
        return Ok([width, height]);
    }
    let expected = format!("1 to {MAX_IMAGE_SIDE} pixels a side");
    Err(Error::corrupt(path, "image size", format!("{width} x {height} pixels"), expected))
}

fn not_a_picture(path: &Path, e: &image::ImageError) -> Error {
    Error::corrupt(path, "content", e.to_string(), "a valid PNG or JPEG image")
}

fn decode(bytes: &[u8], path: &Path) -> Result<RgbaImage> {
    let reader = || ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| Error::io(path, "read", e));
    // The header first: a hostile one must not make the decoder take memory.
    let (width, height) = reader()?.into_dimensions().map_err(|e| not_a_picture(path, &e))?;
    check_size(path, width, height)?;
    Ok(reader()?.decode().map_err(|e| not_a_picture(path, &e))?.into_rgba8())
}
