//! What a run leaves: the model that is played back, the log and the report.

use engine::reference::{exp, network_poses, rotation_of_quaternion, table_poses};
use engine::scene::{Camera, Scene};
use engine::train::checkpoint::Checkpoint;
use engine::train::export::export;
use engine::train::trainer::{Trainer, TrainingData};
use glam::DVec3;

use crate::common::{
    Posed, PosedOptions, SharedGpu, advance, config, config_file, gpu, load, log, posed, succeed, train, trainer,
};

/// A trained moving scene: its checkpoint, data and cameras.
fn trained(over: &str) -> (SharedGpu, Checkpoint, TrainingData, Vec<Camera>, Posed) {
    let posed = posed(&PosedOptions { train: 12, swing: 0.5, ..PosedOptions::default() });
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config(&format!("iterations = 60\n[schedule]\nwarm_up = 10\n[density]\nenabled = false\n{over}"));
    let mut trainer = trainer(&gpu, &config, &data).unwrap();
    advance(&mut trainer, 60).unwrap();
    let checkpoint = trainer.checkpoint().unwrap();
    let cameras = data.views.iter().map(|v| Camera { time: v.time, ..v.camera.clone() }).collect();
    (gpu, checkpoint, data, cameras, posed)
}

/// Pixel of a point, if it is in front of the camera and in the image.
fn pixel(c: &Camera, x: DVec3) -> Option<(f64, f64)> {
    let p = c.rotation * (x - c.position);
    let (u, v) = (c.fx * p.x / p.z + c.cx, c.fy * p.y / p.z + c.cy);
    let inside = u > 0.0 && v > 0.0 && u < f64::from(c.width) && v < f64::from(c.height);
    (p.z > 0.2 && inside).then_some((u, v))
}

/// Largest distance, on the training cameras at their times, between what the table and what network F say of the centres
/// and of the points two standard deviations along the longest axes; and how far the network moves anything at all.
fn table_error(scene: &Scene, cameras: &[Camera]) -> (f64, f64) {
    let (g, superpoints) = (&scene.gaussians, scene.deformation.superpoints().unwrap());
    let (motion, network) = (scene.deformation.table().unwrap(), scene.deformation.network().unwrap());
    let start = network_poses(network, &superpoints.position, cameras[0].time);
    let (mut error, mut moved) = (0.0_f64, 0.0_f64);
    for c in cameras {
        let exact = network_poses(network, &superpoints.position, c.time);
        let table = table_poses(motion, c.time);
        for i in 0..g.len() {
            let j = superpoints.of_gaussian[i] as usize;
            let mean = DVec3::from_array(g.mean[i].map(f64::from));
            let scale = g.log_scale[i].map(|s| f64::from(s).exp());
            let longest =
                if scale[0] >= scale[1] && scale[0] >= scale[2] { 0 } else { 1 + usize::from(scale[2] > scale[1]) };
            let end = mean + 2.0 * scale[longest] * rotation_of_quaternion(g.rotation[i].map(f64::from)).col(longest);
            for x in [mean, end] {
                let place = |p: &engine::reference::Pose| exp(p.rotation) * x + p.translation;
                let distance = |a: DVec3, b: DVec3| match (pixel(c, a), pixel(c, b)) {
                    (Some(a), Some(b)) => (a.0 - b.0).hypot(a.1 - b.1),
                    _ => 0.0,
                };
                error = error.max(distance(place(&exact[j]), place(&table[j])));
                moved = moved.max(distance(place(&exact[j]), place(&start[j])));
            }
        }
    }
    (error, moved)
}

#[test]
fn the_key_time_table_is_within_its_bound() {
    let (gpu, checkpoint, data, cameras, _posed) = trained("[motion]\nnetwork_layers = 8\nnetwork_width = 256");
    let mut keys = Vec::new();
    for bound in [0.01, 0.5] {
        let mut kept = checkpoint.clone();
        (kept.config.export.keep_network, kept.config.export.motion_error_px) = (true, bound);
        let trainer = Trainer::resume(&gpu, &data, &kept).unwrap();
        let exported = export(&gpu, &trainer, &cameras).unwrap();
        // Everything that is kept is a model file.
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("kept.safetensors");
        engine::file::save(&file, &exported.scene).unwrap();
        assert_eq!(engine::file::load(&file).unwrap().scene.deformation, exported.scene.deformation);
        let (error, moved) = table_error(&exported.scene, &cameras);
        let said = exported.decisions.iter().find(|d| d.contains("largest error")).unwrap();
        assert!(moved > 1.0, "nothing moves: {moved:.3} px");
        // The table is made of f32 poses of the device.
        assert!(error <= bound + 2e-3, "{error:.4} px, bound {bound}: {said}");
        keys.push(exported.scene.deformation.key_times().len());
    }
    assert!(keys[1] < keys[0], "the fewest keys: {keys:?}");
    // Without the network the same table is left.
    let trainer = Trainer::resume(&gpu, &data, &checkpoint).unwrap();
    let scene = export(&gpu, &trainer, &cameras).unwrap().scene;
    assert!(
        scene.deformation.network().is_none()
            && scene.deformation.association().is_none()
            && scene.deformation.table().is_some()
    );
}

