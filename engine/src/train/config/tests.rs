#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
use super::*;

fn parse(text: &str) -> Result<Config> {
    Config::parse(text, Preset::Dnerf, Path::new("run.toml"))
}

#[test]
fn every_preset_is_valid_and_survives_toml() {
    for preset in Preset::ALL {
        for config in [preset.config(), preset.best()] {
            config.check().unwrap();
            assert_eq!(Config::parse(&config.to_toml().unwrap(), Preset::Dnerf, Path::new("x")).unwrap(), config);
        }
    }
}

#[test]
fn a_file_changes_only_what_it_names() {
    for (spelled, preset) in [("d-nerf", Preset::Dnerf), ("nerf-ds", Preset::Nerfds), ("nerfds", Preset::Nerfds)] {
        assert_eq!(parse(&format!("preset = \"{spelled}\"")).unwrap(), preset.config(), "{spelled}");
    }
    let c = parse("preset = \"hypernerf\"\nseed = 7\n[density]\nuntil = 10000\n").unwrap();
    let expected = Config { seed: 7, ..Preset::Hypernerf.config() };
    assert_eq!(c.density.until, 10_000);
    assert_eq!(Config { density: expected.density.clone(), ..c }, expected);
}

#[test]
fn a_kind_of_data_by_name_means_the_paper_s_values_for_it() {
    let best = Base { preset: Preset::Dnerf, method: Method::Best, is_static: false };
    let read = |text: &str| Config::parse(text, best, Path::new("run.toml")).unwrap();
    assert_eq!(read("seed = 3"), Config { seed: 3, ..Preset::Dnerf.best() });
    assert_eq!(read("preset = \"dnerf\""), Preset::Dnerf.config());
    assert_eq!(read("preset = \"dnerf\"\nmethod = \"best\""), Preset::Dnerf.best());
    assert_eq!(read("method = \"paper\""), Preset::Dnerf.config());
    // Without its key a file of an earlier version is what it was: the paper's.
    assert_eq!(Config::default().method, Method::Paper);
}

#[test]
fn where_nothing_moves_gaussians_grow_no_longer() {
    let base = Base { preset: Preset::Dnerf, method: Method::Best, is_static: true };
    let read = |text: &str, base| Config::parse(text, base, Path::new("run.toml")).unwrap();
    let grows = |c: &Config| [c.density.until, c.density.unseen_interval];
    assert_eq!(grows(&Preset::Dnerf.best()), [25_000, 2500]);
    assert_eq!(grows(&base.config()), [15_000, 5000]);
    assert_eq!(read("seed = 0", base), base.config());
    // A file that switches motion off means the same; its own values hold.
    let moving = Base { is_static: false, ..base };
    assert_eq!(grows(&read("[motion]\nenabled = false", moving)), [15_000, 5000]);
    assert_eq!(grows(&read("[density]\nuntil = 9000", base)), [9000, 5000]);
    assert_eq!(read("method = \"best\"\npreset = \"dnerf\"", base), base.config());
    assert_eq!(read("preset = \"dnerf\"", base), Preset::Dnerf.config());
}

#[test]
fn mistakes_name_file_line_and_key() {
    for (text, wanted) in [
        ("seed = 1\n[density]\nintervall = 3\n", ["run.toml", "line 3", "intervall"]),
        ("seed = 1\nseed = 2\n", ["run.toml", "line 2", "duplicate"]),
        ("iterations = \"many\"", ["run.toml", "line 1", "invalid type"]),
        ("preset = \"nerf\"", ["run.toml", "nerf", "dnerf"]),
        ("[motion]\nneighbors = 0\n", ["motion.neighbors", "0", "1 to 7"]),
        ("[loss]\nlambda_dssim = nan\n", ["loss.lambda_dssim", "NaN", "0 to 1"]),
    ] {
        let message = parse(text).unwrap_err().to_string();
        for part in wanted {
            assert!(message.contains(part), "{text:?}: `{part}` is not in: {message}");
        }
    }
}

#[test]
fn the_schedule_scales_with_the_length_of_the_run() {
    let c = Config { iterations: 4000, ..Config::default() }.scaled();
    assert_eq!([c.schedule.warm_up, c.density.until, c.density.interval], [300, 1500, 100]);
    assert_eq!(c.scaled(), c, "scaling twice is scaling once");
    let mut fixed = Config { iterations: 4000, ..Config::default() };
    fixed.schedule.scale = false;
    assert_eq!(fixed.scaled().schedule.warm_up, 3000);
}

#[test]
fn the_stage_of_network_g_scales_with_the_run_before_it() {
    let run = Config { iterations: 4000, ..Config::default() };
    let length = |c: Config| [c.nonrigid.iterations, c.nonrigid.density_until];
    assert_eq!(length(run.clone()), [20_000, 10_000]);
    assert_eq!(length(run.for_nonrigid(None)), [2000, 1000]);
    assert_eq!(length(run.for_nonrigid(Some(600))), [600, 300]);
    let mut fixed = run;
    fixed.schedule.scale = false;
    assert_eq!(length(fixed.for_nonrigid(None)), [20_000, 10_000]);
}

#[test]
fn shorter_runs_learn_colours_faster() {
    let rates = |iterations, exponent| {
        let mut c = Config { iterations, ..Config::default() };
        c.learning_rate.sh_length_exponent = exponent;
        let scaled = c.scaled();
        assert_eq!(scaled.scaled(), scaled, "scaling twice is scaling once");
        let faster = scaled.learning_rate.sh_0 / c.learning_rate.sh_0;
        assert!((scaled.learning_rate.sh_rest / c.learning_rate.sh_rest - faster).abs() < 1e-9);
        assert_eq!(scaled.learning_rate.opacity_logit, c.learning_rate.opacity_logit);
        faster
    };
    assert!((rates(10_000, 0.5) - 2.0).abs() < 1e-9);
    assert_eq!([rates(10_000, 0.0), rates(40_000, 0.5), rates(80_000, 0.5)], [1.0; 3]);
    assert!(Preset::Dnerf.best().learning_rate.sh_length_exponent > 0.0);
    assert_eq!(Preset::Dnerf.config().learning_rate.sh_length_exponent, 0.0);
}

#[test]
fn rates_decay_log_linearly() {
    assert!((decayed(1e-2, 1e-4, 50, 100) - 1e-3).abs() < 1e-12);
    assert_eq!(decayed(1e-2, 1e-4, 500, 100), decayed(1e-2, 1e-4, 100, 100));
    assert_eq!(decayed(0.0, 1e-4, 5, 10), 0.0);
}
