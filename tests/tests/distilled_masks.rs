//! Whether the parts of a distilled model are the objects that the masks of its data set show: a measurement.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::data::dataset::{self, DatasetOptions};
use engine::distill::adjusted_rand;
use engine::render::{RenderOptions, Renderer};

/// A pixel whose heaviest Gaussian weighs less shows no one part.
const CLEAR: f32 = 0.1;

/// Pixels of all training photos that show an object: the superpoint of the Gaussian that weighs most, and the mask's number.
fn pixels(model: &Path, data: &Path) -> [Vec<u32>; 2] {
    let gpu = tests_harness::shared_gpu();
    let scene = engine::file::load(model).unwrap().scene;
    let superpoint = scene.deformation.superpoint_of_gaussian().to_vec();
    let options = DatasetOptions { downscale: Some(8), ..DatasetOptions::default() };
    let set = dataset::load(data, &options).unwrap();
    let mut renderer = Renderer::new(&gpu, &scene, &RenderOptions::default()).unwrap();
    let mut found = [Vec::new(), Vec::new()];
    for view in &set.train {
        let path = view.image.mask.as_ref().expect("masks");
        let mask = image::open(path).unwrap().to_luma8();
        renderer.render(&view.camera, view.time).unwrap();
        let all = (0..view.camera.height).flat_map(|y| (0..view.camera.width).map(move |x| [x, y]));
        for [x, y] in all {
            // The middle one of the pixels that were averaged.
            let object = u32::from(mask.get_pixel(8 * x + 4, 8 * y + 4).0[0]);
            let picked = if object == 0 { None } else { renderer.pick([x, y]).unwrap() };
            if let Some(picked) = picked.filter(|p| p.weight >= CLEAR) {
                found[0].push(superpoint[picked.gaussian as usize]);
                found[1].push(object);
            }
        }
    }
    found
}

/// Prints how the parts agree with the masks. `SPGS_MASKS_MODEL`: of `spgs distill`; `SPGS_MASKS_DATA`: what its teacher was trained on.
#[test]
#[ignore = "a measurement of a distilled model: SPGS_MASKS_MODEL and SPGS_MASKS_DATA name it"]
fn parts_of_a_distilled_model_are_the_objects_of_the_masks() {
    let path = |name: &str| PathBuf::from(std::env::var(name).unwrap_or_else(|_| panic!("{name} is not set")));
    let [part, object] = pixels(&path("SPGS_MASKS_MODEL"), &path("SPGS_MASKS_DATA"));
    let mut shared: BTreeMap<u32, BTreeMap<u32, usize>> = BTreeMap::new();
    part.iter().zip(&object).for_each(|(&p, &o)| *shared.entry(p).or_default().entry(o).or_default() += 1);
    for (p, objects) in &shared {
        println!("superpoint {p}: pixels by object {objects:?}");
    }
    let own: usize = shared.values().filter_map(|objects| objects.values().max()).sum();
    let all = part.len();
    println!(
        "{all} pixels, {} superpoints: adjusted Rand index {:.4}; {:.2} % of the pixels are of their superpoint's object",
        shared.len(),
        adjusted_rand(&part, &object),
        100.0 * own as f64 / all as f64
    );
    assert!(all > 0 && 100 * own >= 98 * all, "{own} of {all}: superpoints are shared by objects");
}
