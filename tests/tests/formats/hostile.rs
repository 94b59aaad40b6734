//! Hostile bytes into every importer: cut at every byte, single bits turned over, edited inside their containers, random.
//! Nothing may panic, what is accepted must be consistent, and memory stays below 2 GiB.
//!
//! The ordinary run is short. The full one, 100,000 executions per parser, in release:
//! `SPGS_FUZZ=100000 cargo test --release -p spgs-tests --test formats hostile -- --ignored --nocapture`

use std::io::{Cursor, Read, Write};
use std::path::Path;

use engine::file::torch::Weights;
use engine::file::{self, gltf, ply, sog, splat, spz};
use engine::scene::synthetic::random_gaussians;
use engine::scene::{Gaussians, Scene};

use crate::fuzz::{Random, mutate, noise};
use crate::pickle::{self, Value, dict, floats};

/// Executions per parser in the ordinary run.
const SHORT: u64 = 300;

/// One importer.
struct Target {
    name: &'static str,
    /// A small valid file.
    seed: Vec<u8>,
    /// The contents that containers hide, changed one at a time and put back.
    edit: fn(&[u8], &mut Random) -> Vec<u8>,
    parse: fn(&[u8]),
    /// What leads random bytes past the first check.
    begin: &'static [u8],
}

fn path() -> &'static Path {
    Path::new("/nowhere/hostile")
}

fn consistent(g: &Gaussians) {
    let n = g.len();
    assert_eq!([g.log_scale.len(), g.rotation.len(), g.opacity_logit.len()], [n; 3]);
    assert_eq!(g.sh.len(), n * g.sh_coefficients() * 3);
}

fn bytes_of(name: &str) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    file::save(&path, &Scene { gaussians: random_gaussians(9, 2, 1), ..Scene::default() }).unwrap();
    std::fs::read(&path).unwrap()
}

fn weights() -> Vec<u8> {
    let inner = dict(vec![("a", floats(&[2, 3], vec![0.5; 6])), ("b", floats(&[2], vec![1.0; 2]))]);
    pickle::file(&Value::List(vec![inner, dict(vec![("c", floats(&[1], vec![2.0]))])]))
}

/// A zip with two levels of detail, the finer one in two parts.
fn levels() -> Vec<u8> {
    let part = unzipped(&bytes_of("a.sog"));
    let text = br#"{"lodLevels":2,"environment":null,"filenames":["0_0/meta.json","0_1/meta.json","1_0/meta.json"],
        "tree":{"children":[{"lods":{"0":{"file":0,"offset":0,"count":9},"1":{"file":2,"offset":0,"count":4}}},
        {"lods":{"0":{"file":1,"offset":2,"count":7},"1":{"file":2,"offset":4,"count":5}}}]}}"#;
    let mut entries = vec![("lod-meta.json".to_owned(), text.to_vec())];
    for folder in ["0_0", "0_1", "1_0"] {
        entries.extend(part.iter().map(|(name, content)| (format!("{folder}/{name}"), content.clone())));
    }
    zipped(entries)
}

fn parse_levels(bytes: &[u8]) {
    for level in [None, Some(1)] {
        if let Ok((g, _)) = sog::parse_level(bytes, path(), level) {
            consistent(&g);
        }
    }
}

fn plain(bytes: &[u8], r: &mut Random) -> Vec<u8> {
    mutate(bytes.to_vec(), r)
}

/// Unpacked, changed, packed again.
fn in_gzip(bytes: &[u8], r: &mut Random) -> Vec<u8> {
    let mut inner = Vec::new();
    flate2::read::GzDecoder::new(bytes).read_to_end(&mut inner).unwrap();
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(&mutate(inner, r)).unwrap();
    gzip.finish().unwrap()
}

/// Names and contents of a zip.
fn unzipped(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut zip = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
    let count = zip.len();
    let entry = |i: usize| {
        let mut entry = zip.by_index(i).unwrap();
        let mut content = Vec::new();
        entry.read_to_end(&mut content).unwrap();
        (entry.name().unwrap().into_owned(), content)
    };
    (0..count).map(entry).collect()
}

