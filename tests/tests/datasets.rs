//! Data sets: every format found by its files, geometry against the photos, splits, damage.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::{Path, PathBuf};

use engine::data::dataset::{self, DatasetKind, DatasetOptions, MaskRule, SplitRule, TimeRule};
use engine::data::pixels::LEFT_OUT;
use engine::data::{Dataset, View, load_cameras};
use engine::error::Error;
use glam::DVec3;
use tests_harness::data;

#[path = "datasets/damage.rs"]
mod damage;

fn load(path: &Path) -> Dataset {
    dataset::load(path, &DatasetOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn at(path: &Path, downscale: u32) -> Dataset {
    let options = DatasetOptions { downscale: Some(downscale), ..DatasetOptions::default() };
    dataset::load(path, &options).unwrap_or_else(|e| panic!("{e}"))
}

fn counts(d: &Dataset) -> [usize; 3] {
    [d.train.len(), d.test.len(), d.val.len()]
}

// ---------------------------------------------------------------------------------------------- real data

#[test]
fn blender_scenes_load() {
    for (name, frames, times) in [
        ("dnerf_lego", [50, 20, 11], [0.0, 1.0]),
        ("robot_dance", [100, 20, 10], [0.0, 1.0]),
        ("mujoco_collision", [108, 21, 21], [0.0, 1.0]),
        ("mujoco_deformation", [126, 27, 27], [0.0, 173.0 / 179.0]),
    ] {
        let Some(path) = data(name) else { return };
        let d = at(&path, 8);
        assert_eq!((d.kind, counts(&d)), (DatasetKind::Blender, frames), "{name}");
        assert!((0..2).all(|i| (d.time_range[i] - times[i]).abs() < 1.0e-12), "{name}: {:?}", d.time_range);
        assert!(!d.is_static && d.points.is_none() && d.extent > 0.0 && d.downscale == 8);
        let view = &d.test[3];
        let pixels = view.image.decode().unwrap();
        assert_eq!([pixels.width, pixels.height], [view.camera.width, view.camera.height]);
        assert_eq!(pixels.rgba.len(), (pixels.width * pixels.height) as usize);
        if name != "mujoco_collision" && name != "mujoco_deformation" {
            assert_eq!(pixels.at(0, 0), Some([0.0; 4]), "{name}: transparent around the object");
        } else {
            assert!(view.image.mask.is_some() && view.image.decode_mask().unwrap().unwrap().len() == pixels.rgba.len());
        }
        assert!(pixels.rgba.iter().any(|p| p.to_le_bytes()[3] == 255));
    }
}

#[test]
fn cameras_without_pictures_are_cameras_only() {
    let Some(path) = data("dycheck_paper_windmill_cameras") else { return };
    let error = dataset::load(&path, &DatasetOptions::default()).unwrap_err().to_string();
    assert!(error.contains("rgb/2x/0_00000.png"), "{error}");
    let set = |split| load_cameras(&path, split, None).unwrap().cameras;
    assert_eq!([set(None).len(), set(Some("train")).len(), set(Some("all")).len()], [419, 277, 696]);
    let camera = &set(Some("train"))[0];
    assert_eq!((camera.width, camera.height, camera.name.as_str()), (360, 480, "0_00000"));
    assert!((camera.fx - 719.947_143_554_687_5 / 2.0).abs() < 1.0e-9);
    // orientation diag(1, −1, −1): the camera looks along world −z, y up.
    assert!((camera.rotation.transpose() * DVec3::Z - DVec3::NEG_Z).length() < 1.0e-6);
    assert!(load_cameras(&path, Some("val"), None).is_err());
}

/// Median difference of the points' colours from the pixels that show them (occluded and moved points are the upper
/// part); `shuffled`: from pixels of other points.
fn colour_error(d: &Dataset, views: &[View], shuffled: bool) -> f64 {
    let points = d.points.as_ref().unwrap();
    let n = points.position.len();
    let mut errors = Vec::new();
    for view in views {
        let pixels = view.image.decode().unwrap();
        for i in 0..n {
            let [x, y, z] = points.position[i].map(f64::from);
            let c = &view.camera;
            let local = c.rotation * (DVec3::new(x, y, z) - c.position);
            let (u, v) = (c.fx * local.x / local.z + c.cx, c.fy * local.y / local.z + c.cy);
            let inside =
                local.z > 0.0 && (0.0..f64::from(c.width)).contains(&u) && (0.0..f64::from(c.height)).contains(&v);
            if inside {
                let seen = pixels.at(u as u32, v as u32).unwrap();
                let colour = points.colour[if shuffled { (i * 7919 + 13) % n } else { i }];
                let difference = |k: usize| (f64::from(seen[k]) * 255.0 - f64::from(colour[k])).abs();
                errors.push((0..3).map(difference).sum::<f64>() / 3.0);
            }
        }
    }
    assert!(errors.len() > 1000, "{} points inside", errors.len());
    errors.sort_unstable_by(f64::total_cmp);
    errors[errors.len() / 2]
}

#[test]
fn nerfies_points_have_the_colours_of_the_photos() {
    let Some(path) = data("nerfies_capture1") else { return };
    let d = load(&path);
    println!("{}", d.decisions.join("\n"));
    assert_eq!((d.kind, counts(&d), d.downscale), (DatasetKind::Nerfies, [82, 5, 0], 2));
    assert_eq!((d.train[0].camera.width, d.train[0].camera.height, d.time_range), (240, 428, [0.0, 1.0]));
    let mut views: Vec<View> = d.train.iter().step_by(9).cloned().collect();
    let right = colour_error(&d, &views, false);
    let shuffled = colour_error(&d, &views, true);
    // The photos as they are, and with the lens' coefficients of the other sign.
    let lens = views[0].image.lens;
    views.iter_mut().for_each(|v| v.image.lens = None);
    let distorted = colour_error(&d, &views, false);
    let mut negated = lens.unwrap();
    if let engine::data::lens::Distortion::Brown { radial, tangential, .. } = &mut negated.distortion {
        *radial = radial.map(|k| -k);
        *tangential = tangential.map(|p| -p);
    }
    views.iter_mut().for_each(|v| v.image.lens = Some(negated));
    let wrong = colour_error(&d, &views, false);
    views.iter_mut().for_each(|v| {
        v.image.lens = lens;
        v.camera.rotation = v.camera.rotation.transpose();
    });
    let transposed = colour_error(&d, &views, false);
    println!("right {right} distorted {distorted} negated {wrong} shuffled {shuffled} transposed {transposed}");
    // Most points lie on smooth surfaces or moved, so that a lens that is a few pixels off shows little; the order is
    // clear, and the tracks tell the lens apart: 0.40 px with the right signs, 0.92 px without distortion.
    assert!(right < 0.5 * shuffled && right < 0.97 * distorted && right < 0.9 * wrong && right < 0.5 * transposed);
    let line = d.decisions.iter().find(|l| l.starts_with("lens:")).unwrap();
    assert!(line.contains("0.40 px with its own"), "{line}");
    let raw = DatasetOptions { raw_world_units: true, downscale: Some(4), ..DatasetOptions::default() };
    let raw = dataset::load(&path, &raw).unwrap();
    let scale = 0.044_805_950_706_426_09;
    assert!((d.extent / raw.extent - scale).abs() < 1.0e-9);
    assert_eq!(raw.train[0].image.stored, [120, 214], "the stored level is used");
    assert_eq!(at(&path, 8).train[0].image.stored, [120, 214]);
    let options = DatasetOptions { downscale: Some(1), ..DatasetOptions::default() };
    assert!(dataset::load(&path, &options).unwrap_err().to_string().contains("rgb/1x/"));
}

/// Plane sweep of neighbouring photos: mean over blocks of the least difference over depths.
fn sweep(views: &[View], flip: impl Fn(&View) -> View, depths: [f64; 2]) -> f64 {
    const STEPS: u32 = 32;
    let mut total = 0.0;
    for pair in views.windows(2) {
        let (a, b) = (flip(&pair[0]), flip(&pair[1]));
        let (pa, pb) = (a.image.decode().unwrap(), b.image.decode().unwrap());
        let blocks = (a.camera.width / 8, a.camera.height / 8);
        for block in 0..blocks.0 * blocks.1 {
            let (x0, y0) = (block % blocks.0 * 8, block / blocks.0 * 8);
            let error = |depth: f64| -> f64 {
                let mut sum = 0.0;
                for k in 0..16u32 {
                    let (x, y) = (x0 + k % 4 * 2, y0 + k / 4 * 2);
                    let c = &a.camera;
                    let ray = DVec3::new((f64::from(x) + 0.5 - c.cx) / c.fx, (f64::from(y) + 0.5 - c.cy) / c.fy, 1.0);
                    let world = c.position + c.rotation.transpose() * (depth * ray);
                    let c = &b.camera;
                    let local = c.rotation * (world - c.position);
                    let (u, v) = (c.fx * local.x / local.z + c.cx, c.fy * local.y / local.z + c.cy);
                    let seen = (local.z > 0.0 && u >= 0.0 && v >= 0.0).then(|| pb.at(u as u32, v as u32)).flatten();
                    let here = pa.at(x, y).unwrap();
                    sum += seen.map_or(0.15, |s| (0..3).map(|i| f64::from((s[i] - here[i]).abs())).sum::<f64>() / 3.0);
                }
                sum / 16.0
            };
            let depth = |i: u32| {
                let t = f64::from(i) / f64::from(STEPS - 1);
                1.0 / ((1.0 - t) / depths[0] + t / depths[1])
            };
            total += (0..STEPS).map(|i| error(depth(i))).fold(f64::INFINITY, f64::min) / f64::from(blocks.0 * blocks.1);
        }
    }
    255.0 * total / (views.len() - 1) as f64
}

/// A right-handed change of the camera's axes that a wrong convention would make: x and y swapped, z reversed.
fn other_axes(view: &View) -> View {
    let mut view = view.clone();
    let t = view.camera.rotation.transpose();
    view.camera.rotation = glam::DMat3::from_cols(t.y_axis, t.x_axis, -t.z_axis).transpose();
    view
}

fn opposite(view: &View) -> View {
    let mut view = view.clone();
    let t = view.camera.rotation.transpose();
    view.camera.rotation = glam::DMat3::from_cols(-t.y_axis, t.x_axis, t.z_axis).transpose();
    view
}

#[test]
fn llff_axes_agree_with_the_photos() {
    let Some(path) = data("nrnerf_example_sequence") else { return };
    let d = at(&path, 4);
    println!("{}", d.decisions.join("\n"));
    assert_eq!((d.kind, counts(&d), d.time_range[1]), (DatasetKind::NonrigidNerf, [75, 11, 0], 1.0));
    assert_eq!((d.train[0].camera.width, d.points.as_ref().unwrap().position.len() >= 20_000), (128, true));
    let views: Vec<View> = d.train.iter().step_by(8).cloned().collect();
    let depths = [0.03, 0.9];
    let right = sweep(&views, View::clone, depths);
    let wrong = [sweep(&views, other_axes, depths), sweep(&views, opposite, depths)];
    println!("nrnerf right {right}, wrong {wrong:?}");
    assert!(wrong.iter().all(|w| right < 0.8 * w), "{right} {wrong:?}");

    let Some(path) = data("nvidia_balloon1") else { return };
    let d = at(&path, 8);
    println!("{}", d.decisions.join("\n"));
    assert_eq!((d.kind, counts(&d)), (DatasetKind::Nvidia, [12, 12, 0]));
    assert!(d.train == d.test && d.decisions.iter().any(|l| l.contains("NO TEST PICTURES")));
    let depths = [30.0, 90.0];
    let right = sweep(&d.train, View::clone, depths);
    let wrong = [sweep(&d.train, other_axes, depths), sweep(&d.train, opposite, depths)];
    println!("balloon right {right}, wrong {wrong:?}");
    assert!(wrong.iter().all(|w| right < 0.8 * w), "{right} {wrong:?}");
    let held = DatasetOptions { split: SplitRule::Hold(4), time: TimeRule::Static, ..DatasetOptions::default() };
    let held = dataset::load(&path, &held).unwrap();
    assert!(counts(&held) == [9, 3, 0] && held.is_static);
    assert_eq!(load_cameras(&path, Some("train"), Some([96, 54])).unwrap().cameras[0].width, 96);
}

// ---------------------------------------------------------------------------------------------- made-up data

fn write(path: PathBuf, text: impl AsRef<[u8]>) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

fn picture(path: PathBuf, size: [u32; 2], colour: impl Fn(f64, f64) -> [f64; 3]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let pixel = |x, y| image::Rgb(colour(f64::from(x) + 0.5, f64::from(y) + 0.5).map(|c| c.round() as u8));
    image::RgbImage::from_fn(size[0], size[1], pixel).save(path).unwrap();
}

/// A Nerfies-like scene of `n` frames, 16 x 8 at 1x, with pictures at 1x and 2x.
fn nerfies_scene(folder: &Path, n: usize, lists: bool) {
    let ids: Vec<String> = (0..n).map(|i| format!("f{i:03}")).collect();
    let (train, val): (Vec<&String>, Vec<&String>) = ids.iter().partition(|id| !id.ends_with('3'));
    let (train, val) = if lists { (train, val) } else { (vec![], vec![]) };
    let lists = format!("{{\"count\":{n},\"ids\":{ids:?},\"train_ids\":{train:?},\"val_ids\":{val:?}}}");
    write(folder.join("dataset.json"), lists);
    let metadata: Vec<String> =
        ids.iter().enumerate().map(|(i, id)| format!("\"{id}\":{{\"warp_id\":{i},\"camera_id\":0}}")).collect();
    write(folder.join("metadata.json"), format!("{{{}}}", metadata.join(",")));
    write(folder.join("scene.json"), "{\"scale\":0.5,\"center\":[1,2,3],\"near\":0.1,\"far\":1}");
    for (i, id) in ids.iter().enumerate() {
        let camera = format!(
            "{{\"orientation\":[[1,0,0],[0,1,0],[0,0,1]],\"position\":[{i},2,3],\"focal_length\":20,\"skew\":0.0,\
             \"principal_point\":[8.5,4.25],\"pixel_aspect_ratio\":1.1,\"radial_distortion\":[0.01,0,0],\
             \"tangential\":[0,0.001],\"image_size\":[16,8]}}"
        );
        write(folder.join(format!("camera/{id}.json")), camera);
        picture(folder.join(format!("rgb/1x/{id}.png")), [16, 8], |_, _| [i as f64, 0.0, 0.0]);
        picture(folder.join(format!("rgb/2x/{id}.png")), [8, 4], |_, _| [i as f64, 2.0, 0.0]);
    }
}

#[test]
fn nerf_ds_scenes_have_masks_lists_and_full_size() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("NeRF-DS/bell_novel_view");
    nerfies_scene(&scene, 12, true);
    // NeRF-DS has cameras of its two rigs beside, and a COLMAP model that must not take the data set's place.
    write(scene.join("train_camera/f000.json"), "{}");
    write(scene.join("vrig_camera/f003.json"), "{}");
    write(scene.join("sparse/0/images.bin"), "nonsense");
    picture(scene.join("resized_mask/1x/f001.png.png"), [16, 8], |x, _| [if x < 4.0 { 0.0 } else { 255.0 }; 3]);
    std::fs::remove_file(scene.join("sparse/0/images.bin")).unwrap();
    write(scene.join("points.npy"), npy(&[2, 3], &[3.0, 2.0, 3.0, 1.0, 2.0, 5.0]));
    let d = load(&scene);
    println!("{}", d.decisions.join("\n"));
    assert_eq!((d.kind, counts(&d), d.downscale), (DatasetKind::NerfDs, [11, 1, 0], 1));
    assert_eq!(d.points.as_ref().unwrap().position, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
    let view = &d.train[1];
    assert_eq!((view.name.as_str(), view.time), ("f001", 1.0 / 11.0));
    assert_eq!(view.camera.position, DVec3::ZERO, "(1 − 1, 2 − 2, 3 − 3) · 0.5");
    let c = &view.camera;
    assert_eq!((c.fx, c.fy, c.cx, c.cy, c.width, c.height), (20.0, 22.0, 8.5, 4.25, 16, 8));
    let mask = view.image.decode_mask().unwrap().unwrap();
    assert_eq!((mask[0], mask[15], mask.len()), (0, 255, 128));
    assert_eq!(view.image.decode().unwrap().rgba[5].to_le_bytes(), [1, 0, 0, 255]);
    // What training leaves out, when it is asked to; these masks say what moves, so it is not by itself.
    assert_eq!((view.image.used, d.train[0].image.used), (None, None));
    assert!(d.decisions.iter().any(|l| l.contains("training does not use them (data.masks)")), "{:?}", d.decisions);
    for (masks, left_out) in [(MaskRule::White, 0), (MaskRule::Black, 12)] {
        let d = dataset::load(&scene, &DatasetOptions { masks, ..DatasetOptions::default() }).unwrap();
        let pixels = d.train[1].image.decode_for_training().unwrap().rgba;
        assert_eq!(
            (pixels[left_out], pixels[12 - left_out]),
            (LEFT_OUT, u32::from_le_bytes([1, 0, 0, 255])),
            "{masks:?}"
        );
        let [bare, whole] = [d.train[0].image.decode_for_training(), d.train[0].image.decode()].map(|p| p.unwrap());
        assert_eq!(bare, whole, "no mask, no pixel less");
    }
    // A mask may be larger than its photo, not smaller.
    for (size, fits) in [([32, 16], true), ([8, 4], false), ([32, 4], false), ([32, 32], false)] {
        picture(scene.join("resized_mask/1x/f001.png.png"), size, |x, _| [if x < 8.0 { 0.0 } else { 255.0 }; 3]);
        let masks = MaskRule::White;
        let d = dataset::load(&scene, &DatasetOptions { masks, ..DatasetOptions::default() }).unwrap();
        let found = d.train[1].image.decode_for_training();
        assert_eq!(found.as_ref().is_ok_and(|p| p.rgba[3] == LEFT_OUT && p.rgba[4] != LEFT_OUT), fits, "{size:?}");
        let named = |e: &Error| e.to_string().contains("f001.png.png") && e.to_string().contains("16 x 8");
        assert!(fits || found.as_ref().is_err_and(named), "{found:?}");
    }
}

#[test]
fn hypernerf_splits_follow_the_folder_or_the_option() {
    let folder = tempfile::tempdir().unwrap();
    let scene = |group: &str, lists: bool| {
        let scene = folder.path().join(group).join(if lists { "listed" } else { "bare" });
        nerfies_scene(&scene, 12, lists);
        scene
    };
    let names = |views: &[View]| views.iter().map(|v| v.name[1..].parse().unwrap()).collect::<Vec<usize>>();
    for (group, lists, train, test) in [
        ("vrig", true, (0..12).filter(|i| *i != 3).collect(), vec![3]),
        ("interp_x", true, vec![0, 4, 8], vec![2, 6, 10]),
        ("misc", true, (0..12).filter(|i| *i != 3).collect::<Vec<_>>(), vec![3]),
        ("misc", false, vec![0, 4, 8], vec![2, 6, 10]),
    ] {
        let d = load(&scene(group, lists));
        assert_eq!((names(&d.train), names(&d.test), d.downscale), (train, test, 2), "{group} {lists}");
        assert_eq!((d.train[0].camera.width, d.train[0].image.stored), (8, [8, 4]));
        assert_eq!(d.train[0].image.decode().unwrap().rgba[0].to_le_bytes()[1], 2);
    }
    let misc = folder.path().join("misc/listed");
    let split = |split| dataset::load(&misc, &DatasetOptions { split, ..DatasetOptions::default() }).unwrap();
    assert_eq!(names(&split(SplitRule::Interpolation).test), [2, 6, 10]);
    assert_eq!(names(&split(SplitRule::Hold(6)).test), [0, 6]);
    assert_eq!(counts(&split(SplitRule::All)), [12, 0, 0]);
    // Averaged down from the stored size that divides 3.
    assert_eq!((at(&misc, 3).train[0].image.stored, at(&misc, 3).train[0].image.size), ([16, 8], [5, 3]));
}

fn npy(shape: &[u64; 2], values: &[f64]) -> Vec<u8> {
    use npyz::WriterBuilder;
    let mut bytes = Vec::new();
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(&mut bytes).begin_nd().unwrap();
    writer.extend(values.iter().copied()).unwrap();
    writer.finish().unwrap();
    bytes
}

/// A smooth scene at infinity, as colour of a direction (x, y, 1).
fn sky(x: f64, y: f64) -> [f64; 3] {
    [(7.0 * x + 1.0).sin(), (6.0 * y - 2.0 * x).cos(), (5.0 * x * y + 3.0 * y).sin()].map(|c| 128.0 + 100.0 * c)
}

/// OpenCV's documentation, written out: pixel of a direction.
fn opencv(p: &[f64; 12], x: f64, y: f64) -> [f64; 2] {
    let [fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6] = *p;
    let (r2, r4, r6) = (x * x + y * y, (x * x + y * y).powi(2), (x * x + y * y).powi(3));
    let radial = (1.0 + k1 * r2 + k2 * r4 + k3 * r6) / (1.0 + k4 * r2 + k5 * r4 + k6 * r6);
    let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
    let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
    [fx * xd + cx, fy * yd + cy]
}

fn fisheye(f: [f64; 4], k: [f64; 4], x: f64, y: f64) -> [f64; 2] {
    let r = x.hypot(y);
    let t = r.atan();
    let td = t + k[0] * t.powi(3) + k[1] * t.powi(5) + k[2] * t.powi(7) + k[3] * t.powi(9);
    let s = if r > 0.0 { td / r } else { 1.0 };
    [f[0] * x * s + f[2], f[1] * y * s + f[3]]
}

#[test]
fn photos_of_every_lens_become_pinhole_pictures() {
    const SIZE: [u32; 2] = [96, 64];
    const F: [f64; 4] = [90.0, 85.0, 50.0, 30.5];
    type Project = Box<dyn Fn(f64, f64) -> [f64; 2]>;
    let brown = |d: [f64; 8]| -> Project {
        let mut p = [0.0; 12];
        p[..4].copy_from_slice(&F);
        p[4..].copy_from_slice(&d);
        Box::new(move |x, y| opencv(&p, x, y))
    };
    let square = |d: [f64; 8]| -> Project {
        let p = [90.0, 90.0, 50.0, 30.5, d[0], d[1], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        Box::new(move |x, y| opencv(&p, x, y))
    };
    let zero = [0.0; 8];
    let cases: Vec<(&str, &str, Project)> = vec![
        ("SIMPLE_PINHOLE", "90 50 30.5", square(zero)),
        ("PINHOLE", "90 85 50 30.5", brown(zero)),
        ("SIMPLE_RADIAL", "90 50 30.5 0.15", square([0.15, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])),
        ("RADIAL", "90 50 30.5 -0.12 0.2", square([-0.12, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])),
        ("OPENCV", "90 85 50 30.5 0.1 -0.2 0.004 0.03", brown([0.1, -0.2, 0.004, 0.03, 0.0, 0.0, 0.0, 0.0])),
        (
            "FULL_OPENCV",
            "90 85 50 30.5 0.1 -0.2 0.02 -0.01 0.05 0.03 0.02 0.01",
            brown([0.1, -0.2, 0.02, -0.01, 0.05, 0.03, 0.02, 0.01]),
        ),
        ("OPENCV_FISHEYE", "90 85 50 30.5 0.1 -0.05 0.02 0.01", {
            Box::new(|x, y| fisheye(F, [0.1, -0.05, 0.02, 0.01], x, y))
        }),
    ];
    for (model, parameters, project) in cases {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path();
        write(scene.join("sparse/0/cameras.txt"), format!("1 {model} {} {} {parameters}\n", SIZE[0], SIZE[1]));
        let images: String = (0..9).map(|i| format!("{} 1 0 0 0 {i} 0 0 1 {i}.png\n5 6 -1\n", i + 1)).collect();
        write(scene.join("sparse/0/images.txt"), images);
        write(scene.join("sparse/0/points3D.txt"), "# points\n7 1 2 3 10 20 30 0.5 1 0\n");
        // The photo: each pixel's direction by fixed-point inversion of the lens.
        let photo = |u: f64, v: f64| {
            let (mut x, mut y) = (0.0, 0.0);
            for _ in 0..200 {
                let [a, b] = project(x, y);
                (x, y) = (x - 0.7 * (a - u) / 90.0, y - 0.7 * (b - v) / 90.0);
            }
            sky(x, y)
        };
        for i in 0..9 {
            picture(scene.join(format!("images/{i}.png")), SIZE, photo);
        }
        let d = load(scene);
        assert_eq!((d.kind, counts(&d), d.time_range), (DatasetKind::Colmap, [7, 2, 0], [0.125, 0.875]));
        assert_eq!(d.points.as_ref().unwrap().colour, [[10, 20, 30]]);
        let view = &d.train[0];
        let pixels = view.image.decode().unwrap();
        assert_eq!(view.image.lens.is_none(), model.ends_with("PINHOLE"), "{model}");
        let c = &view.camera;
        let mut worst = 0.0f64;
        for y in 6..SIZE[1] - 6 {
            for x in 8..SIZE[0] - 8 {
                let expected = sky((f64::from(x) + 0.5 - c.cx) / c.fx, (f64::from(y) + 0.5 - c.cy) / c.fy);
                let found = pixels.at(x, y).unwrap();
                (0..3).for_each(|k| worst = worst.max((f64::from(found[k]) * 255.0 - expected[k]).abs()));
            }
        }
        assert!(worst < 2.0, "{model}: {worst}");
        if model == "OPENCV" {
            assert!(d.decisions.iter().any(|l| l.starts_with("undistortion: of 9 of 9")), "{:?}", d.decisions);
        }
    }
}

#[test]
fn colmap_times_come_from_a_list_a_number_or_the_order() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path();
    write(scene.join("cameras.txt"), "1 PINHOLE 8 8 10 10 4 4\n");
    let build = |names: &[&str]| {
        let line = |n: &&str| format!("1 1 0 0 0 0 0 0 1 {n}\n\n");
        write(scene.join("images.txt"), names.iter().map(line).collect::<String>());
        names.iter().for_each(|n| picture(scene.join("images").join(n), [8, 8], |_, _| [9.0; 3]));
        let options = DatasetOptions { split: SplitRule::All, ..DatasetOptions::default() };
        dataset::load(scene, &options).map(|d| d.train.iter().map(|v| v.time).collect::<Vec<_>>())
    };
    assert_eq!(build(&["cam0_010.png", "cam1_010.png", "cam0_030.png", "cam1_020.png"]).unwrap(), [0.0, 1.0, 0.0, 0.5]);
    assert_eq!(build(&["a.png", "c.png", "b.png"]).unwrap(), [0.0, 0.5, 1.0]);
    write(scene.join("times.txt"), "# t\n0.25\n0.5\n4\n");
    assert_eq!(build(&["a.png", "c.png", "b.png"]).unwrap(), [0.25, 0.5, 4.0]);
    assert!(build(&["a.png", "c.png"]).unwrap_err().to_string().contains("times.txt: at number of times: found 3"));
    write(scene.join("times.json"), "{\"a\":1,\"c.png\":3}");
    assert_eq!(build(&["a.png", "c.png"]).unwrap(), [1.0, 3.0]);
    assert!(build(&["a.png", "b.png"]).unwrap_err().to_string().contains("image `b.png`"));
    write(scene.join("times.json"), "[1,NaN]");
    assert!(build(&["a.png", "c.png"]).unwrap_err().to_string().contains("times.json: at entry 1"));
}
