//! Steps in flight: what is trained does not depend on how many there are, and the device does not wait for the host.

use engine::error::Error;
use engine::scene::synthetic::{moving_scene, random_blend};
use engine::train::KeyOptions;
use engine::train::trainer::{FLIGHT, StepReport, Trainer};
use glam::DVec3;

use crate::common::{PosedOptions, bytes, config, config_file, gpu, load, log, outcome, posed, train, trainer};

/// Submits steps until `iteration`; their reports, in order.
fn fly(trainer: &mut Trainer, iteration: u64) -> Vec<StepReport> {
    let mut reports = Vec::new();
    while trainer.iteration() < iteration {
        trainer.advance().unwrap();
        reports.extend(std::iter::from_fn(|| trainer.take_finished()).map(|done| done.report));
    }
    trainer.drain().unwrap();
    reports.extend(std::iter::from_fn(|| trainer.take_finished()).map(|done| done.report));
    reports
}

#[test]
fn the_number_of_steps_in_flight_changes_no_bit() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    // Warm-up, superpoints, density control, an opacity reset; photos that stay, and photos that take turns.
    let runs = [("", 1), ("", 2), ("", 3), ("[budget]\nphoto_bytes = 0", 3), ("[budget]\nphoto_bytes = 10000", 8)];
    let outcomes = runs.map(|(over, flight)| {
        let mut trainer = trainer(&gpu, &config(over), &data).unwrap().with_flight(flight).unwrap();
        assert_eq!(trainer.flight(), flight);
        let reports = fly(&mut trainer, 40);
        assert_eq!(reports.iter().map(|r| r.iteration).collect::<Vec<_>>(), (1..=40).collect::<Vec<_>>());
        let mut checkpoint = trainer.checkpoint().unwrap();
        checkpoint.config = config("");
        (reports, bytes(&checkpoint))
    });
    for (i, outcome) in outcomes.iter().enumerate().skip(1) {
        assert!(*outcome == outcomes[0], "{:?}: other bits than one step at a time", runs[i]);
    }
}

#[test]
fn a_step_without_room_changes_nothing_and_neither_do_those_behind_it() {
    overflows_change_nothing("");
}

#[test]
fn nor_do_they_with_soft_superpoints() {
    overflows_change_nothing("[motion]\nblend = 3");
}

#[test]
fn nor_do_they_with_exposures() {
    overflows_change_nothing("[learning_rate]\nexposure = 0.02");
}

fn overflows_change_nothing(over: &str) {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config(&format!("[density]\nenabled = false\n[log]\nfinite_interval = 0\n{over}"));
    // Overflows: after which iteration there is room for how many tile instances.
    let run = |flight: usize, overflows: &[(u64, u64)]| {
        let mut trainer = trainer(&gpu, &config, &data).unwrap().with_flight(flight).unwrap();
        let mut reports = Vec::new();
        for &(after, room) in overflows {
            reports.extend(fly(&mut trainer, after));
            trainer.inject_capacity(room).unwrap();
        }
        reports.extend(fly(&mut trainer, 40));
        (reports, bytes(&trainer.checkpoint().unwrap()), trainer.repeated())
    };
    let (reports, state, repeated) = run(1, &[]);
    assert_eq!(repeated, 0);
    // Steps that need more than the two behind them, which would be applied if the failure were not theirs too: one in warm-up,
    // two with motion. At 20 motion begins, before which all steps finish.
    let peak = |from: usize| {
        let needs = |i: usize| reports[i].instances;
        let at = (from..37).find(|&i| needs(i) > needs(i + 1).max(needs(i + 2))).unwrap();
        (at as u64, needs(at) - 1)
    };
    let peaks = [peak(2), peak(20), peak(28)];
    assert!(peaks[0].0 < 17 && peaks[1].0 + 3 < peaks[2].0, "{peaks:?}");
    let all = [(7, 1), (19, 1), (30, 1)];
    for (flight, overflows, expected) in [(1, peaks, 3), (3, peaks, 9), (3, all, 9)] {
        let (with, after, repeated) = run(flight, &overflows);
        assert_eq!(repeated, expected, "{flight} in flight, {overflows:?}");
        assert!(with == reports && after == state, "{flight} in flight, {overflows:?}: an overflow leaves other bits");
    }
}

#[test]
fn a_number_that_goes_bad_is_of_its_own_step() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config("[schedule]\nwarm_up = 100\n[density]\nenabled = false\n[log]\nfinite_interval = 0");
    let mut good = trainer(&gpu, &config, &data).unwrap();
    fly(&mut good, 6);
    let mut checkpoint = good.checkpoint().unwrap();
    checkpoint.parameters.moment_2[4] = f32::NAN;
    let mut bad = Trainer::resume(&gpu, &data, &checkpoint).unwrap();
    let error = (0..FLIGHT).find_map(|_| bad.advance().err()).or_else(|| bad.drain().err());
    match error {
        Some(Error::NonFinite { what, .. }) => assert!(what.contains("at iteration 7"), "{what}"),
        other => panic!("{other:?}"),
    }
    assert_eq!(bad.iteration(), 6, "the last good one");
}

