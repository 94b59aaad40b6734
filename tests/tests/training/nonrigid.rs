//! `--nonrigid`: network G on top of a trained model.

use crate::common::{PosedOptions, checkpoints, config_file, gpu, log, newest, outcome, posed, spgs, succeed, train};

#[test]
fn the_stage_learns_is_resumed_and_is_rendered_as_evaluated() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let (whole, cut) = (folder.path().join("whole"), folder.path().join("cut"));
    let over = "iterations = 30\n[schedule]\nwarm_up = 15\n[nonrigid]\niterations = 12\ndensity_until = 6\n[density]\ninterval = 3\n[log]\ncheckpoint_interval = 4";
    let config = config_file(folder.path(), over);
    let config = config.to_str().unwrap();
    for out in [&whole, &cut] {
        succeed(train(&posed, out, &["--config", config]));
    }
    succeed(train(&posed, &whole, &["--nonrigid"]));
    let stage: Vec<f64> = log(&whole)
        .iter()
        .filter(|l| l["stage"] == "nonrigid" && l["loss"].is_number())
        .map(|l| l["loss"].as_f64().unwrap())
        .collect();
    assert_eq!(stage.len(), 12);

    // Cut off within the stage: the newest checkpoints are taken away.
    succeed(train(&posed, &cut, &["--nonrigid"]));
    let all = checkpoints(&cut);
    assert_eq!(all.len(), 3);
    all[1..].iter().for_each(|p| std::fs::remove_file(p).unwrap());
    succeed(train(&posed, &cut, &["--resume", "--nonrigid"]));
    assert!(newest(&cut) == newest(&whole), "resumed within the stage: other bits");

    let path = whole.join("model.safetensors");
    let scene = engine::file::load(&path).unwrap().scene;
    assert!(scene.deformation.nonrigid().is_some());
    let file = std::fs::read(&path).unwrap();
    assert!(String::from_utf8_lossy(&file[..4000]).contains("nonrigid."), "tensors nonrigid.*");
    let pictures = folder.path().join("pictures");
    let data = posed.path().to_str().unwrap();
    // Training evaluates with the exact settings.
    let arguments =
        ["render", path.to_str().unwrap(), "--cameras", data, "--split", "test", "--quality", "exact", "--out"];
    let (code, text) = outcome(spgs(&[&arguments[..], &[pictures.to_str().unwrap()]].concat()));
    assert_eq!(code, 0, "{text}");
    let open = |p: std::path::PathBuf| image::open(&p).unwrap_or_else(|e| panic!("{}: {e}", p.display())).to_rgb8();
    for i in 0..2 {
        let evaluated = open(whole.join(format!("images/{i:05}_rendered.png")));
        let rendered = open(pictures.join(format!("{i:05}.png")));
        assert!(evaluated == rendered, "view {i}");
    }
}

#[test]
fn the_loss_falls() {
    use crate::common::{advance, config, load, trainer};
    use engine::train::trainer::Trainer;
    let posed = posed(&PosedOptions { train: 4, test: 0, ..PosedOptions::default() });
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config(
        "[schedule]\nwarm_up = 10\n[density]\nenabled = false\n[learning_rate]\nmean = 0\nmean_final = 0\nlog_scale = 0\nrotation = 0\nopacity_logit = 0\nsh_0 = 0\nsh_rest = 0\n[nonrigid]\niterations = 40",
    );
    let mut rigid = trainer(&gpu, &config, &data).unwrap();
    advance(&mut rigid, 12).unwrap();
    // Only network G learns here: no other rate is above zero.
    let mut stage = Trainer::nonrigid(&gpu, &config, &data, &rigid.checkpoint().unwrap()).unwrap();
    let mut losses = Vec::new();
    while !stage.is_done() {
        losses.push(stage.step().unwrap().loss);
    }
    let mean = |l: &[f64]| l.iter().sum::<f64>() / l.len() as f64;
    let (first, last) = (mean(&losses[..4]), mean(&losses[36..]));
    assert!(last < 0.985 * first, "loss {first} to {last}");
}
