//! Round trips, and bytes made by hand.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::io::Write;
use std::path::Path;

use super::*;
use crate::file::codec::{SH_C0, sigmoid, unit};
use crate::reference::color_of;
use crate::scene::synthetic::random_gaussians;

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(bytes).unwrap();
    gzip.finish().unwrap()
}

/// Version 2, one Gaussian of SH degree 1, 12 fractional bits.
fn by_hand() -> Vec<u8> {
    let mut b = b"NGSP\x02\0\0\0\x01\0\0\0\x01\x0c\0\0".to_vec();
    b.extend([0x00, 0x10, 0x00, 0x00, 0xf0, 0xff, 0x80, 0x00, 0x00]); // 1, −1, 128/4096
    b.extend([204, 255, 0, 128, 160, 128, 144]); // opacity 0.8; colour; log scale 0, −2, −1
    b.extend([255, 127, 127]); // x = 1
    b.extend([128, 128, 128, 0, 64, 192, 128, 128, 128]);
    b
}

#[test]
fn bytes_made_by_hand_are_understood() {
    let (g, warnings) = parse(&gzipped(&by_hand()), Path::new("x")).unwrap();
    assert!(warnings.is_empty());
    assert_eq!(g.mean, [[1.0, 1.0, -0.03125]], "y and z change sign");
    assert!((sigmoid(g.opacity_logit[0]) - 0.8).abs() < 1e-6);
    assert_eq!(g.log_scale, [[0.0, -2.0, -1.0]]);
    assert!((g.rotation[0][1] - 1.0).abs() < 1e-3 && g.rotation[0][0].abs() < 0.1, "{:?}", g.rotation[0]);
    let expected = [0.5 / 0.15, -0.5 / 0.15, (128.0 / 255.0 - 0.5) / 0.15, 0.0, 0.0, 0.0, 1.0, 0.5, -0.5];
    assert!(g.sh.iter().zip(expected).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5), "{:?}", g.sh);
}

#[test]
fn turning_the_axes_turns_colours_with_them() {
    let g = random_gaussians(20, 4, 3);
    let mut flipped = g.clone();
    flip_axes(&mut flipped);
    for i in 0..20 {
        let d = glam::DVec3::new(0.3, -0.5, 0.7 - i as f64 * 0.1).normalize();
        let turned = glam::DVec3::new(d.x, -d.y, -d.z);
        let (a, b) =
            (color_of(&g.sh[48 * i..48 * i + 48], 3, d), color_of(&flipped.sh[48 * i..48 * i + 48], 3, turned));
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
    }
    flip_axes(&mut flipped);
    assert_eq!(flipped, g);
}

#[test]
fn both_versions_round_trip_within_their_precision() {
    let folder = tempfile::tempdir().unwrap();
    for (degree, version) in [(0, Version::Three), (3, Version::Three), (0, Version::Four), (2, Version::Four)] {
        let g = random_gaussians(700, 9, degree);
        let path = folder.path().join("a.spz");
        write(&path, &g, version).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(bytes.starts_with(&MAGIC), version == Version::Four);
        let (back, _) = parse(&bytes, &path).unwrap();
        let g = g.selected(&crate::file::codec::morton_order(&g.mean));
        let extent = g.mean.as_flattened().iter().fold(0.0f32, |m, v| m.max(v.abs()));
        assert_eq!((back.len(), back.sh_degree), (700, degree));
        let far = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(far(back.mean.as_flattened(), g.mean.as_flattened()) < 1e-6 * extent.max(1.0));
        assert!(far(back.log_scale.as_flattened(), g.log_scale.as_flattened()) < 0.0313);
        let k3 = g.sh_coefficients() * 3;
        for i in 0..700 {
            assert!((sigmoid(back.opacity_logit[i]) - sigmoid(g.opacity_logit[i])).abs() < 0.5 / 254.0);
            let dot: f64 = unit(back.rotation[i]).iter().zip(unit(g.rotation[i])).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 1.0 - 4e-6, "{dot}");
            let (a, b) = (&back.sh[k3 * i..k3 * (i + 1)], &g.sh[k3 * i..k3 * (i + 1)]);
            let limited = |v: f32, limit: f64| f64::from(v).clamp(-limit, limit) as f32;
            let color = a[..3]
                .iter()
                .zip(&b[..3])
                .all(|(a, b)| f64::from((a - limited(*b, 0.5 / 0.15)).abs()) * SH_C0 < 0.5 / 135.0);
            let rest = a[3..].iter().zip(&b[3..]).all(|(a, b)| (a - limited(*b, 127.0 / 128.0)).abs() < 0.00392);
            assert!(color && rest, "{a:?} {b:?}");
        }
    }
}

#[test]
fn wrong_sizes_and_versions_are_named() {
    let message = |bytes: &[u8]| parse(bytes, Path::new("x")).unwrap_err().to_string();
    let hand = by_hand();
    assert!(message(&gzipped(&hand[..hand.len() - 1])).contains("27 bytes after the header"));
    assert!(message(&gzipped(&[&hand[..], &[0]].concat())).contains("more than 28"));
    assert!(message(&gzipped(b"NGSP\x09\0\0\0\0\0\0\0\0\0\0\0")).contains("found 9, expected 2 to 3"));
    assert!(message(b"NGSP\x05\0\0\0").contains("found 5, expected 4 to 4"));
    // 4 billion Gaussians in 60 bytes.
    let bomb = gzipped(b"NGSP\x02\0\0\0\xff\xff\xff\xff\x03\x0c\0\0");
    assert!(matches!(parse(&bomb, Path::new("x")), Err(crate::Error::Limit { .. })));
}