#[test]
fn a_checkpoint_between_steps_in_flight_is_exact() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config("");
    let mut whole = trainer(&gpu, &config, &data).unwrap();
    whole.advance().unwrap();
    assert!(matches!(whole.checkpoint(), Err(Error::Usage { .. })), "a state with a step in flight is none");
    assert!(matches!(whole.scene(), Err(Error::Usage { .. })));
    fly(&mut whole, 23);
    let half = whole.checkpoint().unwrap();
    fly(&mut whole, 40);
    let mut resumed = Trainer::resume(&gpu, &data, &half).unwrap();
    fly(&mut resumed, 40);
    assert!(bytes(&resumed.checkpoint().unwrap()) == bytes(&whole.checkpoint().unwrap()), "resumed at 23: other bits");
}

#[test]
fn small_photos_and_a_window_of_times_change_no_bit_either() {
    let posed = posed(&PosedOptions { sizes: vec![[64, 56]], train: 24, ..PosedOptions::default() });
    let (_, data) = load(&posed);
    let gpu = gpu();
    let over = "[schedule]\ncoarse_to_fine = 30\ntime_window = 36";
    let mut begun = Vec::new();
    let runs = [
        (1, "", None),
        (3, "", None),
        (8, "\n[budget]\nphoto_bytes = 0", None),
        (3, "", Some(23)),
        (3, "", Some(33)),
        // The window is open by then.
        (3, "", Some(37)),
    ];
    let outcomes = runs.map(|(flight, photos, pause)| {
        let config = config(&format!("{over}{photos}"));
        let mut trainer = trainer(&gpu, &config, &data).unwrap().with_flight(flight).unwrap();
        let mut reports = fly(&mut trainer, pause.unwrap_or(40));
        if pause.is_some() {
            let half = trainer.checkpoint().unwrap();
            trainer = Trainer::resume(&gpu, &data, &half).unwrap().with_flight(flight).unwrap();
            reports.extend(fly(&mut trainer, 40));
        }
        let mut checkpoint = trainer.checkpoint().unwrap();
        checkpoint.config = self::config("");
        begun = reports[..31].iter().map(|r| r.view).collect();
        (reports, bytes(&checkpoint))
    });
    for (run, outcome) in runs.iter().zip(&outcomes).skip(1) {
        assert!(*outcome == outcomes[0], "{run:?}: other bits than one step at a time");
    }
    begun.sort_unstable();
    begun.dedup();
    assert!(begun.len() <= 8 && begun.last() <= Some(&23), "a window of eight photos: {begun:?}");
}

#[test]
fn the_device_never_waits_for_a_step() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    // One of its own: others wait for what they submit.
    let gpu = tests_harness::gpu();
    for photos in [1 << 30, 0] {
        let over =
            "[schedule]\nwarm_up = 2\nsh_degree_interval = 0\n[density]\nenabled = false\n[log]\nfinite_interval = 0";
        let mut trainer = trainer(&gpu, &config(&format!("{over}\n[budget]\nphoto_bytes = {photos}")), &data).unwrap();
        fly(&mut trainer, 10);
        let before = gpu.newest_waits();
        for _ in 0..25 {
            trainer.advance().unwrap();
        }
        assert_eq!(gpu.newest_waits(), before, "{photos} bytes of photos: the host waited for the newest submission");
        trainer.drain().unwrap();
        assert!(gpu.newest_waits() > before, "the end is waited for");
    }
}

#[test]
fn a_checkpoint_that_cannot_be_written_ends_the_run() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    std::fs::create_dir(&out).unwrap();
    // A file where the folder should be.
    std::fs::write(out.join("checkpoints"), "").unwrap();
    let config = config_file(folder.path(), "");
    let (code, text) = outcome(train(&posed, &out, &["--config", config.to_str().unwrap()]));
    assert!(code == 3 && text.contains("run/checkpoints"), "{code}: {text}");
    assert!(!out.join("model.safetensors").exists());
    // It was told at the next checkpoint, no later.
    let steps = log(&out).iter().filter(|line| line["loss"].is_number()).count();
    assert!(steps <= 5, "{steps} steps were logged");
}

#[test]
fn key_poses_learn_the_same_whatever_is_in_flight() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config("[density]\nenabled = false\n[log]\nfinite_interval = 0");
    for soft in [false, true] {
        let mut scene = moving_scene(300, 6, 4, 3, false);
        if soft {
            let blend = random_blend(300, 6, 3, 2);
            let superpoints = scene.deformation.superpoint_deformation_mut().unwrap();
            superpoints.superpoints.of_gaussian = blend.of_gaussian();
            superpoints.blend = Some(blend);
        }
        let keys = KeyOptions {
            center: vec![DVec3::ZERO; 6],
            reach: vec![0.5; 6],
            unit: vec![0.02; 6],
            rate_px: [0.5, 0.05],
            hold: 0.05,
            smooth: 0.05,
            iterations: 30,
        };
        let run = |flight: usize, room: Option<u64>| {
            let table = Trainer::table(&gpu, &config, &data, &scene, keys.clone()).unwrap();
            let mut trainer = table.with_flight(flight).unwrap();
            assert_eq!(trainer.flight(), flight);
            let mut reports = fly(&mut trainer, 10);
            room.into_iter().for_each(|room| trainer.inject_capacity(room).unwrap());
            reports.extend(fly(&mut trainer, 30));
            (reports, trainer.scene().unwrap(), trainer.repeated())
        };
        let (reports, learnt, repeated) = run(1, None);
        assert!(repeated == 0 && learnt.deformation.table() != scene.deformation.table());
        for (flight, room) in [(3, None), (3, Some(64))] {
            let (other, found, repeated) = run(flight, room);
            assert!(reports == other && learnt == found, "soft {soft}, {flight} in flight, room {room:?}: other bits");
            assert_eq!(repeated > 0, room.is_some());
        }
    }
}