#[test]
fn what_shows_nothing_is_left_out() {
    let (gpu, mut checkpoint, data, cameras, _posed) = trained("[learning_rate]\nsh_rest = 0");
    checkpoint.parameters.gaussians.opacity_logit[3] = -12.0;
    checkpoint.parameters.gaussians.opacity_logit[70] = -5.6;
    let trainer = Trainer::resume(&gpu, &data, &checkpoint).unwrap();
    let before = checkpoint.parameters.gaussians.opacity_logit.iter().filter(|l| **l >= -(254.0_f32.ln())).count();
    let exported = export(&gpu, &trainer, &cameras).unwrap();
    assert!(before <= 118 && exported.scene.gaussians.len() == before, "{before}: {:?}", exported.decisions);
    assert_eq!(exported.scene.deformation.superpoints().unwrap().of_gaussian.len(), before);
    assert_eq!(exported.scene.gaussians.sh_degree, 0, "colours do not depend on the view: {:?}", exported.decisions);
    assert!(exported.decisions.iter().any(|d| d.contains("opacity below 1/255")));
    // Colours that do depend on it keep their degree.
    checkpoint.parameters.gaussians.sh.iter_mut().skip(5).step_by(7).for_each(|v| *v += 0.3);
    let trainer = Trainer::resume(&gpu, &data, &checkpoint).unwrap();
    let exported = export(&gpu, &trainer, &cameras).unwrap();
    assert_eq!(exported.scene.gaussians.sh_degree, 1, "{:?}", exported.decisions);
}

#[test]
fn the_log_and_the_report_have_what_they_promise() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let config = config_file(folder.path(), "[log]\nevaluate_interval = 15");
    let text = succeed(train(&posed, &out, &["--config", config.to_str().unwrap()]));
    assert!(text.contains("PSNR") && text.contains("export"), "{text}");
    let lines = log(&out);
    let steps: Vec<_> = lines.iter().filter(|l| l["loss"].is_number()).collect();
    assert_eq!(steps.len(), 40);
    for (i, line) in steps.iter().enumerate() {
        assert_eq!((line["iteration"].as_u64(), line["stage"].as_str()), (Some(i as u64 + 1), Some("rigid")));
        for key in ["seconds", "loss", "l1", "ssim", "psnr", "gaussians", "superpoints", "visible", "instances"]
            .iter()
            .chain(&["view", "device_bytes", "iterations_per_second"])
        {
            assert!(line[key].as_f64().is_some_and(f64::is_finite), "{key}: {line}");
        }
        for key in ["position", "rotation", "translation"] {
            assert!(line["property"][key].as_f64().is_some_and(f64::is_finite), "{key}: {line}");
        }
        let kernels = line["kernel_ms"].as_object().unwrap();
        assert!(kernels.values().all(|ms| ms.as_f64().is_some_and(|v| v >= 0.0)), "{line}");
    }
    let last = steps[39]["kernel_ms"].as_object().unwrap();
    for kernel in ["deform_project", "blend", "deform_project_backward"] {
        assert!(last.keys().any(|k| k.starts_with(kernel)), "{kernel}: {last:?}");
    }
    let evaluations: Vec<_> = lines.iter().filter(|l| l["evaluation"].is_object()).collect();
    assert_eq!(evaluations.iter().map(|l| l["iteration"].as_u64().unwrap()).collect::<Vec<_>>(), [15, 30, 40]);
    assert!(evaluations.iter().all(|l| l["evaluation"]["psnr"].as_f64().is_some_and(|p| p > 5.0)));
    let report = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.matches("<svg").count() >= 4, "charts");
    let mut images = 0;
    for part in report.split("src=\"").skip(1) {
        let name = part.split('"').next().unwrap();
        let image = image::open(out.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!([image.width(), image.height()], [32, 24], "{name}");
        images += 1;
    }
    assert_eq!(images, 4, "two test views beside their photos");
    for file in ["config.toml", "model.safetensors"] {
        assert!(out.join(file).is_file(), "{file}");
    }
}
