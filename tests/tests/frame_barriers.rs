//! Where barriers stand in a frame, checked against the accesses themselves. The plans are golden files; see
//! `plans.rs`.

use engine::gpu::Commands;
use engine::gpu::access::Use;
use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{demo_camera, demo_scene};

#[test]
fn a_frame_keeps_its_order_between_the_fewest_barriers() {
    let gpu = tests_harness::gpu();
    let mut renderer = Renderer::new(&gpu, &demo_scene(), &RenderOptions::default()).unwrap();
    renderer.draw(&demo_camera(0.0, 640, 480), 0.0).unwrap();
    let commands = renderer.commands().unwrap();
    assert_order(commands);
    let (operations, levels) = (commands.uses(), levels(commands));
    // No barrier can go: something after each waits for something right before it.
    for level in 1..=levels[levels.len() - 1] {
        let of = |wanted: u32| (0..operations.len()).filter(|i| levels[*i] == wanted).collect::<Vec<_>>();
        let (before, after) = (of(level - 1), of(level));
        let waits = |i: &usize| before.iter().any(|j| is_conflict(operations[*j].1, operations[*i].1));
        assert!(after.iter().any(waits), "barrier {level} is for nothing");
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

/// Of each operation, how many barriers stand before it.
fn levels(commands: &Commands) -> Vec<u32> {
    let mut level = 0;
    let operations = commands.uses();
    let of = |(_, _, barrier): &(&str, &[Use], bool)| {
        level += u32::from(*barrier);
        level
    };
    operations.iter().map(of).collect()
}

fn is_conflict(one: &[Use], two: &[Use]) -> bool {
    let touch = |a: &Use, b: &Use| a.buffer == b.buffer && a.start < b.end && b.start < a.end && (a.write || b.write);
    one.iter().any(|a| two.iter().any(|b| touch(a, b)))
}

/// Nothing stands beside what it waits for.
fn assert_order(commands: &Commands) {
    let (operations, levels) = (commands.uses(), levels(commands));
    for (second, (label, uses, _)) in operations.iter().enumerate() {
        let before = (0..second).filter(|first| is_conflict(operations[*first].1, uses));
        let waits = before.map(|first| levels[first]).max();
        assert!(waits.is_none_or(|level| level < levels[second]), "#{second} {label} runs beside what it waits for");
    }
}

#[test]
fn frames_side_by_side_wait_as_often_as_one() {
    let gpu = tests_harness::gpu();
    let mut renderer = Renderer::new(&gpu, &demo_scene(), &RenderOptions::default()).unwrap();
    let camera = demo_camera(0.0, 640, 480);
    renderer.draw(&camera, 0.0).unwrap();
    let (barriers, dispatches) = renderer.commands().map(|c| (c.barriers(), c.dispatches())).unwrap();
    let [frame, _] = renderer.submit_beside([(&camera, 0.0), (&camera, 0.5)]).unwrap();
    let pair = renderer.commands_of(frame).unwrap();
    assert_eq!((pair.barriers(), pair.dispatches()), (barriers, 2 * dispatches));
    assert_order(pair);
}
