//! What `spgs convert` measures: small scenes, scenes that are not where they are at rest, quick networks, pictures of nothing.

use engine::file;
use engine::reference::freeze;
use engine::scene::synthetic::{moving_scene, random_blend};
use engine::scene::{MotionSource, Scene};
use tools::command::convert::Summary;

use crate::convert::{summary, text};

/// A scene that moves by a table, `scale` times as large, and elsewhere than at rest by `shift`.
fn table(scale: f32, shift: f32) -> Scene {
    let mut scene = moving_scene(400, 5, 9, 3, false);
    scene.gaussians.mean.iter_mut().flatten().for_each(|v| *v *= scale);
    scene.gaussians.log_scale.iter_mut().flatten().for_each(|v| *v += scale.ln());
    scene.deformation.superpoints_mut().unwrap().position.iter_mut().flatten().for_each(|v| *v *= scale);
    for translation in &mut scene.deformation.table_mut().unwrap().translation {
        *translation = translation.map(|v| v * scale);
        translation[0] += shift;
    }
    scene
}

/// Bakes a scene, and gives back what was written.
fn baked(scene: &Scene, more: &[&str]) -> (Scene, Summary) {
    let folder = tempfile::tempdir().unwrap();
    let [from, to] = ["a.safetensors", "b.safetensors"].map(|name| folder.path().join(name));
    file::save(&from, scene).unwrap();
    let said = summary(&[&[text(&from), text(&to), "--bake"], more].concat()).unwrap();
    (file::load(&to).unwrap().scene, said)
}

/// Largest distance of a centre at some times.
fn far(one: &Scene, two: &Scene, source: MotionSource) -> f32 {
    let at = |t: f64| {
        let (a, b) = (freeze(one, t, MotionSource::Auto).unwrap(), freeze(two, t, source).unwrap());
        a.mean.as_flattened().iter().zip(b.mean.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    (0..=20).map(|i| at(f64::from(i) / 20.0)).fold(0.0, f32::max)
}

#[test]
fn small_scenes_and_scenes_elsewhere_keep_their_motion() {
    for (scale, shift) in [(0.01, 0.0), (1.0, 40.0), (0.01, 3.0)] {
        let scene = table(scale, shift);
        let (after, said) = baked(&scene, &["--views", "2"]);
        let bake = said.bake.as_ref().unwrap();
        assert!(bake.key_times >= 2 && bake.error_px > 0.0 && bake.error_px <= 0.1, "{bake:?}");
        assert_eq!(bake.unseen, 0, "{bake:?}");
        // A tenth of a pixel of 800, where the scene fills about half of the view; and rounding.
        let worst = far(&after, &scene, MotionSource::Auto);
        assert!(worst < 2e-3 * scale + 1e-6 * shift, "{worst} at scale {scale}, shift {shift}");
        let loss = said.loss.as_ref().unwrap();
        assert_eq!((loss.visible, loss.views.len()), (2, 2), "{}", loss.line());
        assert!(loss.psnr.is_none_or(|psnr| psnr > 40.0), "{}", loss.line());
    }
}

/// [`table`] with soft superpoints.
fn soft_table() -> Scene {
    let mut scene = table(1.0, 0.0);
    let blend = random_blend(400, 5, 4, 11);
    let s = scene.deformation.superpoint_deformation_mut().unwrap();
    (s.superpoints.of_gaussian, s.blend) = (blend.of_gaussian(), Some(blend));
    scene
}

#[test]
fn soft_superpoints_are_baked_within_the_bound() {
    let scene = soft_table();
    for (bound, bytes) in [("0.01", false), ("20", true)] {
        let (after, said) = baked(&scene, &["--views", "0", "--bake-error", bound]);
        let bake = said.bake.as_ref().unwrap();
        assert!(bake.error_px > 0.0 && bake.error_px <= bound.parse().unwrap(), "{bake:?}");
        assert_eq!(bake.rounding_px.is_some(), bytes, "{bake:?}");
        assert_eq!(after.deformation.blend().unwrap().levels().is_some(), bytes);
        assert!(far(&after, &scene, MotionSource::Auto) < 0.02 * bound.parse::<f32>().unwrap() + 1e-6, "{bake:?}");
    }
}

#[test]
fn a_moment_of_soft_superpoints_is_frozen_and_files_without_motion_say_what_they_lack() {
    let folder = tempfile::tempdir().unwrap();
    let [from, moment, rest] = ["a.safetensors", "b.ply", "c.ply"].map(|name| folder.path().join(name));
    let scene = soft_table();
    file::save(&from, &scene).unwrap();
    summary(&[text(&from), text(&moment), "--time", "0.3", "--views", "0"]).unwrap();
    assert_eq!(file::load(&moment).unwrap().scene.gaussians, freeze(&scene, 0.3, MotionSource::Auto).unwrap());
    let said = summary(&[text(&from), text(&rest), "--views", "0"]).unwrap();
    assert!(said.dropped.iter().any(|part| part.contains("their blend")), "{:?}", said.dropped);
}

#[test]
fn pictures_of_nothing_are_not_equal() {
    let mut scene = table(1.0, 0.0);
    scene.gaussians.opacity_logit.fill(-20.0);
    let (_, said) = baked(&scene, &["--views", "2"]);
    let loss = said.loss.unwrap();
    assert_eq!((loss.visible, loss.psnr), (0, None));
    assert!(loss.line().contains("nothing was visible in the 2 views"), "{}", loss.line());
}

#[test]
fn a_network_is_measured_between_the_times_of_its_table() {
    let slow = moving_scene(60, 3, 5, 3, true);
    let mut quick = slow.clone();
    let network = quick.deformation.network_mut().unwrap();
    network.translation.weight.iter_mut().for_each(|w| *w *= 300.0);
    for (scene, is_quick) in [(&slow, false), (&quick, true)] {
        let (after, said) = baked(scene, &["--motion", "network", "--views", "0"]);
        let bake = said.bake.as_ref().unwrap();
        let between = bake.between_px.expect("measured");
        assert_eq!(between > 0.1, is_quick, "{bake:?}");
        let word = if is_quick { "above the bound" } else { "within the bound" };
        assert!(bake.line().contains(word) && bake.error_px <= 0.1, "{}", bake.line());
        if is_quick {
            assert_eq!(bake.key_times, bake.candidates, "as close as it can be");
        } else {
            assert!(far(&after, scene, MotionSource::Network) < 1e-3);
        }
    }
    // A table is linear in between.
    assert_eq!(baked(&slow, &["--motion", "table", "--views", "0"]).1.bake.unwrap().between_px, None);
}

#[test]
fn a_file_without_the_motion_is_said_to_be_at_rest() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    file::save(&at("a.safetensors"), &table(1.0, 0.0)).unwrap();
    let said = |more: &[&str]| {
        let loss = summary(&[&[text(&at("a.safetensors"))], more].concat()).unwrap().loss.unwrap();
        (loss.at_rest, loss.line())
    };
    let (at_rest, line) = said(&[text(&at("b.ply"))]);
    assert!(at_rest && line.contains("without its motion"), "{line}");
    for more in [&[text(&at("b.ply")), "--time", "0.5"][..], &[text(&at("c.safetensors"))]] {
        let (at_rest, line) = said(more);
        assert!(!at_rest && !line.contains("at rest") && line.contains("PSNR"), "{line}");
    }
}
