//! Round trip; axes; nodes; buffers elsewhere; `.spz` within.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use base64::Engine as _;
use serde_json::{Value, json};

use super::*;
use crate::error::Error;
use crate::file::codec::{sigmoid, unit};
use crate::file::spz;
use crate::scene::Gaussians;
use crate::scene::synthetic::random_gaussians;

/// Reads what nothing is to be warned of.
fn read(bytes: &[u8], path: &Path) -> Gaussians {
    let (g, warnings) = parse(bytes, path).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    g
}

#[test]
fn a_written_file_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    for degree in 0..4 {
        let g = random_gaussians(50, 3, degree);
        write(&path, &g).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let back = read(&bytes, &path);
        assert_eq!((&back.mean, &back.sh, back.sh_degree), (&g.mean, &g.sh, degree), "these keep their bits");
        for i in 0..50 {
            let far = |a: f32, b: f32| (a - b).abs() > 1e-5 * b.abs().max(1.0);
            assert!(!(0..3).any(|a| far(back.log_scale[i][a], g.log_scale[i][a])));
            assert!((sigmoid(back.opacity_logit[i]) - sigmoid(g.opacity_logit[i])).abs() < 2e-6);
            let dot: f64 = unit(back.rotation[i]).iter().zip(unit(g.rotation[i])).map(|(a, b)| a * b).sum();
            assert!(dot > 1.0 - 1e-6);
        }
        // Without the node's turn the same numbers are in glTF's axes.
        let text = String::from_utf8_lossy(&bytes).into_owned();
        assert!(text.contains("\"rotation\":[1.0,0.0,0.0,0.0]"));
        let at = bytes.windows(12).position(|w| w == b"[1.0,0.0,0.0").unwrap();
        let mut plain = bytes.clone();
        plain[at..at + 17].copy_from_slice(b"[0.0,0.0,0.0,1.0]");
        let other = read(&plain, &path);
        assert_eq!(other.mean[7], [g.mean[7][0], -g.mean[7][1], -g.mean[7][2]]);
    }
}

/// Gaussians, and the description and numbers of the file with them.
fn parts(n: usize, degree: u32) -> (Gaussians, Value, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let g = random_gaussians(n, 3, degree);
    write(&path, &g).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (g, serde_json::from_slice(&bytes[20..20 + length]).unwrap(), bytes[28 + length..].to_vec())
}

fn glb(description: &Value, numbers: &[u8]) -> Vec<u8> {
    let mut text = serde_json::to_vec(description).unwrap();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut numbers = numbers.to_vec();
    numbers.resize(numbers.len().next_multiple_of(4), 0);
    let chunk =
        |kind: u32, content: &[u8]| [&(content.len() as u32).to_le_bytes(), &kind.to_le_bytes(), content].concat();
    let chunks = [chunk(JSON, &text), chunk(BIN, &numbers)].concat();
    [&MAGIC[..], &2u32.to_le_bytes(), &(12 + chunks.len() as u32).to_le_bytes(), &chunks].concat()
}

#[test]
fn buffers_may_be_in_other_files_or_within() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gltf");
    let (g, mut description, numbers) = parts(20, 1);
    let whole = read(&glb(&description, &numbers), Path::new("a.glb"));
    assert_eq!(whole.mean, g.mean);
    std::fs::create_dir(folder.path().join("in")).unwrap();
    std::fs::write(folder.path().join("in/a b.bin"), &numbers).unwrap();
    let mut with = |uri: &str| {
        description["buffers"][0]["uri"] = uri.into();
        parse(&serde_json::to_vec(&description).unwrap(), &path)
    };
    assert_eq!(with("in/a%20b.bin").unwrap().0, whole);
    let text = base64::prelude::BASE64_STANDARD.encode(&numbers);
    assert_eq!(with(&format!("data:application/octet-stream;base64,{text}")).unwrap().0, whole);
    for uri in ["../a.bin", "in/../../a.bin", "%2e%2e/a.bin", "/etc/hosts", "https://host/a.bin", "", "in/"] {
        let message = with(uri).unwrap_err().to_string();
        assert!(message.contains("buffers[0]") && message.contains("in the same folder"), "{uri}: {message}");
    }
    let message = with("none.bin").unwrap_err().to_string();
    assert!(message.contains(".gltf: at glTF buffers[0]: found URI `none.bin`"), "{message}");
    let mut message = |uri: &str| with(uri).unwrap_err().to_string();
    assert!(message("data:;base64,AAAA").contains("found 3 bytes, expected"));
    assert!(message("data:;base64,A*AA").contains("expected base64"));
    assert!(message("data:text/plain,AAAA").contains("one in base64"));
    description["buffers"][0].as_object_mut().unwrap().remove("uri");
    let message = parse(&serde_json::to_vec(&description).unwrap(), &path).unwrap_err().to_string();
    assert!(message.contains("POSITION: found buffer 0, expected one with a URI"), "{message}");
    // A view that is compressed, one beyond its buffer.
    let mut compressed = description.clone();
    compressed["bufferViews"][0]["extensions"] = json!({ "EXT_meshopt_compression": {} });
    assert!(parse(&glb(&compressed, &numbers), &path).unwrap_err().to_string().contains("EXT_meshopt_compression"));
    description["bufferViews"][0]["byteOffset"] = u64::MAX.into();
    assert!(parse(&glb(&description, &numbers), &path).unwrap_err().to_string().contains("lies in the"));
}

