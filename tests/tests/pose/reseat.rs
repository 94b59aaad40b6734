//! Superpoints that neighbours lead astray are found all the same.

use engine::pose::{Bodies, Options, put};
use engine::reference::table_poses;
use glam::DVec3;

use crate::{cameras, disturbed, errors_px, moving_as_one, photos, run, shares};

/// The superpoint that stands elsewhere than in training, by how much, world units.
const ASTRAY: usize = 2;
const BESIDE: DVec3 = DVec3::new(0.0, 0.36, 0.36);

/// In training all moved as one; now one superpoint stands beside the others. While photos are small, its neighbours draw it to them,
/// and what it covers there keeps it (19 pixels off).
#[test]
fn what_neighbours_lead_astray_is_found() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let scene = moving_as_one();
    let (time, cameras) = (0.41, cameras(1, [128, 128]));
    let bodies = Bodies::new(&scene);
    let poses = table_poses(scene.deformation.table().unwrap(), time);
    let mut stands = bodies.stands(&poses);
    stands[ASTRAY] = stands[ASTRAY].moved(DVec3::ZERO, BESIDE);
    let truth = bodies.poses(&stands, &poses);
    let mut shown = scene.clone();
    put(shown.deformation.table_mut().unwrap(), time, &truth).unwrap();
    let views = photos(&gpu, &shown, &cameras, time, folder.path());
    let start = disturbed(&scene, &truth, 5);
    let options = Options { deterministic: true, rounds: 0, probes: 0, ..Options::default() };
    let found = run(&gpu, &scene, &views, &options, Some(&start));
    let found = table_poses(found.scene.deformation.table().unwrap(), time);
    let shares = shares(&gpu, &shown, &cameras[0], time);
    let errors = |poses| errors_px(&scene, &shares, poses, &truth, &cameras[0])[ASTRAY];
    let (before, after) = (errors(&start), errors(&found));
    println!("{before:.3} pixels off before, {after:.3} after");
    assert!(before > 0.5 && after <= 0.1, "{before} {after}");
}
