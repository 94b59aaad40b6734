//! `spgs-dev measurements`: the manual's table of recorded measurements, made from `tests/measurements/*.json`, and the
//! commands that record them.

use std::path::{Path, PathBuf};

use engine::error::{Error, Result};
use engine::file::durable::write_atomic;
use serde_json::Value;

/// The page of the manual with the table.
const PAGE: &str = "tools/docs/measured.md";
/// Where the table stands in it.
const BEGIN: &str = "<!-- measurements: made by `spgs-dev measurements`, do not edit -->\n";
const END: &str = "<!-- end of measurements -->\n";

/// What is recorded: the file's name without `DEVICE_` in front and `.json` behind, and the arguments of `spgs`.
/// `$SPGS_DATA` is the folder of real data.
const RECORDINGS: [(&str, &str); 11] = [
    (
        "bench_s50k",
        "bench frame $SPGS_DATA/bench_s50k/model.ply --cameras $SPGS_DATA/bench_s50k --split train --frames 100 --check",
    ),
    ("synthetic_120k", "bench frame --synthetic 120000 --superpoints 300 --width 800 --height 800 --check"),
    ("train_bench_s50k", "bench train $SPGS_DATA/bench_s50k/model.ply --cameras $SPGS_DATA/bench_s50k"),
    ("hard_cases", "bench hard-cases"),
    ("paper", "bench paper --synthetic 120000 --superpoints 300"),
    (
        "paper_dnerf_hook_path",
        "bench paper --synthetic 120000 --superpoints 300 --cameras $SPGS_DATA/dnerf_hook_cameras/transforms_test.json --width 800 --height 800 --budget 0",
    ),
    (
        "until_psnr_robot_dance",
        "bench train --until-psnr 20 --cameras $SPGS_DATA/robot_dance --iterations 2000 --downscale 8",
    ),
    (
        "ablation_robot_dance",
        "bench ablation $SPGS_DATA/robot_dance --iterations 60 --downscale 8 --only superpoints,neighbors,property-loss,network-size,warm-up,inference",
    ),
    ("sweep_100k", "bench sweep --synthetic 100000 --superpoints 300"),
    ("train_sweep", "bench train --sweep"),
    ("sort", "bench sort"),
];

/// The commands that record everything on a device whose files begin with `device`.
pub fn commands(device: &str) -> Vec<String> {
    let command = |(name, arguments): &(&str, &str)| {
        format!("target/release/spgs {arguments} --quiet --json tests/measurements/{device}_{name}.json")
    };
    let mut all: Vec<String> = RECORDINGS.iter().map(command).collect();
    all.push("cargo run -q --bin spgs-dev -- measurements".into());
    all
}

/// Writes the table into the manual of a source tree; true when it changed.
///
/// # Errors
/// Those of [`updated`]; a file that cannot be written.
pub fn write(root: &Path) -> Result<bool> {
    let path = root.join(PAGE);
    let (old, new) = updated(root)?;
    if old != new {
        write_atomic(&path, |out| out.write_all(new.as_bytes()))?;
    }
    Ok(old != new)
}

/// The page as it is and as it should be.
///
/// # Errors
/// `Corrupt` for a measurement that cannot be read or a page without the two markers; `Io`.
pub fn updated(root: &Path) -> Result<(String, String)> {
    let path = root.join(PAGE);
    let old = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    let missing = || Error::corrupt(&path, "markers", "not both", format!("`{}` and `{}`", BEGIN.trim(), END.trim()));
    let start = old.find(BEGIN).ok_or_else(missing)? + BEGIN.len();
    let end = start + old[start..].find(END).ok_or_else(missing)?;
    let new = format!("{}{}{}", &old[..start], table(root)?, &old[end..]);
    Ok((old, new))
}

/// The recordings of a source tree, by file name.
///
/// # Errors
/// `Corrupt` naming the file; `Io`.
pub fn recordings(root: &Path) -> Result<Vec<(String, Value)>> {
    let folder = root.join("tests/measurements");
    let entries = std::fs::read_dir(&folder).map_err(|e| Error::io(&folder, "list", e))?;
    let mut files: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "json"));
    files.sort();
    let read = |file: PathBuf| {
        let text = std::fs::read_to_string(&file).map_err(|e| Error::io(&file, "read", e))?;
        let value: Value = serde_json::from_str(&text)
            .map_err(|e| Error::corrupt(&file, format!("line {}", e.line()), e.to_string(), "JSON"))?;
        for key in ["/device/name", "/device/driver", "/program/commit", "/command"] {
            if value.pointer(key).and_then(Value::as_str).is_none() {
                return Err(Error::corrupt(&file, key, "nothing", "what makes numbers comparable"));
            }
        }
        Ok((file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(), value))
    };
    files.into_iter().map(read).collect()
}