#[test]
fn nodes_move_turn_and_scale() {
    let (g, mut description, numbers) = parts(20, 2);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    description["nodes"] = json!([
        { "children": [1, 2], "rotation": [0.0, half, 0.0, half] },
        { "mesh": 0, "translation": [1.0, 2.0, 3.0], "scale": [2.0, 2.0, 2.0] },
        { "children": [3] },
        { "mesh": 0, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 2, 3, 1] },
        { "mesh": 0, "translation": [9.0, 9.0, 9.0] },
    ]);
    let both = read(&glb(&description, &numbers), Path::new("x"));
    assert_eq!((both.len(), both.sh_degree), (40, 2), "two of the three nodes are in the scene");
    let close = |a: f32, b: f32| (a - b).abs() < 1e-5 * b.abs().max(1.0);
    for i in 0..40 {
        // What was written are glTF's axes now: scaled, moved, turned by 90 degrees about y, and into ours.
        let [x, y, z] = g.mean[i % 20];
        let [x, y, z] = [2.0 * x + 1.0, 2.0 * y + 2.0, 2.0 * z + 3.0];
        let expected = [z, -y, x];
        assert!((0..3).all(|a| close(both.mean[i][a], expected[a])), "{:?} {expected:?}", both.mean[i]);
        assert!((0..3).all(|a| close(both.log_scale[i][a], g.log_scale[i % 20][a] + 2.0f32.ln())));
    }
    let (first, second) = both.sh.split_at(both.sh.len() / 2);
    assert!(first.iter().zip(second).all(|(a, b)| close(*a, *b)) && first[3..27] != g.sh[3..27]);

    // A node that stretches is said; so are no nodes at all.
    description["nodes"] = json!([{ "mesh": 0, "scale": [1.0, 2.0, 1.0] }]);
    let (_, warnings) = parse(&glb(&description, &numbers), Path::new("x")).unwrap();
    assert!(warnings.len() == 1 && warnings[0].contains("a node stretches"), "{warnings:?}");
    description["nodes"] = json!([{ "mesh": 0, "extensions": { "EXT_mesh_gpu_instancing": { "attributes": {} } } }]);
    let (_, warnings) = parse(&glb(&description, &numbers), Path::new("x")).unwrap();
    assert!(warnings.len() == 1 && warnings[0].contains("EXT_mesh_gpu_instancing"), "{warnings:?}");
    description["nodes"] = json!([{}]);
    let (alone, warnings) = parse(&glb(&description, &numbers), Path::new("x")).unwrap();
    assert!(
        warnings[0].contains("no node of the scene") && alone.mean[7] == [g.mean[7][0], -g.mean[7][1], -g.mean[7][2]]
    );

    let mut message = |nodes: Value| {
        description["nodes"] = nodes;
        parse(&glb(&description, &numbers), Path::new("x")).unwrap_err().to_string()
    };
    assert!(message(json!([{ "children": [0] }])).contains("a node with two parents, expected a tree"));
    assert!(message(json!([{ "children": [7] }])).contains("nodes[7]: found 1 nodes"));
    assert!(message(json!([{ "mesh": 0, "matrix": [1.0] }])).contains("matrix of 1 numbers, expected 16"));
    assert!(message(json!([{ "mesh": 0, "rotation": [0.0, 0.0, 0.0, 0.0] }])).contains("length 1"));
    let huge = json!([{ "children": [1], "scale": [1e300, 1.0, 1.0] }, { "mesh": 0, "scale": [1e300, 1.0, 1.0] }]);
    assert!(message(huge).contains("not finite"));
    // A mesh that very many nodes show: refused before it has filled the memory.
    let (_, mut many, numbers) = parts(2000, 0);
    many["nodes"] = (0..50_000).map(|_| json!({ "mesh": 0 })).collect();
    many["scenes"] = Value::Null;
    assert!(matches!(parse(&glb(&many, &numbers), Path::new("x")), Err(Error::Limit { .. })));
}

