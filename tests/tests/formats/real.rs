//! Every splat file among the real data, against `expected.json`: counts, means and rows by an independent decoder (numpy)
//! of the formats as their authors document them.

use engine::file::{self, Format};
use engine::scene::Gaussians;
use serde_json::Value;
use tests_harness::data;

/// Positions, of the extent; colours and opacity; what has more bits than that.
const POSITION: f64 = 1.0e-4;
const COLOR: f64 = 1.0 / 255.0;
const FINE: f64 = 2.0e-5;

const FILES: [(&str, Format); 7] = [
    ("guitar_91k.compressed.ply", Format::CompressedPly),
    ("seal_102k.splat", Format::Splat),
    ("playbot_sog/0_0", Format::Sog),
    ("playbot_sog/2_0", Format::Sog),
    ("playbot_sog/4_0", Format::Sog),
    ("inria_sh3_9k.ply", Format::Ply),
    ("fruit_drops_sh3_5k.ply", Format::Ply),
];

fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn close(name: &str, found: &[f64], expected: &Value, tolerance: f64) {
    let expected = numbers(expected);
    assert_eq!(found.len(), expected.len(), "{name}");
    for (f, e) in found.iter().zip(&expected) {
        assert!((f - e).abs() <= tolerance * (1.0 + e.abs()), "{name}: {found:?}, expected {expected:?}");
    }
}

fn sigmoid(v: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(v)).exp())
}

fn unit(q: [f32; 4]) -> [f64; 4] {
    let q = q.map(f64::from);
    let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    q.map(|c| c / length.max(1e-30))
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

fn mean<const W: usize>(rows: impl Iterator<Item = [f64; W]>) -> Vec<f64> {
    let mut sum = [0.0; W];
    let mut n = 0.0;
    for row in rows {
        (0..W).for_each(|c| sum[c] += row[c]);
        n += 1.0;
    }
    sum.iter().map(|s| s / n).collect()
}

fn check(name: &str, g: &Gaussians, expected: &Value) {
    let extent = expected["extent"].as_f64().unwrap();
    let k3 = g.sh_coefficients() * 3;
    for row in expected["rows"].as_array().unwrap() {
        let i = row["i"].as_u64().unwrap() as usize;
        let at = |what: &str| format!("{name}, Gaussian {i}, {what}");
        for (f, e) in g.mean[i].iter().zip(numbers(&row["position"])) {
            assert!((f64::from(*f) - e).abs() <= POSITION * extent * 0.1, "{}: {f} {e}", at("position"));
        }
        close(&at("opacity"), &[sigmoid(g.opacity_logit[i])], &row["opacity"], COLOR * 0.01);
        close(&at("log scale"), &wide(&g.log_scale[i]), &row["log_scale"], FINE);
        close(&at("rotation"), &unit(g.rotation[i]), &row["rotation"], FINE);
        close(&at("SH"), &wide(&g.sh[i * k3..(i + 1) * k3]), &row["sh"], FINE);
    }
    let expected = &expected["mean"];
    let n = g.len() as f64;
    close(
        &format!("{name}, mean position"),
        &mean(g.mean.iter().map(|m| m.map(f64::from))),
        &expected["position"],
        FINE,
    );
    close(
        &format!("{name}, mean scale"),
        &mean(g.log_scale.iter().map(|m| m.map(f64::from))),
        &expected["log_scale"],
        FINE,
    );
    let rotations = g.rotation.iter().map(|&q| unit(q).map(f64::abs));
    close(&format!("{name}, mean rotation"), &mean(rotations), &expected["rotation"], FINE);
    let opacity = g.opacity_logit.iter().map(|&o| sigmoid(o)).sum::<f64>() / n;
    close(&format!("{name}, mean opacity"), &[opacity], &expected["opacity"], FINE);
    let sh = |f: fn(f64) -> f64| g.sh.iter().map(|&v| f(v.into())).sum::<f64>() / g.sh.len() as f64;
    close(&format!("{name}, mean SH"), &[sh(|v| v)], &expected["sh"], FINE);
    close(&format!("{name}, mean |SH|"), &[sh(f64::abs)], &expected["sh_abs"], FINE);
}

#[test]
fn every_real_file_matches_the_independent_decoder() {
    let expected: Value = serde_json::from_str(include_str!("expected.json")).unwrap();
    for (name, format) in FILES {
        let Some(path) = data(&format!("splats/{name}")) else { return };
        assert_eq!(Format::of_file(&path).unwrap(), format, "{name}");
        let raw = match format {
            Format::Splat => file::splat::parse(&std::fs::read(&path).unwrap(), &path).unwrap(),
            Format::Sog => file::sog::read_folder(&path).unwrap(),
            _ => file::ply::read(&path).unwrap(),
        };
        let expected = &expected[name];
        assert_eq!(raw.len() as u64, expected["count"].as_u64().unwrap(), "{name}");
        assert_eq!(u64::from(raw.sh_degree), expected["sh_degree"].as_u64().unwrap(), "{name}");
        check(name, &raw, expected);
        let loaded = file::load(&path).unwrap();
        assert_eq!(loaded.scene.gaussians.len() + loaded.rejected.total(), raw.len(), "{name}");
        let described = file::describe(&path).unwrap();
        assert_eq!((described.format, described.gaussians), (format, raw.len()), "{name}");
        println!("{name}: {} Gaussians, {:?}", raw.len(), loaded.rejected);
    }
}

#[test]
fn a_sog_is_found_by_its_description_and_zipped() {
    let Some(folder) = data("splats/playbot_sog/4_0") else { return };
    let by_meta = file::load(&folder.join("meta.json")).unwrap().scene;
    assert_eq!(by_meta, file::load(&folder).unwrap().scene);
    let place = tempfile::tempdir().unwrap();
    // Zipped with a folder inside, compressed, and with a name that says nothing.
    let path = place.path().join("scene.bin");
    let mut zip = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    for entry in std::fs::read_dir(&folder).unwrap() {
        let entry = entry.unwrap();
        let name = format!("inner/{}", entry.file_name().to_string_lossy());
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut zip, &std::fs::read(entry.path()).unwrap()).unwrap();
    }
    zip.finish().unwrap();
    assert_eq!(Format::of_file(&path).unwrap(), Format::Sog);
    assert_eq!(file::load(&path).unwrap().scene, by_meta);
}

