//! Numbers that went bad end the run, by name.

use engine::error::Error;
use engine::scene::Linear;
use engine::train::checkpoint::Checkpoint;
use engine::train::trainer::Trainer;

use crate::common::{
    PosedOptions, advance, checkpoints, config, config_file, gpu, load, outcome, posed, succeed, train, trainer,
};

/// Puts a value somewhere and says what the error must name: buffer and index.
type Spoil = (&'static str, usize, fn(&mut Checkpoint, f32));

/// Puts a value into an array of the model of motion.
fn put(checkpoint: &mut Checkpoint, array: &str, at: usize, value: f32) {
    let mut values = checkpoint.saved.floats(array, None).unwrap();
    values[at] = value;
    checkpoint.saved.put_floats(array, vec![values.len()], &values);
}

fn spoils() -> Vec<Spoil> {
    vec![
        ("mean", 0, |c, v| c.parameters.gaussians.mean[0][0] = v),
        ("log_scale", 3, |c, v| c.parameters.gaussians.log_scale[3][0] = v),
        ("rotation", 4 * 2 + 1, |c, v| c.parameters.gaussians.rotation[2][1] = v),
        ("opacity_logit", 5, |c, v| c.parameters.gaussians.opacity_logit[5] = v),
        ("sh_0", 0, |c, v| c.parameters.gaussians.sh[0] = v),
        ("optional", 0, |c, v| *c.parameters.gaussians.optional.numbers_mut().next().unwrap() = v),
        ("moment_1", 7, |c, v| c.parameters.moment_1[7] = v),
        ("moment_2", 8, |c, v| c.parameters.moment_2[8] = v),
        ("density", 2, |c, v| c.parameters.density[2] = v),
        ("max_radius", 1, |c, v| c.parameters.max_radius[1] = v),
        ("association logit", 6, |c, v| put(c, "logit", 6, v)),
        ("association moment_1", 6, |c, v| put(c, "logit_moment_1", 6, v)),
        ("association moment_2", 9, |c, v| put(c, "logit_moment_2", 9, v)),
        ("superpoint position", 3, |c, v| put(c, "superpoint_position", 3, v)),
        ("network F weight", 0, |c, v| put(c, "network_f.weights", 0, v)),
        ("network F moment_1", 0, |c, v| put(c, "network_f.moment_1", 0, v)),
        ("network F moment_2", 0, |c, v| put(c, "network_f.moment_2", 0, v)),
        ("network G weight", 0, |c, v| put(c, "network_g.weights", 0, v)),
        ("network G moment_1", 0, |c, v| put(c, "network_g.moment_1", 0, v)),
        ("network G moment_2", 0, |c, v| put(c, "network_g.moment_2", 0, v)),
    ]
}

#[test]
fn a_bad_number_anywhere_is_named() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let optional = "[gaussians]\noptional = [\"lifespan\"]";
    let rest = "[schedule]\nwarm_up = 2\n[density]\nenabled = false\n[log]\nfinite_interval = 1";
    let config = config(&format!("{optional}\n{rest}"));
    let mut rigid = trainer(&gpu, &config, &data).unwrap();
    advance(&mut rigid, 3).unwrap();
    let rigid = rigid.checkpoint().unwrap();
    let mut stage = Trainer::nonrigid(&gpu, &config, &data, &rigid).unwrap();
    advance(&mut stage, 1).unwrap();
    let nonrigid = stage.checkpoint().unwrap();
    for (i, (name, index, place)) in spoils().into_iter().enumerate() {
        let good = if name.starts_with("network G") { &nonrigid } else { &rigid };
        let mut bad = good.clone();
        place(&mut bad, [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][i % 3]);
        let mut trainer = Trainer::resume(&gpu, &data, &bad).unwrap();
        // It must be no checkpoint, neither before the next step nor after.
        let refused = trainer.checkpoint().unwrap_err();
        match &refused {
            Error::NonFinite { what, index: found, .. } => {
                let iteration = format!("at iteration {}", good.iteration);
                assert!(what.starts_with(name) && what.contains(&iteration), "{name}: {what}");
                assert_eq!(*found, index, "{name}");
            }
            other => panic!("{name}: {other}"),
        }
        match trainer.step() {
            Err(Error::NonFinite { what, .. }) => {
                assert!(what.contains(&format!("at iteration {}", good.iteration + 1)), "{name}: {what}");
            }
            other => panic!("{name}: {other:?}"),
        }
    }
}

/// Every weight stays finite, but neuron 0 of the second layer overflows, and the third layer multiplies it by 0.
fn overflow(layers: &mut [Linear]) {
    layers[0].bias[0] = 3e38;
    let inputs = layers[1].inputs;
    layers[1].weight.iter_mut().step_by(inputs).for_each(|w| *w = 0.0);
    layers[1].weight[0] = 10.0;
    let inputs = layers[2].inputs;
    layers[2].weight.iter_mut().step_by(inputs).for_each(|w| *w = 0.0);
}

#[test]
fn a_network_that_overflows_ends_the_run() {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let config = config("[schedule]\nwarm_up = 2\n[density]\nenabled = false\n[log]\nfinite_interval = 0");
    let mut rigid = trainer(&gpu, &config, &data).unwrap();
    advance(&mut rigid, 3).unwrap();
    let mut rigid = rigid.checkpoint().unwrap();
    let mut nonrigid = Trainer::nonrigid(&gpu, &config, &data, &rigid).unwrap();
    advance(&mut nonrigid, 1).unwrap();
    let mut nonrigid = nonrigid.checkpoint().unwrap();

    let mut state = rigid.saved.network("network_f").unwrap();
    let mut network = state.deform(config.motion.network_size()).unwrap();
    overflow(&mut network.linear);
    state.weights = network.flatten();
    rigid.saved.put_network("network_f", &state);
    let mut state = nonrigid.saved.network("network_g").unwrap();
    let mut network = state.nonrigid().unwrap();
    overflow(&mut network.linear);
    state.weights = network.flatten();
    nonrigid.saved.put_network("network_g", &state);

    for (name, checkpoint) in [("network F", &rigid), ("network G", &nonrigid)] {
        match Trainer::resume(&gpu, &data, checkpoint).unwrap().step() {
            Err(Error::NonFinite { what, .. }) => assert!(what.starts_with(name), "{name}: {what}"),
            other => panic!("{name}: {other:?}"),
        }
    }
}

#[test]
fn the_last_good_checkpoint_stays() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let config = config_file(folder.path(), "iterations = 20\n[schedule]\nwarm_up = 100");
    let config = config.to_str().unwrap();
    succeed(train(&posed, &out, &["--config", config]));
    let all = checkpoints(&out);
    let good = std::fs::read(&all[0]).unwrap();
    all[1..].iter().for_each(|p| std::fs::remove_file(p).unwrap());
    let mut bad = Checkpoint::load(&all[0]).unwrap();
    let iteration = bad.iteration;
    assert!(iteration < 20);
    bad.iteration += 1;
    // The mean that this moment belongs to is what the step cannot update.
    bad.parameters.moment_2[4] = f32::NAN;
    bad.save(&out.join("checkpoints")).unwrap();
    let (code, text) = outcome(train(&posed, &out, &["--resume"]));
    assert_eq!(code, 6, "{text}");
    assert!(text.contains("mean at iteration") && text.contains("[4] is"), "{text}");
    let left = checkpoints(&out);
    assert_eq!(left.len(), 2, "no checkpoint was written: {left:?}");
    assert!(std::fs::read(&left[0]).unwrap() == good, "the good checkpoint stays");
}
