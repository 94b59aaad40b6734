//! `--deterministic`: the same bits in every process.

use serde_json::Value;

use crate::common::{PosedOptions, config_file, log, newest, posed, succeed, train};

/// 200 steps: warm-up, superpoints, motion, growth, pruning, opacity resets; what the photos hardly show.
const LONG: &str = "
iterations = 200
[schedule]
warm_up = 150
sh_degree_interval = 60
[density]
from = 20
until = 195
interval = 20
opacity_reset_interval = 90
gradient_threshold = 1e-4
min_opacity = 0.02
unseen_interval = 5
unseen_share = 0.02
[motion]
network_layers = 8
network_width = 256
[log]
checkpoint_interval = 0
";

#[test]
fn two_hundred_steps_give_the_same_bits_in_every_process() {
    let posed = posed(&PosedOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let config = config_file(folder.path(), LONG);
    let run = |name: &str, threads: Option<&str>| {
        let out = folder.path().join(name);
        let mut command = train(&posed, &out, &["--config", config.to_str().unwrap(), "--deterministic"]);
        // The layer has seen the first run of the same commands.
        threads.into_iter().for_each(|n| {
            command.env("LP_NUM_THREADS", n).env_remove("SPGS_VALIDATION");
        });
        succeed(command);
        (newest(&out), log(&out))
    };
    let (first, lines) = run("first", None);
    let sum = |key: &str| lines.iter().filter_map(|l| l["density"][key].as_u64()).sum::<u64>();
    for key in ["cloned", "split", "pruned", "unseen"] {
        assert!(sum(key) > 0, "the run covers no `{key}`");
    }
    let passes_of_motion =
        lines.iter().filter(|l| l["density"]["cloned"].is_number() && l["iteration"].as_u64() >= Some(150)).count();
    assert!(passes_of_motion >= 2, "density control with motion");
    assert!(lines.iter().any(|l| l["density"]["opacity_reset"] == Value::Bool(true)));
    assert!(lines.iter().any(|l| l["superpoints"].as_u64() == Some(8)));
    assert!(run("second", None).0 == first, "another process: other bits");
    assert!(run("one thread", Some("0")).0 == first, "on one thread: other bits");
}
