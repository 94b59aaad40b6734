//! Runs of `spgs train`, in this process and in others.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

use clap::Parser as _;
use engine::data::dataset::{self, Dataset, DatasetOptions};
use engine::error::Result;
use engine::gpu::Gpu;
use engine::scene::Scene;
use engine::train::checkpoint::Checkpoint;
use engine::train::config::{Config, Preset};
use engine::train::start;
use engine::train::trainer::{Trainer, TrainingData};
use serde_json::Value;
pub use tests_harness::posed::{Posed, PosedOptions};
use tools::cli::args::Cli;

/// A short run of every part of the method: superpoints from iteration 20, density control every 10 iterations. Network F
/// is small; what is about time or quality gives it the paper's size.
pub const SHORT: &str = "
iterations = 40
deterministic = true
[schedule]
scale = false
warm_up = 20
sh_degree_interval = 10
[gaussians]
sh_degree = 1
random_points = 120
[motion]
superpoints = 8
neighbors = 3
association_slots = 4
network_layers = 3
network_width = 64
[density]
from = 5
until = 35
interval = 10
opacity_reset_interval = 25
gradient_threshold = 6e-4
unseen_interval = 3
[log]
evaluate_interval = 0
interval = 1
checkpoint_interval = 5
finite_interval = 10
";

/// A configuration: these values over [`SHORT`].
pub fn config(over: &str) -> Config {
    let mut base: toml_like::Table = toml_like::parse(SHORT);
    base.extend(toml_like::parse(over));
    Config::parse(&toml_like::text(&base), Preset::Dnerf, Path::new("test")).unwrap()
}

/// Writes [`config`] to a file in `folder`.
pub fn config_file(folder: &Path, over: &str) -> PathBuf {
    let path = folder.join("run.toml");
    std::fs::write(&path, config(over).to_toml().unwrap()).unwrap();
    path
}

/// `key = value` lines under their tables: enough to lay one configuration over another.
mod toml_like {
    use std::collections::BTreeMap;
    use std::fmt::Write as _;

    /// (table, key) → value.
    pub type Table = BTreeMap<(String, String), String>;

    pub fn parse(text: &str) -> Table {
        let mut table = String::new();
        let mut all = Table::new();
        for line in text.lines().map(str::trim).filter(|l| !l.is_empty()) {
            if let Some(name) = line.strip_prefix('[') {
                table = name.trim_end_matches(']').into();
            } else {
                let (key, value) = line.split_once('=').unwrap();
                all.insert((table.clone(), key.trim().into()), value.trim().into());
            }
        }
        all
    }

    pub fn text(all: &Table) -> String {
        let (mut text, mut current) = (String::new(), "");
        for ((table, key), value) in all {
            if table != current {
                let _ = writeln!(text, "[{table}]");
                current = table;
            }
            let _ = writeln!(text, "{key} = {value}");
        }
        text
    }
}

/// The device of this process; kernels are compiled once for all tests that share it.
pub fn gpu() -> SharedGpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    SharedGpu(GPU.get_or_init(|| Gpu::clone(&tests_harness::gpu())).clone())
}

/// A device whose validation messages must be empty when a test is over.
#[derive(Debug)]
pub struct SharedGpu(Gpu);

impl std::ops::Deref for SharedGpu {
    type Target = Gpu;
    fn deref(&self) -> &Gpu {
        &self.0
    }
}

impl Drop for SharedGpu {
    fn drop(&mut self) {
        let messages = self.0.take_validation_messages();
        assert!(messages.is_empty() || std::thread::panicking(), "{messages:?}");
    }
}

/// A rendered data set.
pub fn posed(options: &PosedOptions) -> Posed {
    Posed::new(&gpu(), options)
}

/// A loaded data set.
pub fn load(posed: &Posed) -> (Dataset, TrainingData) {
    let data = dataset::load(posed.path(), &DatasetOptions::default()).unwrap();
    let training = TrainingData { views: data.train.clone().into(), extent: data.extent, is_static: data.is_static };
    (data, training)
}

/// A trainer from random points.
pub fn trainer(gpu: &Gpu, config: &Config, data: &TrainingData) -> Result<Trainer> {
    Trainer::new(gpu, config, data, &start::first(config, None).0)
}