fn table(root: &Path) -> Result<String> {
    let mut text = String::from("| recorded | result | device | commit |\n|---|---|---|---|\n");
    for (file, record) in recordings(root)? {
        let of = |pointer: &str| record.pointer(pointer).and_then(Value::as_str).unwrap_or_default();
        let commit = of("/program/commit");
        let device = format!("{}, {}", of("/device/name"), of("/device/driver"));
        let short = &commit[..commit.len().min(9)];
        text +=
            &format!("| {} `{file}` | {} | {} | {short} |\n", what(&record), result(&record), device.replace('|', "/"));
    }
    Ok(text)
}

/// A number of a record; 0 where it is missing.
fn number(record: &Value, pointer: &str) -> f64 {
    record.pointer(pointer).and_then(Value::as_f64).unwrap_or(0.0)
}

/// `1,234`.
fn grouped(value: f64) -> String {
    let digits = format!("{value:.0}");
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(c);
    }
    out
}

/// What was measured, in a few words.
fn what(record: &Value) -> String {
    let n = |pointer: &str| number(record, pointer);
    let scene = || format!("{} Gaussians", grouped(n("/scene/gaussians")));
    let kind = record.get("kind").and_then(Value::as_str);
    match kind {
        Some("hard_cases") => "Hard cases".into(),
        Some("paper") => format!("Frame rate, {}, {}×{}", scene(), n("/path/width"), n("/path/height")),
        Some("until_psnr") => format!("Training to {} dB", n("/wanted_psnr")),
        Some("ablation") => format!("Ablations, {} iterations", grouped(n("/iterations"))),
        Some("sort") => "Sorts of 32-bit keys with values".into(),
        Some(other) => format!("{}{}", other[..1].to_uppercase(), other[1..].replace('_', " ")),
        None if record.get("measurement").is_some() => {
            format!("Frame, {}, {}×{}", scene(), n("/view/width"), n("/view/height"))
        }
        None if record.get("training").is_some() => {
            format!("Training step, {}, {}×{}", scene(), n("/photos/width"), n("/photos/height"))
        }
        None if record.get("settings").is_some() => format!("Speed against error, {}", scene()),
        None => "Training steps".into(),
    }
}

/// The result, in a few words.
fn result(record: &Value) -> String {
    let n = |pointer: &str| number(record, pointer);
    match record.get("kind").and_then(Value::as_str) {
        Some("hard_cases") => {
            let count = record.get("cases").and_then(Value::as_array).map_or(0, Vec::len);
            format!("{} of {count} hold, {:.0} s", n("/passed"), n("/ms") / 1e3)
        }
        Some("paper") => paper(record),
        Some("until_psnr") => match record.pointer("/run/seconds_to_psnr").and_then(Value::as_f64) {
            Some(s) => format!("after {s:.0} s; {:.1} iterations/s", n("/run/iterations_per_second")),
            None => format!("not reached; {:.1} iterations/s", n("/run/iterations_per_second")),
        },
        Some("ablation") => ablation(record),
        Some("sort") => sorts(record),
        Some(_) => "see the file".into(),
        None if record.get("measurement").is_some() => {
            let error = match record.pointer("/error_against_f64/psnr").and_then(Value::as_f64) {
                Some(psnr) => format!("; {psnr:.0} dB against f64"),
                None => String::new(),
            };
            let m = |key: &str| n(&format!("/measurement/{key}"));
            let [median, p5, p95] = ["median", "p5", "p95"].map(|key| m(&format!("frame_ms/{key}")));
            format!("{median:.2} ms median ({p5:.2} p5, {p95:.2} p95){}{error}", beside(record))
        }
        None if record.get("training").is_some() => {
            format!("{:.2} ms median, {:.2} p95", n("/training/step_ms/median"), n("/training/step_ms/p95"))
        }
        None if record.get("settings").is_some() => presets(record),
        None => sweep(record),
    }
}

/// Rates of frames in flight and side by side, where both were measured.
fn beside(record: &Value) -> String {
    let all = record.pointer("/measurement/fps_side_by_side").and_then(Value::as_array).into_iter().flatten();
    let one = |b: &Value| Some(format!("{} with {} side by side", grouped(b.get("fps")?.as_f64()?), b.get("frames")?));
    let rates: Vec<String> = all.filter_map(one).collect();
    if rates.is_empty() {
        return String::new();
    }
    format!("; {} FPS in flight, {}", grouped(number(record, "/measurement/fps_pipelined")), rates.join(", "))
}

/// Time and error of each preset.
fn presets(record: &Value) -> String {
    let all = record.get("settings").and_then(Value::as_array).into_iter().flatten();
    let one = |s: &Value| {
        let name = s.get("name")?.as_str()?;
        let psnr = number(s, "/error/psnr");
        // What settings are compared by: processor time where the device is a CPU.
        let (ms, unit) = match s.get("processor_ms").and_then(Value::as_f64) {
            Some(ms) => (ms, "ms of processor"),
            None => (number(s, "/frame_ms/median"), "ms"),
        };
        ["exact", "high", "fast"].contains(&name).then(|| format!("{name} {ms:.2} {unit}, {psnr:.1} dB"))
    };
    all.filter_map(one).collect::<Vec<_>>().join("; ")
}