/// A `.glb` with one primitive of these extensions, and a `.spz` in view 1.
fn with_spz(stream: &[u8], extensions: &Value, count: u64) -> Vec<u8> {
    let description = json!({
        "asset": { "version": "2.0" },
        "meshes": [{ "primitives": [{ "mode": 0, "attributes": { "POSITION": 0 }, "extensions": extensions }] }],
        "nodes": [{ "mesh": 0 }],
        "accessors": [{ "componentType": FLOAT, "count": count, "type": "VEC3" }],
        "buffers": [{ "byteLength": stream.len() + 8 }],
        "bufferViews": [{ "buffer": 0, "byteLength": 8 }, { "buffer": 0, "byteOffset": 8, "byteLength": stream.len() }],
    });
    glb(&description, &[&[0; 8], stream].concat())
}

#[test]
fn an_spz_within_is_read_as_its_extension_says() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.spz");
    spz::write(&path, &random_gaussians(30, 3, 2), spz::Version::Three).unwrap();
    let stream = std::fs::read(&path).unwrap();
    let (plain, _) = spz::parse(&stream, &path).unwrap();
    let view = json!({ "bufferView": 1 });
    let within = |name: &str| json!({ EXTENSION: { "extensions": { name: view } } });
    // As stored: the same as the file alone, to the last bit.
    for extensions in [within(SPZ[0]), within(SPZ[1]), json!({ SPZ_ALONE: view })] {
        assert_eq!(read(&with_spz(&stream, &extensions, 30), Path::new("x")), plain, "{extensions}");
    }
    // With the kernel: left, up, front, half a turn about the vertical.
    let mut complete = within(SPZ[0]);
    complete[EXTENSION]["kernel"] = "ellipse".into();
    let turned = read(&with_spz(&stream, &complete, 30), Path::new("x"));
    for i in 0..30 {
        let [x, y, z] = plain.mean[i];
        assert_eq!(turned.mean[i], [-x, y, -z]);
        // SH degree 1 is -y, z, -x.
        let (a, b) = (&turned.sh[27 * i + 3..27 * i + 12], &plain.sh[27 * i + 3..27 * i + 12]);
        assert!((0..9).all(|c| (a[c] - if c < 3 { b[c] } else { -b[c] }).abs() < 1e-6), "{a:?} {b:?}");
    }
    let (_, warnings) = parse(&with_spz(&stream, &within(SPZ[0]), 31), Path::new("x")).unwrap();
    assert!(warnings[0].contains("promises 31 Gaussians, its .spz has 30"), "{warnings:?}");

    let message = |bytes: &[u8]| parse(bytes, Path::new("x")).unwrap_err().to_string();
    let damaged = message(&with_spz(&stream[..stream.len() - 9], &within(SPZ[0]), 30));
    assert!(damaged.contains("glTF bufferViews[1], gzip stream"), "{damaged}");
    let nowhere = json!({ SPZ_ALONE: { "bufferView": 7 } });
    assert!(message(&with_spz(&stream, &nowhere, 30)).contains("glTF spz: found no bufferView"));
    // Another compression: refused, unless there are the attributes, too.
    let other = message(&with_spz(&stream, &within("KHR_other_compression"), 30));
    assert!(other.contains("extension `KHR_other_compression`, expected Gaussians uncompressed or by"), "{other}");
    let (g, mut description, numbers) = parts(5, 0);
    let extension = &mut description["meshes"][0]["primitives"][0]["extensions"][EXTENSION];
    extension["extensions"] = json!({ "KHR_other": {} });
    extension["colorSpace"] = "lin_rec709_display".into();
    let (back, warnings) = parse(&glb(&description, &numbers), Path::new("x")).unwrap();
    assert_eq!(back.mean, g.mean);
    assert!(warnings[0].contains("`colorSpace` lin_rec709_display is taken for srgb_rec709_display"), "{warnings:?}");
    assert!(warnings[1].contains("extension `KHR_other` is left out"), "{warnings:?}");
}
