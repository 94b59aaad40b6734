//! Whether a run begins anew with a window of times.

use crate::common::{
    PosedOptions, advance, bytes, checkpoints, config, config_file, gpu, load, log, newest, posed, succeed, train,
    trainer,
};
use engine::train::start;
use engine::train::window_trial::try_window;

/// Due after 24 of 40 iterations. Network F learns nothing.
const RESTS: &str = "[schedule]\nwarm_up = 10\nwindow_trial = 24\n[learning_rate]\ndeform = 0\ndeform_final = 0";

/// The same, given for 80 iterations.
const SCALED: &str = "[schedule]\nscale = true\nreference_iterations = 80\nwarm_up = 20\nwindow_trial = 48
[learning_rate]\ndeform = 0\ndeform_final = 0";

fn scene() -> PosedOptions {
    PosedOptions { sizes: vec![[64, 56]], train: 24, ..PosedOptions::default() }
}

#[test]
fn a_trial_that_is_stopped_leaves_the_run_as_it_was() {
    let posed = posed(&scene());
    let (_, data) = load(&posed);
    let config = config(RESTS);
    let mut run = trainer(&gpu(), &config, &data).unwrap();
    assert!(!run.tries_window());
    advance(&mut run, 24).unwrap();
    assert!(run.tries_window());
    let before = bytes(&run.checkpoint().unwrap());
    let stopped = try_window(&mut run, &data, &start::first(&config, None).0, &mut |i| i < 5).unwrap();
    assert!(stopped.is_none() && bytes(&run.checkpoint().unwrap()) == before);
}

/// Of some seeds that is the one with the window, of others the one without.
#[test]
fn the_run_goes_on_from_the_better_beginning() {
    let posed = posed(&scene());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let mut taken = [0, 0];
    for seed in 0..8 {
        // Network F as it is drawn moves things anyhow, or not at all.
        let (run, window) = if seed < 4 { (RESTS, 16) } else { (SCALED, 32) };
        let config = config(&format!("seed = {seed}\n{run}\n[motion]\nzero_heads = {}", seed % 2 == 0));
        let mut run = trainer(&gpu, &config, &data).unwrap();
        advance(&mut run, 24).unwrap();
        let without = bytes(&run.checkpoint().unwrap());
        let found =
            try_window(&mut run, &data, &start::first(&config, None).0, &mut |_| true).unwrap().expect("a trial");
        assert!(found.iterations == 24 && found.psnr.iter().all(|p| (5.0..60.0).contains(p)), "{found:?}");
        let mut windowed = config.clone();
        windowed.schedule.time_window = window;
        let mut other = trainer(&gpu, &windowed, &data).unwrap();
        advance(&mut other, 24).unwrap();
        let with = bytes(&other.checkpoint().unwrap());
        assert!(with != without, "a window makes no difference");
        let better = found.psnr[1] > found.psnr[0];
        assert!(bytes(&run.checkpoint().unwrap()) == if better { with } else { without }, "{found:?}: other bits");
        assert_eq!(found.taken, better, "{found:?}");
        taken[usize::from(better)] += 1;
        advance(&mut run, 25).unwrap();
        assert!(!run.tries_window());
    }
    assert!(taken.iter().all(|n| *n > 0), "without and with a window: {taken:?}");
}

/// Photos kept aside tell nothing about a run that has them; after the trial it has.
#[test]
fn photos_kept_aside_take_part_after_the_trial() {
    let posed = posed(&scene());
    let (_, data) = load(&posed);
    let mut run = trainer(&gpu(), &config(RESTS), &data).unwrap();
    let mut seen = |to: u64| {
        let from = run.iteration();
        (from..to).map(|_| run.step().unwrap().view).collect::<std::collections::BTreeSet<_>>()
    };
    assert!(seen(24).is_disjoint(&[4, 12, 20].into()));
    assert!(seen(72).is_superset(&[4, 12, 20].into()));
}

#[test]
fn a_run_that_is_cut_off_before_or_after_the_trial_ends_with_the_same_bits() {
    let posed = posed(&scene());
    let folder = tempfile::tempdir().unwrap();
    let config = config_file(folder.path(), &format!("{RESTS}\n[log]\ncheckpoint_interval = 12"));
    let run = |name: &str| {
        let out = folder.path().join(name);
        succeed(train(&posed, &out, &["--config", config.to_str().unwrap()]));
        out
    };
    let whole = run("whole");
    let trials = log(&whole).iter().filter(|l| l["window_trial"].is_object()).count();
    assert_eq!(trials, 1);
    for kept in [1, 2] {
        let cut = run(&format!("cut after {kept}"));
        // Of iterations 24, 36, 40: the first is the state before the trial.
        checkpoints(&cut)[kept..].iter().for_each(|p| std::fs::remove_file(p).unwrap());
        succeed(train(&posed, &cut, &["--resume"]));
        assert!(newest(&cut) == newest(&whole), "resumed from checkpoint {kept}: other bits");
    }
}