fn paper(record: &Value) -> String {
    let n = |pointer: &str| number(record, pointer);
    let mut text = format!(
        "{:.2} FPS by the paper's protocol, {:.2} over the path, {:.2} for its slowest 1 %; bound {:.1}",
        n("/rates/paper_fps"),
        n("/rates/path_fps"),
        n("/rates/low_1_percent_fps"),
        n("/roofline/bound_fps")
    );
    let curves = record.get("scaling").and_then(Value::as_array).into_iter().flatten();
    let exponents: Vec<String> = curves
        .filter_map(|c| Some(format!("{} {:.2}", c.get("name")?.as_str()?, c.get("tail_exponent")?.as_f64()?)))
        .collect();
    if !exponents.is_empty() {
        text += &format!("; cost grows with the power: {}", exponents.join(", "));
    }
    text
}

/// Rate of each sort.
fn sorts(record: &Value) -> String {
    let all = record.get("sorts").and_then(Value::as_array).into_iter().flatten();
    let one = |s: &Value| {
        let share = 100.0 * number(s, "/of_copy_bandwidth");
        format!(
            "{} keys: {:.1} million/s, {share:.0} % of copy",
            grouped(number(s, "/keys")),
            number(s, "/keys_per_s") / 1e6
        )
    };
    all.map(one).collect::<Vec<_>>().join("; ")
}

/// First and last PSNR of each ablation.
fn ablation(record: &Value) -> String {
    let each = record.get("ablations").and_then(Value::as_array).into_iter().flatten().filter_map(|a| {
        let rows = a.get("rows")?.as_array()?;
        let psnr = |row: &Value| row.pointer("/score/psnr").and_then(Value::as_f64);
        let name = |row: &Value| row.get("setting").and_then(Value::as_str).map(str::to_owned);
        let (first, last) = (rows.first()?, rows.last()?);
        Some(format!("{} {:.2} dB, {} {:.2} dB", name(first)?, psnr(first)?, name(last)?, psnr(last)?))
    });
    each.collect::<Vec<_>>().join("; ")
}

/// Smallest and largest training set of a sweep.
fn sweep(record: &Value) -> String {
    let cases: Vec<&Value> = record.get("sweep").and_then(Value::as_array).into_iter().flatten().collect();
    let one = |case: &&Value| {
        format!(
            "{} Gaussians at {}²: {:.0} ms",
            grouped(number(case, "/scene/gaussians")),
            number(case, "/photos/width"),
            number(case, "/training/step_ms/median")
        )
    };
    cases.first().into_iter().chain(cases.last()).map(one).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use serde_json::json;

    use super::*;

    fn tree(page: &str, record: &Value) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(root.path().join("tests/measurements")).unwrap();
        std::fs::create_dir_all(root.path().join("tools/docs")).unwrap();
        std::fs::write(root.path().join(PAGE), page).unwrap();
        std::fs::write(root.path().join("tests/measurements/a.json"), record.to_string()).unwrap();
        root
    }

    fn record() -> Value {
        json!({
            "kind": "hard_cases", "passed": 2, "cases": [1, 2, 3], "ms": 4600.0, "command": "spgs bench",
            "device": { "name": "x|y", "driver": "d" }, "program": { "commit": "0123456789abcdef" },
        })
    }

    #[test]
    fn the_table_replaces_what_is_between_the_markers() {
        let root = tree(&format!("before\n{BEGIN}stale\n{END}after\n"), &record());
        assert!(write(root.path()).unwrap() && !write(root.path()).unwrap());
        let text = std::fs::read_to_string(root.path().join(PAGE)).unwrap();
        assert!(text.starts_with("before\n") && text.ends_with("after\n") && !text.contains("stale"), "{text}");
        assert!(text.contains("| Hard cases `a.json` | 2 of 3 hold, 5 s | x/y, d | 012345678 |"), "{text}");
    }

    #[test]
    fn what_cannot_be_compared_is_rejected() {
        let no_markers = tree("nothing", &record());
        assert!(updated(no_markers.path()).unwrap_err().to_string().contains("markers"));
        let mut without = record();
        without["device"]["driver"] = Value::Null;
        let root = tree(&format!("{BEGIN}{END}"), &without);
        assert!(updated(root.path()).unwrap_err().to_string().contains("/device/driver"));
    }

    #[test]
    fn numbers_are_grouped() {
        assert_eq!([1.0, 999.0, 1000.0, 1_234_567.0].map(grouped), ["1", "999", "1,000", "1,234,567"]);
    }
}
