//! Pictures: PNG and EXR written, PNG, JPEG and EXR read.

use std::io::Cursor;
use std::path::Path;

use exr::prelude as e;

use crate::error::{Error, Result};
use crate::file::durable::write_atomic;
use crate::image::Image;

/// Largest picture side that is read, pixels.
pub const MAX_SIDE: u32 = 16_384;
/// Most memory that decoding a picture may take, bytes.
pub const MAX_BYTES: u64 = 512 << 20;

/// What a PNG holds beside colour.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Alpha {
    /// R, G, B as rendered over the background.
    #[default]
    Drop,
    /// R, G, B, A with straight alpha, as the PNG standard asks: meant for images rendered over black, whose colour is
    /// divided by A.
    Straight,
}

/// Clamps to [0, 1] and rounds to the nearest of 256 levels; NaN becomes 0.
#[inline]
pub fn to_u8(value: f32) -> u8 {
    // `round` of the library, without its call: the difference of a number and its whole part is exact.
    let level = value.clamp(0.0, 1.0) * 255.0;
    let whole = level as u8;
    whole + u8::from(level - f32::from(whole) >= 0.5)
}

/// Writes an 8-bit PNG, durably. Values are taken as stored (no gamma).
///
/// # Errors
/// [`Error::Usage`] when the image has no pixel or the wrong number of values; [`Error::Io`].
pub fn write_png(path: &Path, image: &Image, alpha: Alpha) -> Result<()> {
    let encoded = encode_png(path, image, alpha)?;
    write_atomic(path, |out| out.write_all(&encoded))
}

/// [`write_png`] into memory; `path` only names the picture in errors.
///
/// # Errors
/// As [`write_png`].
pub fn encode_png(path: &Path, image: &Image, alpha: Alpha) -> Result<Vec<u8>> {
    check(path, image)?;
    let (bytes, color): (Vec<u8>, _) = match alpha {
        Alpha::Drop => {
            let rgb = image.rgba.chunks_exact(4).flat_map(|p| [to_u8(p[0]), to_u8(p[1]), to_u8(p[2])]);
            (rgb.collect(), image::ExtendedColorType::Rgb8)
        }
        Alpha::Straight => {
            let straight = |p: &[f32]| {
                let scale = if p[3] > 0.0 { 1.0 / p[3] } else { 0.0 };
                [to_u8(p[0] * scale), to_u8(p[1] * scale), to_u8(p[2] * scale), to_u8(p[3])]
            };
            (image.rgba.chunks_exact(4).flat_map(straight).collect(), image::ExtendedColorType::Rgba8)
        }
    };
    let mut encoded = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut encoded);
    image::ImageEncoder::write_image(encoder, &bytes, image.width, image.height, color)
        .map_err(|e| Error::io(path, "encode PNG", std::io::Error::other(e)))?;
    Ok(encoded)
}

/// Writes a 32-bit float EXR, durably: channels A, B, G, R and, where the image has depth, Z (Σ z·α·T). Scan lines,
/// run-length encoded: lossless, and read by every EXR program. (ZIP makes float renderings some 5 % smaller and takes
/// about 15 times as long, longer than rendering them.)
///
/// # Errors
/// As [`write_png`].
pub fn write_exr(path: &Path, image: &Image) -> Result<()> {
    check(path, image)?;
    let plane = |c: usize| e::FlatSamples::F32(image.rgba.chunks_exact(4).map(|p| p[c]).collect());
    let mut channels = e::SmallVec::new();
    for (name, c) in [("A", 3), ("B", 2), ("G", 1), ("R", 0)] {
        channels.push(e::AnyChannel::new(name, plane(c)));
    }
    if !image.depth.is_empty() {
        channels.push(e::AnyChannel::new("Z", e::FlatSamples::F32(image.depth.clone())));
    }
    let encoding = e::Encoding {
        compression: e::Compression::RLE,
        blocks: e::Blocks::ScanLines,
        line_order: e::LineOrder::Increasing,
    };
    let size = (image.width as usize, image.height as usize);
    let layer = e::Layer::new(size, e::LayerAttributes::default(), encoding, e::AnyChannels::sort(channels));
    let mut encoded = Cursor::new(Vec::new());
    e::WritableImage::write(&e::Image::from_layer(layer))
        .to_buffered(&mut encoded)
        .map_err(|e| Error::io(path, "encode EXR", std::io::Error::other(e.to_string())))?;
    write_atomic(path, |out| out.write_all(encoded.get_ref()))
}

