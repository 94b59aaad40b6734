//! The end of a search: rounds of Gauss–Newton by differences of images.

use engine::pose::Options;
use engine::reference::table_poses;
use engine::render::{RenderOptions, Renderer};
use engine::scene::Camera;
use engine::train::photo_loss::{PhotoLoss, PhotoLossOptions};

use crate::{LOSS, cameras, disturbed_by, errors_px, photos, run, shares, textured};

/// Splats that end at α = 1/255 and change their order: the search's gradients do not lead to the end, differences of images do.
#[test]
fn it_goes_on_where_gradients_end() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let scene = textured(3000, 8, 11);
    let (time, cameras) = (0.41, cameras(1, [96, 96]));
    let truth = table_poses(scene.deformation.table().unwrap(), time);
    let start = disturbed_by(&scene, &truth, 1.5, 0.015, 5);
    let views = photos(&gpu, &scene, &cameras, time, folder.path());
    let shares = shares(&gpu, &scene, &cameras[0], time);
    let find = |rounds: u32| {
        let options = Options { deterministic: true, iterations: 300, rounds, probes: 0, ..Options::default() };
        let found = run(&gpu, &scene, &views, &options, Some(&start));
        let poses = table_poses(found.scene.deformation.table().unwrap(), time);
        let errors = errors_px(&scene, &shares, &poses, &truth, &cameras[0]);
        let mut sums = [0.0; 2];
        for (share, &j) in shares.iter().zip(scene.deformation.superpoint_of_gaussian()) {
            sums = [sums[0] + share, sums[1] + if errors[j as usize] <= 0.1 { *share } else { 0.0 }];
        }
        (sums[1] / sums[0], found.moments[0].photos[0].psnr)
    };
    let (without, with) = (find(0), find(8));
    println!("within 0.1 px and dB: {without:.3?} without, {with:.3?} with");
    assert!(with.0 > without.0 + 0.03 && with.1 > without.1 + 3.0, "{without:?} {with:?}");
}

/// Photos that a model cannot show as they are say nothing more than the search has found.
#[test]
fn photos_that_do_not_fit_have_no_rounds() {
    let gpu = tests_harness::shared_gpu();
    let folder = tempfile::tempdir().unwrap();
    let mut scene = textured(1000, 8, 11);
    let (time, cameras) = (0.41, cameras(1, [64, 64]));
    let views = photos(&gpu, &scene, &cameras, time, folder.path());
    // Other colours than the photos'.
    scene.gaussians.sh.iter_mut().step_by(7).for_each(|sh| *sh += 0.15);
    let find = |rounds: u32| {
        let options = Options { deterministic: true, iterations: 60, rounds, probes: 0, ..Options::default() };
        let found = run(&gpu, &scene, &views, &options, None);
        (found.moments[0].photos[0].psnr, found.scene.deformation.table().unwrap().clone())
    };
    let (without, with) = (find(0), find(8));
    assert!(without.0 < 36.0, "{}", without.0);
    assert_eq!(without, with);
}

#[test]
fn part_of_a_view_is_part_of_its_image() {
    let gpu = tests_harness::shared_gpu();
    let scene = textured(2000, 8, 11);
    let camera = Camera { time: 0.41, ..cameras(1, [96, 80]).remove(0) };
    let poses = table_poses(scene.deformation.table().unwrap(), 0.41);
    let mut loss = PhotoLoss::new(&gpu, &scene, PhotoLossOptions { background: [0.0; 3], ..LOSS }).unwrap();
    let whole = loss.image(&camera, &poses).unwrap();
    let mut renderer = Renderer::new(&gpu, &scene, &RenderOptions::default()).unwrap();
    let rendered = renderer.render(&camera, 0.41).unwrap().rgba;
    let [x, y, width, height] = [21, 33, 64, 40];
    let part = loss.image(&camera.cropped([x, y], [width, height]), &poses).unwrap();
    let (mut largest, mut others) = ([0.0_f32; 2], 0);
    for (i, value) in whole.iter().enumerate() {
        let (pixel, channel) = (i / 3, i % 3);
        largest[0] = largest[0].max((value - rendered[4 * pixel + channel]).abs());
        let at = [pixel as u32 % 96, pixel as u32 / 96];
        if (x..x + width).contains(&at[0]) && (y..y + height).contains(&at[1]) {
            let of_part = ((at[1] - y) * width + at[0] - x) as usize;
            let off = (value - part[3 * of_part + channel]).abs();
            largest[1] = largest[1].max(off);
            others += usize::from(off > 1e-5);
        }
    }
    println!("from the renderer's image {:.1e}, from the part {:.1e} ({others} by 1e-5)", largest[0], largest[1]);
    // Gaussians far outside of a view are drawn narrower, so that a few end elsewhere.
    assert!(largest[0] < 1e-5 && largest[1] < 1.0 / 255.0 && others < part.len() / 10, "{largest:?} {others}");
}