/// A record of an extension.
fn record(kind: u32, content: &[u8]) -> Vec<u8> {
    [&kind.to_le_bytes(), &(content.len() as u32).to_le_bytes(), content].concat()
}

/// The file made by hand with something after its attributes, and the flag that says so.
fn with_extensions(records: &[u8]) -> Vec<u8> {
    let mut b = by_hand();
    b[14] |= HAS_EXTENSIONS;
    gzipped(&[&b[..], records].concat())
}

/// The same as version 4, where records lie before the table.
fn version_4_with(records: &[u8]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.spz");
    write(&path, &random_gaussians(5, 3, 1), Version::Four).unwrap();
    let mut b = std::fs::read(&path).unwrap();
    b[14] |= HAS_EXTENSIONS;
    let table = (HEADER_4 + records.len()) as u32;
    b[16..20].copy_from_slice(&table.to_le_bytes());
    b.splice(HEADER_4..HEADER_4, records.iter().copied());
    b
}

#[test]
fn extension_records_are_followed_or_skipped() {
    let read = |bytes: &[u8]| parse(bytes, Path::new("x"));
    let (plain, _) = read(&gzipped(&by_hand())).unwrap();
    let (plain_4, warnings) = read(&version_4_with(&[])).unwrap();
    assert!(warnings.is_empty());
    let orbit = [record(0x4e41_0001, b"anything"), record(0xadbe_0002, &[0; 12])].concat();
    for (bytes, expected) in [(with_extensions(&orbit), &plain), (version_4_with(&orbit), &plain_4)] {
        let (g, warnings) = read(&bytes).unwrap();
        assert_eq!(&g, expected);
        assert_eq!(warnings.len(), 2, "{warnings:?}");
        assert!(warnings[0].contains("0x4e410001 (8 bytes) is left out"), "{warnings:?}");
        assert!(warnings[1].contains("0xadbe0002 (12 bytes, limits of an orbiting camera)"), "{warnings:?}");
    }
    // Right, down, front are our own axes: nothing is turned.
    let axes = |code: u32| record(0xadbe_0003, &code.to_le_bytes());
    for (bytes, expected) in [(with_extensions(&axes(6)), &plain), (version_4_with(&axes(6)), &plain_4)] {
        let (mut g, warnings) = read(&bytes).unwrap();
        assert!(warnings.is_empty(), "{warnings:?}");
        assert_eq!(g.mean[0], [expected.mean[0][0], -expected.mean[0][1], -expected.mean[0][2]]);
        flip_axes(&mut g);
        assert_eq!(&g, expected);
    }
    for code in [0, 4] {
        assert_eq!(read(&with_extensions(&axes(code))).unwrap().0, plain);
    }
    // Left, front, up: y and z change places, which the general map does.
    let (g, _) = read(&with_extensions(&axes(11))).unwrap();
    let [x, down, front] = plain.mean[0];
    let far = g.mean[0].iter().zip([-x, front, -down]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(far < 1e-6, "{:?} of {:?}", g.mean, plain.mean);

    let message = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
    assert!(message(&with_extensions(&axes(17))).contains("found 17, expected 0 to 16"));
    assert!(message(&version_4_with(&record(0xadbe_0003, &[6]))).contains("found 1 bytes"));
    // Records without lengths, as the first writers had them: left out in versions 2 and 3, damage in version 4.
    let old = [&0xadbe_0002u32.to_le_bytes()[..], &[0x3f; 12]].concat();
    let (g, warnings) = read(&with_extensions(&old)).unwrap();
    assert_eq!(g, plain);
    assert!(warnings[0].contains("16 bytes, no extension records) is left out"), "{warnings:?}");
    assert!(message(&version_4_with(&old)).contains("byte 40 (extension record): found 8 bytes to the end"));
    let beyond = [&version_4_with(&[])[..16], &u32::MAX.to_le_bytes(), &[0; 12]].concat();
    assert!(message(&beyond).contains("a place in the file"));
    // Much after the attributes is a limit, and what the stream's own checksum finds is found.
    let much = with_extensions(&vec![0; (16 << 20) + 1]);
    assert!(matches!(read(&much), Err(crate::Error::Limit { .. })));
    let mut damaged = with_extensions(&orbit);
    let last = damaged.len() - 5;
    damaged[last] ^= 1;
    assert!(message(&damaged).contains("gzip stream"));
}

#[test]
fn what_is_above_sh_degree_3_is_left_out_with_a_warning() {
    let header = |version: u8, degree: u8| {
        let mut b = b"NGSP".to_vec();
        b.extend([version, 0, 0, 0, 2, 0, 0, 0, degree, 12, 0, 0]);
        b
    };
    let rest: Vec<u8> = (0..2 * (9 + 1 + 3 + 3 + 4)).map(|i| i as u8).collect();
    let sh = |k: usize| (0..2u8).flat_map(move |i| (0..3 * k as u8).map(move |c| 100 * i + c)).collect::<Vec<u8>>();
    let (g, warnings) = parse(&gzipped(&[header(3, 4), rest.clone(), sh(24)].concat()), Path::new("x")).unwrap();
    assert!(warnings.len() == 1 && warnings[0].contains("SH degree 4 is left out above 3"), "{warnings:?}");
    let (expected, none) = parse(&gzipped(&[header(3, 3), rest, sh(15)].concat()), Path::new("x")).unwrap();
    assert!(none.is_empty());
    assert_eq!(g, expected);
}