fn zipped(entries: Vec<(String, Vec<u8>)>) -> Vec<u8> {
    let mut out = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, content) in entries {
        out.start_file(name, stored).unwrap();
        out.write_all(&content).unwrap();
    }
    out.finish().unwrap().into_inner()
}

/// One digit of a description, which leaves it readable and its numbers at odds; or any change to an entry.
fn in_levels(bytes: &[u8], r: &mut Random) -> Vec<u8> {
    if r.below(2) == 0 {
        return in_zip(bytes, r);
    }
    let mut entries = unzipped(bytes);
    let texts: Vec<usize> = (0..entries.len()).filter(|&i| entries[i].0.ends_with(".json")).collect();
    let text = &mut entries[texts[r.below(texts.len())]].1;
    // The counts come first; there are very many other numbers.
    let digits: Vec<usize> = (0..text.len()).filter(|&i| text[i].is_ascii_digit()).take(60).collect();
    text[digits[r.below(digits.len())]] = b'0' + r.below(10) as u8;
    zipped(entries)
}

/// One entry of a zip changed, or two swapped.
fn in_zip(bytes: &[u8], r: &mut Random) -> Vec<u8> {
    let mut entries = unzipped(bytes);
    let (i, j) = (r.below(entries.len()), r.below(entries.len()));
    if r.below(8) == 0 {
        let content = entries[j].1.clone();
        entries[i].1 = content;
    } else {
        let content = std::mem::take(&mut entries[i].1);
        entries[i].1 = mutate(content, r);
    }
    zipped(entries)
}

fn parse_ply(bytes: &[u8]) {
    if let Ok(g) = ply::parse(bytes, path()) {
        consistent(&g);
    }
}

fn parse_spz(bytes: &[u8]) {
    if let Ok((g, _)) = spz::parse(bytes, path()) {
        consistent(&g);
    }
}

fn parse_gltf(bytes: &[u8]) {
    if let Ok((g, _)) = gltf::parse(bytes, path()) {
        consistent(&g);
    }
}

/// A `.spz` within a `.glb`, or within a `.gltf` in base64, under a node that does everything.
fn gltf_with_spz(binary: bool) -> Vec<u8> {
    let mut stream = bytes_of("a.spz");
    stream.resize(stream.len().next_multiple_of(3), 0);
    let uri = if binary { String::new() } else { format!(r#","uri":"data:;base64,{}""#, base64(&stream)) };
    let mut text = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[1]}},{{"mesh":0,
        "translation":[1,2,3],"rotation":[0.6,0,0,0.8],"scale":[1,2,3]}}],"meshes":[{{"primitives":[{{"attributes":{{}},
        "extensions":{{"KHR_gaussian_splatting":{{"kernel":"ellipse","extensions":{{
        "KHR_gaussian_splatting_compression_spz_2":{{"bufferView":0}}}}}}}}}}]}}],
        "bufferViews":[{{"buffer":0,"byteLength":{length}}}],"buffers":[{{"byteLength":{length}{uri}}}]}}"#,
        length = stream.len()
    )
    .into_bytes();
    if !binary {
        return text;
    }
    text.resize(text.len().next_multiple_of(4), b' ');
    stream.resize(stream.len().next_multiple_of(4), 0);
    let number = |n: usize| (n as u32).to_le_bytes();
    let total = number(28 + text.len() + stream.len());
    [b"glTF\x02\0\0\0", &total[..], &number(text.len()), b"JSON", &text, &number(stream.len()), b"BIN\0", &stream]
        .concat()
}

/// Whole groups of three bytes.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let group = |b: &[u8]| u32::from_be_bytes([0, b[0], b[1], b[2]]);
    let letters = |v: u32| [18, 12, 6, 0].map(|shift| char::from(LETTERS[(v >> shift & 63) as usize]));
    bytes.chunks_exact(3).flat_map(|b| letters(group(b))).collect()
}

