//! Where barriers stand in a frame, checked against the accesses themselves. The plans are golden files; see
//! `plans.rs`.

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
