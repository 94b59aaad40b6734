//! What the search makes of a model that was trained: a measurement.

use std::path::Path;

use engine::data;
use engine::pose::{Bodies, Options};
use engine::reference::table_poses;
use engine::scene::{Camera, Scene};

use crate::{disturbed_by, errors_px, photos, run, shares};

/// Superpoints that make up this much of a photo, pixels, are seen.
const SEEN_PX: f64 = 0.5;
/// The bound, pixels.
const BOUND_PX: f64 = 0.1;

fn variable(name: &str, default: f64) -> f64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// Share of what is seen whose superpoints are back within a bound.
fn within(seen: &[f64], errors: &[f64], bound: f64) -> f64 {
    let back: f64 = seen.iter().zip(errors).filter(|(_, e)| **e <= bound).map(|(s, _)| s).sum();
    back / seen.iter().sum::<f64>()
}

/// Pixels of the first photo that each superpoint makes up.
fn seen_px(scene: &Scene, shares: &[f64]) -> Vec<f64> {
    let s = scene.deformation.superpoint_deformation().unwrap();
    let mut seen = vec![0.0; s.superpoints.position.len()];
    shares.iter().enumerate().for_each(|(i, share)| s.slots(i).for_each(|(j, w)| seen[j] += w * share));
    seen
}

/// Prints how much of what is seen comes back within 0.1 pixels. Variables: `SPGS_POSE_MODEL` and `SPGS_POSE_DATA` (what it was trained
/// on), `SPGS_POSE_SIZE` (side of the photos, pixels), `SPGS_POSE_TIMES` (`0.41,0.73`), `SPGS_POSE_COUNTS` (1: one photo; 2: one, then three),
/// `SPGS_POSE_SEED`, `SPGS_POSE_ROUNDS`, `SPGS_POSE_ITERATIONS`, `SPGS_POSE_COUPLING`.
#[test]
#[ignore = "a measurement of a trained model: SPGS_POSE_MODEL and SPGS_POSE_DATA name it"]
fn superpoints_of_a_trained_model_come_back() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| std::env::var(name).unwrap_or_else(|_| panic!("{name} is not set"));
    let scene = engine::file::load(Path::new(&path("SPGS_POSE_MODEL"))).unwrap().scene;
    let size = variable("SPGS_POSE_SIZE", 200.0) as u32;
    let set = data::load_cameras(Path::new(&path("SPGS_POSE_DATA")), Some("test"), Some([size, size])).unwrap();
    let extent = 2.5 * variable("SPGS_POSE_EXTENT", 1.0);
    let reach = Bodies::new(&scene).reach;
    let seed = variable("SPGS_POSE_SEED", 5.0) as u64;
    let times = std::env::var("SPGS_POSE_TIMES").unwrap_or("0.41,0.73".to_owned());
    for time in times.split(',').map(|time| time.parse().unwrap()) {
        let truth = table_poses(scene.deformation.table().unwrap(), time);
        let start = disturbed_by(&scene, &truth, 5.0, 0.02 * extent, seed);
        for count in [1, 3].into_iter().take(variable("SPGS_POSE_COUNTS", 2.0) as usize) {
            let step = set.cameras.len() / 3;
            let cameras: Vec<Camera> = set.cameras.iter().step_by(step).take(count).cloned().collect();
            let views = photos(&gpu, &scene, &cameras, time, folder.path());
            let begun = std::time::Instant::now();
            let mut options = Options { probes: 0, ..Options::default() };
            options.coupling = variable("SPGS_POSE_COUPLING", options.coupling);
            options.iterations = variable("SPGS_POSE_ITERATIONS", f64::from(options.iterations)) as u32;
            options.rounds = variable("SPGS_POSE_ROUNDS", f64::from(options.rounds)) as u32;
            let found = run(&gpu, &scene, &views, &options, Some(&start));
            let seconds = begun.elapsed().as_secs_f64();
            let poses = table_poses(found.scene.deformation.table().unwrap(), time);
            let shares = shares(&gpu, &scene, &cameras[0], time);
            let seen = seen_px(&scene, &shares);
            let errors = |poses| errors_px(&scene, &shares, poses, &truth, &cameras[0]);
            let (before, after) = (errors(&start), errors(&poses));
            let shown: Vec<usize> = (0..seen.len()).filter(|&j| seen[j] >= SEEN_PX).collect();
            let back = shown.iter().filter(|&&j| after[j] <= BOUND_PX).count();
            let [b, a] = [&before, &after].map(|e| within(&seen, e, BOUND_PX));
            let half = within(&seen, &after, 0.5);
            println!(
                "{size}x{size}, time {time}, {count} photos: {:.1} % of what is seen before, {:.1} % after within 0.1 px, {:.1} % \
                 within 0.5; {back} of {} superpoints; PSNR {:.2?}; {seconds:.1} s",
                100.0 * b,
                100.0 * a,
                100.0 * half,
                shown.len(),
                found.moments[0].photos.iter().map(|p| p.psnr).collect::<Vec<_>>(),
            );
            let mut off: Vec<usize> = shown.into_iter().filter(|&j| after[j] > BOUND_PX).collect();
            off.sort_by(|&a, &b| seen[b].total_cmp(&seen[a]));
            for &j in off.iter().take(12) {
                println!(
                    "  {j}: {:.1} px seen, {:.2} → {:.3} px off, reach {:.3}",
                    seen[j], before[j], after[j], reach[j]
                );
            }
        }
    }
}