#[test]
fn the_finest_level_that_is_there_is_read() {
    let Some(root) = data("splats/playbot_sog") else { return };
    assert_eq!(Format::of_file(&root).unwrap(), Format::StreamedSog);
    let finest = file::load(&root.join("0_0")).unwrap().scene;
    for path in [root.clone(), root.join("lod-meta.json")] {
        let loaded = file::load(&path).unwrap();
        assert!(loaded.scene == finest, "{}", path.display());
        let text = &loaded.warnings[0];
        assert!(
            text.contains("level of detail 0 is read (500000 Gaussians), the finest; others: 2 (2_0), 4 (4_0)"),
            "{text}"
        );
        for level in [1, 3, 5, 6] {
            assert!(text.contains(&format!("level {level} lacks {level}_0/meta.json")), "{text}");
        }
    }
    for (level, folder) in [(2, "2_0"), (4, "4_0")] {
        assert!(file::load_level(&root, level).unwrap().scene == file::load(&root.join(folder)).unwrap().scene);
    }
    let message = |path: &std::path::Path, level: u32| file::load_level(path, level).unwrap_err().to_string();
    assert!(message(&root, 1).contains("1, which lacks 1_0/meta.json"));
    assert!(message(&root, 7).contains("expected 0, 1, 2, 3, 4, 5, 6"));
    assert!(message(&root.join("4_0"), 0).contains("found SOG, expected streamed SOG"));

    let described = file::describe(&root).unwrap();
    let counts: Vec<u64> = described.levels.iter().map(|l| l.gaussians).collect();
    assert_eq!(counts, [500_000, 250_000, 125_000, 31_000, 8406, 3000, 1873]);
    let text = described.to_string();
    assert!(text.contains("500000 Gaussians in 0_0; this one is read"), "{text}");
    assert!(text.contains("250000 Gaussians in 1_0; 1_0/meta.json is missing"), "{text}");

    // Only the fifth level, as a folder and in a zip with a folder inside.
    let place = tempfile::tempdir().unwrap();
    let zipped = place.path().join("scene.zip");
    let mut zip = zip::ZipWriter::new(std::fs::File::create(&zipped).unwrap());
    std::fs::create_dir(place.path().join("4_0")).unwrap();
    let names =
        std::fs::read_dir(root.join("4_0")).unwrap().map(|e| format!("4_0/{}", e.unwrap().file_name().display()));
    for name in names.chain(["lod-meta.json".to_owned()]) {
        std::fs::copy(root.join(&name), place.path().join(&name)).unwrap();
        zip.start_file(format!("inner/{name}"), zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut zip, &std::fs::read(root.join(&name)).unwrap()).unwrap();
    }
    zip.finish().unwrap();
    let expected = file::load(&root.join("4_0")).unwrap().scene;
    for path in [place.path(), &zipped] {
        assert_eq!(Format::of_file(path).unwrap(), Format::StreamedSog);
        let loaded = file::load(path).unwrap();
        assert!(loaded.scene == expected, "{}", path.display());
        let text = &loaded.warnings[0];
        assert!(
            text.contains("level of detail 4 is read (8406 Gaussians), the finest whose files are all there"),
            "{text}"
        );
        assert!(text.contains("level 0 lacks 0_0/meta.json"), "{text}");
    }
}
