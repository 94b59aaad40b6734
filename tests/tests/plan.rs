//! The barrier plan of a frame is a golden file: every change of synchronisation shows up in review.

use engine::render::{RenderOptions, Renderer};
use engine::scene::synthetic::{demo_camera, demo_scene};

#[test]
fn frame_plan_equals_the_golden_file() {
    let gpu = tests_harness::gpu();
    let mut renderer = Renderer::new(&gpu, &demo_scene(), &RenderOptions::default()).unwrap();
    renderer.draw(&demo_camera(0.0, 640, 480), 0.0).unwrap();
    let commands = renderer.commands().unwrap();
    let golden = include_str!("../golden/frame.plan.txt");
    assert_eq!(commands.plan(), golden, "run `spgs-dev plan --write` and review the difference");
    assert!(
        commands.dispatches() <= 18 && commands.barriers() <= 18,
        "{} dispatches, {} barriers",
        commands.dispatches(),
        commands.barriers()
    );
}

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