/// The seed of version 3 with two extension records, packed again.
fn spz_with_extensions() -> Vec<u8> {
    let mut inner = Vec::new();
    flate2::read::GzDecoder::new(&bytes_of("a.spz")[..]).read_to_end(&mut inner).unwrap();
    inner[14] |= 2;
    for (kind, content) in [(0xadbe_0003u32, &[12, 0, 0, 0][..]), (0xadbe_0002, &[0; 12])] {
        inner.extend([&kind.to_le_bytes(), &(content.len() as u32).to_le_bytes(), content].concat());
    }
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(&inner).unwrap();
    gzip.finish().unwrap()
}

fn parse_torch(bytes: &[u8]) {
    if let Ok(weights) = Weights::parse(bytes, path()) {
        for info in weights.describe() {
            let any: Vec<Option<usize>> = vec![None; info.shape.len()];
            if let Ok((values, shape)) = weights.floats(&info.name, &any) {
                assert_eq!(values.len(), shape.iter().product::<usize>());
            }
        }
    }
}

fn targets() -> Vec<Target> {
    let spz4 = {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.spz");
        spz::write(&path, &random_gaussians(9, 2, 1), spz::Version::Four).unwrap();
        std::fs::read(&path).unwrap()
    };
    let target = |name, seed, edit, parse, begin| Target { name, seed, edit, parse, begin };
    vec![
        target("ply", bytes_of("a.ply"), plain, parse_ply, b"ply\nformat binary_little_endian 1.0\n"),
        target("compressed ply", bytes_of("a.compressed.ply"), plain, parse_ply, b"ply\nformat ascii 1.0\n"),
        target("splat", bytes_of("a.splat"), plain, |b| drop(splat::parse(b, path()).map(|g| consistent(&g))), b""),
        target("spz 3", bytes_of("a.spz"), in_gzip, parse_spz, b"\x1f\x8b\x08\0\0\0\0\0\0\xff"),
        target("spz with extensions", spz_with_extensions(), in_gzip, parse_spz, b"\x1f\x8b\x08\0\0\0\0\0\0\xff"),
        target("spz 4", spz4, plain, parse_spz, b"NGSP\x04\0\0\0"),
        target(
            "sog",
            bytes_of("a.sog"),
            in_zip,
            |b| drop(sog::parse(b, path()).map(|g| consistent(&g))),
            b"PK\x03\x04",
        ),
        target("streamed sog", levels(), in_levels, parse_levels, b"PK\x03\x04"),
        target("gltf", bytes_of("a.glb"), plain, parse_gltf, b"glTF\x02\0\0\0"),
        target("gltf with spz", gltf_with_spz(true), plain, parse_gltf, b"glTF\x02\0\0\0"),
        target("gltf as text", gltf_with_spz(false), plain, parse_gltf, b"{\"buffers\":["),
        target("torch", weights(), in_zip, parse_torch, b"PK\x03\x04"),
    ]
}

/// The largest memory that this process has had, bytes.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? << 10)
}

fn execute(target: &Target, seed: u64) {
    let mut r = Random::new(seed);
    let bytes = match seed % 8 {
        0 => noise(target.begin, &mut r),
        1..4 => mutate(target.seed.clone(), &mut r),
        _ => (target.edit)(&target.seed, &mut r),
    };
    let outcome = std::panic::catch_unwind(|| (target.parse)(&bytes));
    assert!(outcome.is_ok(), "{} with seed {seed}: a panic", target.name);
}

fn run(executions: u64) {
    for target in targets() {
        let begin = std::time::Instant::now();
        (0..executions).for_each(|seed| execute(&target, seed));
        println!("{}: {executions} executions in {:.1?}", target.name, begin.elapsed());
    }
    assert!(peak_memory().is_none_or(|bytes| bytes < 2 << 30), "{:?} bytes", peak_memory());
}

#[test]
fn edited_files_are_errors_or_consistent() {
    run(SHORT);
}

/// The number of `SPGS_FUZZ`, 100,000 without it.
#[test]
#[ignore = "takes minutes: run with --ignored, in release"]
fn hostile_in_full() {
    run(std::env::var("SPGS_FUZZ").ok().and_then(|v| v.parse().ok()).unwrap_or(100_000));
}

