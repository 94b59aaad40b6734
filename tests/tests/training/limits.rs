//! Memory: budgets, and allocations that fail.

use engine::error::Error;
use engine::gpu::Memory;
use engine::train::trainer::TrainingData;

use crate::common::{PosedOptions, advance, bytes, config, load, posed, trainer};

#[test]
fn growth_stops_at_the_most_gaussians() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = tests_harness::gpu();
    let over = "[schedule]\nwarm_up = 100\n[density]\ngradient_threshold = 1e-6\nmin_opacity = 0.0001\n[budget]\nmax_gaussians = 150";
    let mut trainer = trainer(&gpu, &config(over), &data).unwrap();
    let (mut refused, mut most) = (0, 0);
    while !trainer.is_done() {
        most = most.max(trainer.step().unwrap().gaussians);
        refused += trainer.take_density_change().map_or(0, |c| c.refused);
    }
    assert!(most == 150 && refused > 0, "at most {most}, {refused} refused");
}

#[test]
fn constants_apart_from_the_host_train_the_same() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let trained = [false, true].map(|apart| {
        let gpu = tests_harness::gpu();
        gpu.inject_memory_apart(apart);
        let mut trainer = trainer(&gpu, &config(""), &data).unwrap();
        advance(&mut trainer, 24).unwrap();
        let times: Vec<f32> = trainer.motion_at(&[0.0, 0.3]).unwrap().unwrap().translation.concat();
        (bytes(&trainer.checkpoint().unwrap()), times.into_iter().map(f32::to_bits).collect::<Vec<_>>())
    });
    assert!(trained[0] == trained[1]);
}

#[test]
fn more_points_than_the_budget_are_thinned() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = tests_harness::gpu();
    let mut trainer = trainer(&gpu, &config("[budget]\nmax_gaussians = 50"), &data).unwrap();
    assert_eq!(trainer.gaussians(), 50);
    advance(&mut trainer, 2).unwrap();
}

#[test]
fn a_byte_budget_ends_growth_or_is_one_clear_error() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let over = |bytes: u64| {
        let density = "[density]\ngradient_threshold = 1e-7\nmin_opacity = 0.0001\ninterval = 3\nuntil = 40";
        config(&format!("[schedule]\nwarm_up = 100\n{density}\n[budget]\nmax_bytes = {bytes}"))
    };
    let gpu = tests_harness::gpu();
    // What the first steps take.
    let mut free = trainer(&gpu, &over(0), &data).unwrap();
    advance(&mut free, 2).unwrap();
    let used = gpu.memory_used().0;
    drop(free);
    let (mut finished, mut refused) = (0, 0);
    for percent in [1, 20, 60, 90, 105, 130, 200, 400] {
        let gpu = tests_harness::gpu();
        let outcome = trainer(&gpu, &over(used * percent / 100), &data).and_then(|mut t| {
            while !t.is_done() {
                t.step()?;
                refused += t.take_density_change().map_or(0, |c| c.refused);
                let (used, budget) = gpu.memory_used();
                assert!(used <= budget);
            }
            t.checkpoint()
        });
        match outcome {
            Ok(_) => finished += 1,
            Err(Error::OutOfMemory { name, .. }) => assert!(!name.is_empty() && percent < 400, "{percent} %: {name}"),
            Err(other) => panic!("{percent} %: {other}"),
        }
        assert_eq!(gpu.buffer_count(), 0, "{percent} %: buffers are left");
    }
    assert!(finished >= 2 && refused > 0, "{finished} runs finished, {refused} Gaussians refused");
}

#[test]
fn every_allocation_may_fail() {
    let posed = posed(&PosedOptions { train: 2, test: 0, ..PosedOptions::default() });
    let (_, data) = load(&posed);
    let density = "[density]\nfrom = 0\ninterval = 1\nopacity_reset_interval = 0\nuntil = 2\nunseen_interval = 1";
    // Construction and two steps with density control, allocation by allocation; then with motion, every fifth.
    let still = fail_each(&data, &format!("[schedule]\nwarm_up = 100\n{density}"), 1);
    assert!(still > 60, "{still} allocations failed");
    let moving = fail_each(&data, &format!("[schedule]\nwarm_up = 2\n{density}"), 5);
    assert!(moving > 20, "{moving} allocations failed");
}

/// Lets every `stride`-th allocation of two steps fail; how many there were.
fn fail_each(data: &TrainingData, over: &str, stride: usize) -> u32 {
    let gpu = tests_harness::gpu();
    let config = config(over);
    let run = || {
        let mut t = trainer(&gpu, &config, data)?;
        advance(&mut t, 2)?;
        t.checkpoint()
    };
    let whole = run().unwrap();
    let left = gpu.buffer_count();
    let mut failures = 0;
    for k in (1..2000_u64).step_by(stride) {
        gpu.inject_allocation_failure(k);
        let outcome = run();
        // The failure is still to come when the run needed fewer allocations.
        let past_the_end = (0..stride).any(|_| gpu.buffer("probe", 4, Memory::Device).is_err());
        gpu.inject_allocation_failure(0);
        match outcome {
            Err(Error::OutOfMemory { name, .. }) => failures += u32::from(!name.is_empty()),
            Err(other) => panic!("allocation {k}: {other}"),
            // Density control goes on without growth where its own arrays find no room.
            Ok(checkpoint) => assert!(checkpoint == whole || !past_the_end, "allocation {k}"),
        }
        assert_eq!(gpu.buffer_count(), left, "allocation {k}: buffers are left");
        if past_the_end {
            break;
        }
    }
    assert!(run().unwrap() == whole, "afterwards everything is as before");
    failures
}
