//! Where barriers stand in a frame, checked against the accesses themselves. The plans are golden files; see
//! `plans.rs`.

use engine::gpu::Commands;
use engine::gpu::access::Use;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{demo_camera, demo_scene};

#[test]
fn every_hazard_of_a_frame_needs_its_barrier() {
    // Each derived barrier answers a conflict: without it the tracker's own list has an open pair.
    let gpu = tests_harness::gpu();
    let mut renderer = Renderer::new(&gpu, &demo_scene(), &RenderOptions::default()).unwrap();
    renderer.draw(&demo_camera(0.0, 640, 480), 0.0).unwrap();
    let operations = renderer.commands().unwrap().uses();
    for (index, (label, uses, barrier)) in operations.iter().enumerate() {
        let conflicts = operations[..index].iter().flat_map(|(_, earlier, _)| earlier.iter()).any(|a| {
            uses.iter().any(|b| a.buffer == b.buffer && a.start < b.end && b.start < a.end && (a.write || b.write))
        });
        assert_eq!(conflicts, *barrier, "#{index} {label}");
    }
}

#[test]
fn a_training_step_keeps_its_order_between_barriers() {
    let gpu = tests_harness::gpu();
    for (superpoints, most_barriers) in [(0, 14), (8, 35)] {
        let trainer = tools::bench::train::stepped(&gpu, 500, superpoints, [64, 48]).unwrap();
        let commands = trainer.commands().unwrap();
        assert_order(commands);
        assert!(commands.barriers() <= most_barriers, "{} barriers", commands.barriers());
    }
}

/// Nothing stands beside what it waits for.
fn assert_order(commands: &Commands) {
    let operations = commands.uses();
    let mut level = 0;
    let levels: Vec<u32> = operations
        .iter()
        .map(|(_, _, barrier)| {
            level += u32::from(*barrier);
            level
        })
        .collect();
    for (second, (label, uses, _)) in operations.iter().enumerate() {
        let conflicts = |(_, earlier, _): &(&str, &[Use], bool)| {
            earlier.iter().any(|a| {
                uses.iter().any(|b| a.buffer == b.buffer && a.start < b.end && b.start < a.end && (a.write || b.write))
            })
        };
        let waits = (0..second).filter(|first| conflicts(&operations[*first])).map(|first| levels[first]).max();
        assert!(waits.is_none_or(|level| level < levels[second]), "#{second} {label} runs beside what it waits for");
    }
}

#[test]
fn a_pair_of_frames_waits_as_often_as_one() {
    let gpu = tests_harness::gpu();
    let mut renderer = Renderer::new(&gpu, &demo_scene(), &RenderOptions::default()).unwrap();
    let camera = demo_camera(0.0, 640, 480);
    renderer.draw(&camera, 0.0).unwrap();
    let (barriers, dispatches) = renderer.commands().map(|c| (c.barriers(), c.dispatches())).unwrap();
    let [frame, _] = renderer.submit_pair([(&camera, 0.0), (&camera, 0.5)]).unwrap();
    let pair = renderer.commands_of(frame).unwrap();
    assert_eq!((pair.barriers(), pair.dispatches()), (barriers, 2 * dispatches));
    assert_order(pair);
}