#[test]
fn files_cut_at_any_byte_are_errors() {
    for target in targets() {
        (target.parse)(&target.seed);
        for length in 0..target.seed.len() {
            (target.parse)(&target.seed[..length]);
        }
    }
    // What must not be taken for whole.
    let cut = |bytes: &[u8]| bytes[..bytes.len() - 1].to_vec();
    assert!(ply::parse(&cut(&bytes_of("a.compressed.ply")), path()).is_err());
    assert!(splat::parse(&cut(&bytes_of("a.splat")), path()).is_err());
    assert!(spz::parse(&cut(&bytes_of("a.spz")), path()).is_err());
    assert!(sog::parse(&cut(&bytes_of("a.sog")), path()).is_err());
    assert_eq!(sog::parse_level(&levels(), path(), None).unwrap().0.len(), 16);
    assert!(sog::parse_level(&cut(&levels()), path(), None).is_err());
    for binary in [true, false] {
        assert_eq!(gltf::parse(&gltf_with_spz(binary), path()).unwrap().0.len(), 9);
        assert!(gltf::parse(&cut(&gltf_with_spz(binary)), path()).is_err());
    }
    assert!(spz::parse(&spz_with_extensions(), path()).is_ok_and(|(_, warnings)| warnings.len() == 1));
    assert!(spz::parse(&cut(&spz_with_extensions()), path()).is_err());
    assert!(gltf::parse(&cut(&bytes_of("a.glb")), path()).is_err());
    assert!(Weights::parse(&cut(&weights()), path()).is_err());
}

/// Ten thousand single bits, spread over all files.
#[test]
fn turned_bits_are_errors_or_consistent() {
    let targets = targets();
    let mut r = Random::new(99);
    for i in 0..10_000 {
        let target = &targets[i % targets.len()];
        let mut bytes = target.seed.clone();
        let at = r.below(bytes.len());
        bytes[at] ^= 1 << r.below(8);
        (target.parse)(&bytes);
    }
}

/// Small files that claim to be large.
#[test]
fn bombs_are_refused_without_their_memory() {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    let n = 100_000_000u32;
    gzip.write_all(b"NGSP\x03\0\0\0").unwrap();
    gzip.write_all(&n.to_le_bytes()).unwrap();
    gzip.write_all(b"\x03\x0c\0\0").unwrap();
    let zeros = vec![0; 1 << 20];
    (0..64).for_each(|_| gzip.write_all(&zeros).unwrap());
    let bomb = gzip.finish().unwrap();
    assert!(matches!(spz::parse(&bomb, path()), Err(engine::Error::Limit { .. })));

    // A tensor that is larger than its array, and one that repeats it by a stride of 0.
    let tensor = |shape: &[u32], stride: &[u32]| {
        let (mut pickle, arrays) = pickle::pickled(&floats(&[2], vec![1.0; 2]));
        let numbers = |values: &[u32]| {
            let mut out = b"(".to_vec();
            values.iter().for_each(|v| out.extend([b"J".as_slice(), &v.to_le_bytes()].concat()));
            [out, b"t".to_vec()].concat()
        };
        let old = [numbers(&[2]), numbers(&[1])].concat();
        let at = pickle.windows(old.len()).position(|w| w == old).unwrap();
        pickle.splice(at..at + old.len(), [numbers(shape), numbers(stride)].concat());
        Weights::parse(&pickle::archive(&pickle, &arrays), path()).err().map(|e| e.to_string())
    };
    assert!(tensor(&[2], &[1]).is_none());
    for (shape, stride) in [([1_000_000_000].as_slice(), [0].as_slice()), (&[2], &[2]), (&[1 << 30; 4], &[1; 4])] {
        assert!(tensor(shape, stride).is_some_and(|m| m.contains("elements of array")), "{shape:?}");
    }
    // A million brackets: nothing may recurse.
    let deep = [b"\x80\x02".to_vec(), vec![b']'; 1_000_000], vec![b'a'; 999_999], vec![b'.']].concat();
    assert!(Weights::parse(&pickle::archive(&deep, &[]), path()).is_err());
    let cycle = b"\x80\x02]q\0h\0a.".to_vec();
    assert!(Weights::parse(&pickle::archive(&cycle, &[]), path()).is_err());
    assert!(peak_memory().is_none_or(|bytes| bytes < 2 << 30), "{:?} bytes", peak_memory());
}
