//! Runs that are cut off, and what they go on from.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use tests_harness::render_case::Random;

use crate::common::{Posed, PosedOptions, checkpoints, config_file, log, newest, outcome, posed, succeed, train};

/// Sends a signal to a child.
fn signal(child: &Child, name: &str) {
    let status = Command::new("kill").args([&format!("-{name}"), &child.id().to_string()]).status().unwrap();
    assert!(status.success(), "kill -{name}");
}

/// Kills a run that has written up to three further checkpoints, at a random moment after the last of them (what a step
/// takes differs too much between machines to kill after a time alone); says whether the run was done before.
fn kill_in_the_middle(mut child: Child, out: &Path, random: &mut Random) -> bool {
    let first = checkpoints(out).pop();
    let further = random.range(0.0, 4.0) as usize;
    let mut seen = Vec::new();
    while seen.len() < further && child.try_wait().unwrap().is_none() {
        let newest = checkpoints(out).pop();
        if newest != first && newest != *seen.last().unwrap_or(&None) {
            seen.push(newest);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(Duration::from_secs_f32(random.range(0.0, 0.3)));
    if child.try_wait().unwrap().is_none() {
        signal(&child, "KILL");
    }
    child.wait().unwrap().success()
}

/// Arguments of the next process of a run: a new run, or what is there goes on.
fn arguments<'a>(out: &Path, config: &'a str) -> Vec<&'a str> {
    if checkpoints(out).is_empty() { vec!["--config", config] } else { vec!["--resume"] }
}

#[test]
fn killed_twenty_times_it_ends_with_the_same_bits() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let config = config_file(
        folder.path(),
        "iterations = 40\n[schedule]\nwarm_up = 26\n[density]\ngradient_threshold = 1e-3\n[log]\ncheckpoint_interval = 2",
    );
    let config = config.to_str().unwrap();
    let (whole, cut) = (folder.path().join("whole"), folder.path().join("cut"));
    succeed(train(&posed, &whole, &["--config", config]));
    let mut random = Random(11);
    let mut progress = Vec::new();
    for _ in 0..20 {
        let mut command = train(&posed, &cut, &arguments(&cut, config));
        // Nobody would read what the layer says of a run that is killed; it has seen the whole run.
        command.env_remove("SPGS_VALIDATION");
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let finished = kill_in_the_middle(child, &cut, &mut random);
        progress.push(checkpoints(&cut).pop());
        if finished {
            // It was done before the kill: once more from the start, which must also forget the run that is there.
            let old = checkpoints(&cut);
            succeed_and_compare(&posed, &cut, &whole);
            old.iter().for_each(|p| std::fs::remove_file(p).unwrap());
        }
    }
    progress.dedup();
    assert!(progress.len() > 3, "kills hit different iterations: {progress:?}");
    if checkpoints(&cut).is_empty() {
        succeed(train(&posed, &cut, &["--config", config]));
    }
    succeed_and_compare(&posed, &cut, &whole);
}

/// Resumes to the end; checkpoints, model and log must be those of the whole run.
fn succeed_and_compare(posed: &Posed, cut: &Path, whole: &Path) {
    succeed(train(posed, cut, &["--resume"]));
    assert!(newest(cut) == newest(whole), "the resumed run ends with other bits");
    let iterations = |out: &Path| {
        let lines = log(out);
        lines.iter().filter(|l| l["loss"].is_number()).map(|l| l["iteration"].as_u64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(iterations(cut), iterations(whole), "every step is logged once");
    let names = |out: &Path| checkpoints(out).iter().map(|p| p.file_name().unwrap().to_owned()).collect::<Vec<_>>();
    assert_eq!(names(cut), names(whole));
    assert_eq!(names(cut).len(), 3, "the last three checkpoints are kept");
}

#[test]
fn a_run_killed_before_it_removed_its_oldest_checkpoint_has_three_when_resumed() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let config = config_file(folder.path(), "iterations = 12\n[schedule]\nwarm_up = 100");
    succeed(train(&posed, &out, &["--config", config.to_str().unwrap()]));
    let whole = checkpoints(&out);
    // What is there between the rename of the last checkpoint and the removal of the one before the last three.
    std::fs::copy(&whole[0], whole[0].with_file_name("checkpoint-1-000000000.safetensors")).unwrap();
    assert_eq!(checkpoints(&out).len(), 4);
    succeed(train(&posed, &out, &["--resume"]));
    assert_eq!(checkpoints(&out), whole);
}

#[test]
fn ctrl_c_saves_and_resume_goes_on() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let config = config_file(folder.path(), "[log]\ncheckpoint_interval = 0");
    let config = config.to_str().unwrap();
    let (whole, cut) = (folder.path().join("whole"), folder.path().join("cut"));
    succeed(train(&posed, &whole, &["--config", config]));
    let mut command = train(&posed, &cut, &["--config", config]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let start = Instant::now();
    while std::fs::read_to_string(cut.join("run.jsonl")).unwrap_or_default().lines().count() < 3 {
        assert!(start.elapsed() < Duration::from_secs(120), "the run does not start");
        std::thread::sleep(Duration::from_millis(2));
    }
    signal(&child, "INT");
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("interrupted; iteration") && text.contains("go on with --resume"), "{text}");
    assert!(!cut.join("model.safetensors").exists(), "the run was over before it was interrupted");
    succeed(train(&posed, &cut, &["--resume"]));
    assert!(newest(&cut) == newest(&whole), "the resumed run ends with other bits");
}

#[test]
fn damaged_checkpoints_are_passed_over_and_named() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let config = config_file(folder.path(), "iterations = 12\n[schedule]\nwarm_up = 100");
    succeed(train(&posed, &out, &["--config", config.to_str().unwrap()]));
    let all = checkpoints(&out);
    let good = newest(&out);
    assert_eq!(all.len(), 3, "{all:?}");
    // The newest has a flipped bit, the one before is cut off: the oldest is gone on from.
    let mut bytes = good.clone();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    std::fs::write(&all[2], &bytes).unwrap();
    std::fs::write(&all[1], &good[..good.len() / 3]).unwrap();
    let text = succeed(train(&posed, &out, &["--resume"]));
    for damaged in [&all[1], &all[2]] {
        let name = damaged.file_name().unwrap().to_str().unwrap();
        assert!(text.contains("warning: damaged checkpoint passed over") && text.contains(name), "{name}: {text}");
    }
    assert!(newest(&out) == good, "from the older checkpoint to the same bits");
    for path in checkpoints(&out) {
        std::fs::write(path, &good[..100]).unwrap();
    }
    let (code, text) = outcome(train(&posed, &out, &["--resume"]));
    assert_eq!(code, 3, "{text}");
    assert!(text.contains(checkpoints(&out)[2].to_str().unwrap()), "{text}");
}

#[test]
fn a_new_run_forgets_the_checkpoints_of_the_old_one() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let config = config_file(folder.path(), "iterations = 20\n[schedule]\nwarm_up = 100");
    succeed(train(&posed, &out, &["--config", config.to_str().unwrap()]));
    succeed(train(&posed, &out, &["--config", config.to_str().unwrap(), "--iterations", "7"]));
    let names: Vec<String> =
        checkpoints(&out).iter().map(|p| p.file_stem().unwrap().to_str().unwrap().into()).collect();
    assert_eq!(names, ["checkpoint-1-000000000", "checkpoint-1-000000005", "checkpoint-1-000000007"]);
}