/// Steps until `iteration`.
pub fn advance(trainer: &mut Trainer, iteration: u64) -> Result<()> {
    while trainer.iteration() < iteration {
        trainer.step()?;
    }
    Ok(())
}

/// The scene of a run that goes through density control, is saved, resumed and goes on: with the same bits as one that was not
/// interrupted, and read back as it was written.
pub fn scene_of_resumed_run(over: &str) -> Scene {
    let posed = posed(&PosedOptions::default());
    let (_, data) = load(&posed);
    let gpu = gpu();
    let mut whole = trainer(&gpu, &config(over), &data).unwrap();
    let before = whole.gaussians();
    advance(&mut whole, 23).unwrap();
    assert_ne!(whole.gaussians(), before, "density control ran");
    let folder = tempfile::tempdir().unwrap();
    let saved = Checkpoint::load(&whole.checkpoint().unwrap().save(folder.path()).unwrap()).unwrap();
    let mut resumed = Trainer::resume(&gpu, &data, &saved).unwrap();
    for trainer in [&mut whole, &mut resumed] {
        advance(trainer, 40).unwrap();
    }
    assert!(bytes(&whole.checkpoint().unwrap()) == bytes(&resumed.checkpoint().unwrap()));
    let scene = whole.scene().unwrap();
    let path = folder.path().join("model.safetensors");
    engine::file::model::write(&path, &scene).unwrap();
    assert_eq!(engine::file::model::read(&path).unwrap().0, scene);
    scene
}

/// Bits of everything in a checkpoint.
pub fn bytes(checkpoint: &Checkpoint) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::read(checkpoint.save(folder.path()).unwrap()).unwrap()
}

/// Environment variable that makes a test process a `spgs` process: its arguments, one per line.
const ARGUMENTS: &str = "SPGS_TEST_ARGUMENTS";

/// The body of `spgs`; does nothing in an ordinary test run.
#[test]
fn spgs_process() {
    let Ok(arguments) = std::env::var(ARGUMENTS) else { return };
    let code = tools::cli::output::run_main("spgs", move || {
        let cli = Cli::try_parse_from(std::iter::once("spgs").chain(arguments.lines())).unwrap();
        tools::command::run(&cli)
    });
    std::process::exit((0..=9).find(|&k| code == std::process::ExitCode::from(k)).unwrap_or(1).into());
}

/// `spgs` with these arguments as a process of its own.
pub fn spgs(arguments: &[&str]) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "common::spgs_process", "--nocapture", "--test-threads=1"]);
    command.env(ARGUMENTS, arguments.join("\n")).stdin(Stdio::null());
    command
}

/// `spgs train DATA --out OUT MORE`.
pub fn train(posed: &Posed, out: &Path, more: &[&str]) -> Command {
    let mut arguments = vec!["train", posed.path().to_str().unwrap(), "--out", out.to_str().unwrap()];
    arguments.extend(more);
    spgs(&arguments)
}

/// Runs to the end; standard error and exit code. The validation layer must have said nothing.
pub fn outcome(mut command: Command) -> (i32, String) {
    let Output { status, stdout, stderr } = command.output().unwrap();
    let text = format!("{}{}", String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    assert!(!text.contains("validation layer"), "{text}");
    (status.code().unwrap_or(-1), text)
}

/// Runs to the end, which must be a good one.
pub fn succeed(command: Command) -> String {
    let (code, text) = outcome(command);
    assert_eq!(code, 0, "{text}");
    text
}

/// The checkpoints of a run, oldest first.
pub fn checkpoints(out: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(out.join("checkpoints")) else { return Vec::new() };
    let mut all: Vec<PathBuf> = entries.map(|e| e.unwrap().path()).collect();
    all.retain(|p| p.extension().is_some_and(|e| e == "safetensors"));
    all.sort();
    all
}

/// Bytes of the newest checkpoint of a run.
pub fn newest(out: &Path) -> Vec<u8> {
    std::fs::read(checkpoints(out).pop().unwrap()).unwrap()
}

/// The lines of a run's log.
pub fn log(out: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(out.join("run.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{line}: {e}"))).collect()
}