fn check(path: &Path, image: &Image) -> Result<()> {
    let pixels = image.width as usize * image.height as usize;
    let depth_fits = image.depth.is_empty() || image.depth.len() == pixels;
    if pixels > 0 && image.rgba.len() == 4 * pixels && depth_fits {
        return Ok(());
    }
    let found = format!("{} colour and {} depth values", image.rgba.len(), image.depth.len());
    let expected = format!("4 and 0 or 1 for each of {} x {} pixels, at least one pixel", image.width, image.height);
    Err(Error::usage(format!("writing {}", path.display()), found, expected))
}

/// Reads a PNG, JPEG or EXR, told apart by content, to float: 8- and 16-bit values divided by their maximum, EXR values
/// as stored. `rgba` is as in the file (PNG: straight alpha; no alpha: 1); `depth` is EXR's Z, if any.
///
/// # Errors
/// [`Error::Corrupt`]; [`Error::Limit`] above [`MAX_SIDE`] or [`MAX_BYTES`]; [`Error::Io`].
pub fn read(path: &Path) -> Result<Image> {
    let length = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?.len();
    limit(path, "bytes of an image", length, MAX_BYTES)?;
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    parse(&bytes, path)
}

/// [`read`] from memory; `path` only names the source in errors.
///
/// # Errors
/// As [`read`].
pub fn parse(bytes: &[u8], path: &Path) -> Result<Image> {
    const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];
    if bytes.starts_with(&EXR_MAGIC) { parse_exr(bytes, path) } else { parse_integer(bytes, path) }
}

fn limit(path: &Path, what: &str, need: u64, have: u64) -> Result<()> {
    if need <= have {
        return Ok(());
    }
    let what = format!("{} ({what})", path.display());
    Err(Error::Limit { what, need: need.into(), have: have.into() })
}

fn size_limit(path: &Path, width: usize, height: usize, bytes_per_pixel: u64) -> Result<()> {
    limit(path, "image side, pixels", width.max(height) as u64, MAX_SIDE.into())?;
    limit(path, "bytes of pixels", width as u64 * height as u64 * bytes_per_pixel, MAX_BYTES)
}

fn parse_integer(bytes: &[u8], path: &Path) -> Result<Image> {
    let corrupt =
        |e: image::ImageError| Error::corrupt(path, "content", e.to_string(), "a valid PNG, JPEG or EXR image");
    let reader =
        || image::ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| Error::io(path, "read", e));
    let (width, height) = reader()?.into_dimensions().map_err(corrupt)?;
    size_limit(path, width as usize, height as usize, 16)?;
    let mut limited = reader()?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_BYTES);
    limited.limits(limits);
    let rgba = limited.decode().map_err(corrupt)?.into_rgba32f();
    Ok(Image { width, height, rgba: rgba.into_raw(), depth: Vec::new() })
}

fn parse_exr(bytes: &[u8], path: &Path) -> Result<Image> {
    let corrupt = |found: String| Error::corrupt(path, "content", found, "a valid EXR image");
    let failed = |e: exr::error::Error| corrupt(e.to_string());
    let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(failed)?;
    for header in &meta.headers {
        if header.deep {
            return Err(corrupt("deep samples".into()));
        }
        let size = header.layer_size;
        size_limit(path, size.width(), size.height(), 4 * header.channels.list.len().max(4) as u64)?;
    }
    let image = {
        use e::{ReadChannels, ReadLayers};
        e::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_buffered(Cursor::new(bytes))
            .map_err(failed)?
    };
    let layer = image.layer_data;
    let (width, height) = (layer.size.width(), layer.size.height());
    let pixels = width * height;
    let plane = |name: &str| -> Result<Option<Vec<f32>>> {
        let Some(channel) = layer.channel_data.list.iter().find(|c| c.name.eq(name)) else { return Ok(None) };
        let samples: Vec<f32> = channel.sample_data.values_as_f32().collect();
        if samples.len() == pixels {
            return Ok(Some(samples));
        }
        Err(corrupt(format!("{} samples in channel {name}, {pixels} pixels", samples.len())))
    };
    let (r, g, b) = match (plane("R")?, plane("G")?, plane("B")?) {
        (Some(r), Some(g), Some(b)) => (r, g, b),
        _ => {
            let names: Vec<String> = layer.channel_data.list.iter().map(|c| c.name.to_string()).collect();
            return Err(Error::corrupt(path, "channels", names.join(", "), "R, G and B (and perhaps A and Z)"));
        }
    };
    let a = plane("A")?.unwrap_or_else(|| vec![1.0; pixels]);
    let rgba = (0..pixels).flat_map(|i| [r[i], g[i], b[i], a[i]]).collect();
    Ok(Image { width: width as u32, height: height as u32, rgba, depth: plane("Z")?.unwrap_or_default() })
}

#[cfg(test)]
mod tests;
