//! Round trips of pictures, limits, damage.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use super::*;
use crate::file::tests::Values;

fn picture(width: u32, height: u32, depth: bool) -> Image {
    let mut v = Values(3);
    let pixels = (width * height) as usize;
    let mut rgba: Vec<f32> = (0..4 * pixels).map(|_| v.next()).collect();
    rgba[0] = -0.0;
    rgba[1] = f32::INFINITY;
    rgba[2] = 1.0e-40;
    Image { width, height, rgba, depth: if depth { (0..pixels).map(|_| v.next()).collect() } else { Vec::new() } }
}

#[test]
fn exr_is_lossless() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    for (width, height, depth) in [(1, 1, true), (37, 21, true), (400, 33, false), (1, 100, true)] {
        let mut image = picture(width, height, depth);
        image.rgba[3] = f32::NAN;
        write_exr(&path, &image).unwrap();
        let back = read(&path).unwrap();
        let bits = |i: &Image| i.rgba.iter().chain(&i.depth).map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&back), bits(&image));
        assert_eq!((back.width, back.height, back.depth.len()), (width, height, image.depth.len()));
        let first = std::fs::read(&path).unwrap();
        write_exr(&path, &image).unwrap();
        assert!(first == std::fs::read(&path).unwrap(), "EXR bytes differ between two runs");
        let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(&first), true).unwrap();
        let names: Vec<String> = meta.headers[0].channels.list.iter().map(|c| c.name.to_string()).collect();
        assert_eq!(names, ["A", "B", "G", "R", "Z"][..4 + usize::from(depth)]);
        assert!(meta.headers[0].channels.list.iter().all(|c| c.sample_type == exr::meta::attribute::SampleType::F32));
    }
}

#[test]
fn levels_are_rounded_to_the_nearest() {
    let by_library = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let all = (0..=0x3F80_0000).step_by(9973).map(f32::from_bits);
    let halves = (0..255).flat_map(|k| {
        let middle = (k as f32 + 0.5) / 255.0;
        [middle.next_down(), middle, middle.next_up()]
    });
    for v in all.chain(halves).chain([-1.0, 2.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY]) {
        assert_eq!(to_u8(v), by_library(v), "{v:e}");
    }
}

#[test]
fn png_clamps_and_rounds() {
    for (value, expected) in [
        (0.0, 0),
        (-1.0, 0),
        (f32::NAN, 0),
        (0.5 / 255.0 - 1.0e-6, 0),
        (0.5 / 255.0 + 1.0e-6, 1),
        (254.49 / 255.0, 254),
        (254.51 / 255.0, 255),
        (1.0, 255),
        (f32::INFINITY, 255),
    ] {
        assert_eq!(to_u8(value), expected, "{value}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let image = picture(31, 17, false);
    write_png(&path, &image, Alpha::Drop).unwrap();
    let back = read(&path).unwrap();
    assert_eq!((back.width, back.height), (31, 17));
    for (out, value) in back.rgba.chunks(4).zip(image.rgba.chunks(4)) {
        assert!((0..3).all(|c| out[c] == f32::from(to_u8(value[c])) / 255.0) && out[3] == 1.0);
    }
}

#[test]
fn png_alpha_is_straight() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let rgba = vec![0.25, 0.125, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0];
    write_png(&path, &Image { width: 2, height: 1, rgba, depth: Vec::new() }, Alpha::Straight).unwrap();
    let back: Vec<u8> = read(&path).unwrap().rgba.iter().map(|v| to_u8(*v)).collect();
    assert_eq!(back, [128, 64, 0, 128, 0, 0, 0, 0]);
}

#[test]
fn jpeg_is_read_and_others_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    image::RgbImage::from_pixel(16, 8, image::Rgb([200, 100, 50])).save(&path).unwrap();
    let back = read(&path).unwrap();
    assert!((back.rgba[0] - 200.0 / 255.0).abs() < 0.02 && back.rgba.len() == 16 * 8 * 4);
    std::fs::write(&path, b"GIF89a").unwrap();
    assert!(matches!(read(&path), Err(Error::Corrupt { .. })));
    assert!(matches!(read(&folder.path().join("none")), Err(Error::Io { .. })));
    let empty = Image::default();
    assert!(matches!(write_png(&path, &empty, Alpha::Drop), Err(Error::Usage { .. })));
    let wrong = Image { rgba: vec![0.0; 5], width: 1, height: 1, depth: Vec::new() };
    assert!(matches!(write_exr(&path, &wrong), Err(Error::Usage { .. })));
}

/// A PNG that says it is `side` pixels wide and high.
fn bomb(side: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    image::ImageEncoder::write_image(encoder, &[0; 4], 1, 1, image::ExtendedColorType::Rgba8).unwrap();
    bytes[16..20].copy_from_slice(&side.to_be_bytes());
    bytes[20..24].copy_from_slice(&side.to_be_bytes());
    let crc = crc32(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&crc.to_be_bytes());
    bytes
}

/// CRC-32 of ISO 3309, as PNG chunks carry.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
    })
}

#[test]
fn bombs_are_limits_and_damage_is_corrupt() {
    let path = Path::new("x.png");
    assert!(matches!(parse(&bomb(16_385), path), Err(Error::Limit { need: 16_385, have: 16_384, .. })));
    assert!(matches!(parse(&bomb(16_000), path), Err(Error::Limit { .. })));
    assert!(matches!(parse(&bomb(2), path), Err(Error::Corrupt { .. })));

    let folder = tempfile::tempdir().unwrap();
    let (png, exr) = (folder.path().join("a.png"), folder.path().join("a.exr"));
    write_png(&png, &picture(9, 5, false), Alpha::Drop).unwrap();
    write_exr(&exr, &picture(9, 5, true)).unwrap();
    for (file, least) in [(&png, 12), (&exr, 0)] {
        let bytes = std::fs::read(file).unwrap();
        // PNG: the last chunk (12 bytes) holds nothing.
        (0..bytes.len() - least).for_each(|cut| assert!(parse(&bytes[..cut], file).is_err(), "cut at {cut}"));
    }
}

#[test]
fn damaged_exr_never_panics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_exr(&path, &picture(9, 5, true)).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let mut random = Values(5);
    let mut damaged = bytes.clone();
    for _ in 0..3000 {
        let byte = random.bits() as usize % bytes.len();
        damaged[byte] = random.bits() as u8;
        let _ = parse(&damaged, &path);
        damaged[byte] = bytes[byte];
    }
}
