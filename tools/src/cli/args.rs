//! Arguments of `spgs`.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use engine::render::Quality;
use engine::scene::MotionSource;

use crate::report::paper::Benchmark;

mod convert;
mod render;
mod viewer;

pub use convert::ConvertArgs;
pub use render::{PathArg, RenderArgs};
pub use viewer::ViewerArgs;

/// Renders dynamic 3D Gaussian scenes on Vulkan.
#[derive(Debug, Parser)]
#[command(name = "spgs", version, arg_required_else_help = false)]
pub struct Cli {
    /// What holds for every subcommand.
    #[command(flatten)]
    pub global: Global,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// Options of every subcommand.
#[derive(Debug, Clone, Args)]
pub struct Global {
    /// Vulkan device: its index in `spgs devices` or part of its name [default: the fastest kind; also SPGS_DEVICE]
    #[arg(long, global = true, value_name = "N|NAME")]
    pub device: Option<String>,
    /// Test the device again before it is used, whatever is known of it (SPGS_SELF_TEST=0: never test it)
    #[arg(long, global = true)]
    pub self_test: bool,
    /// No progress and no report on the terminal; warnings and errors only
    #[arg(long, short, global = true)]
    pub quiet: bool,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Render a built-in moving scene; print FPS, kernel times and where the pictures are
    Demo(DemoArgs),
    /// Reconstruct a moving scene from posed images
    Train(TrainArgs),
    /// Render a model along a camera file
    Render(RenderArgs),
    /// Fly through a scene in a window, scrub its time, see what every millisecond goes to
    View(ViewerArgs),
    /// Measure frame and kernel times
    Bench(BenchArgs),
    /// Compare two pictures, or the pictures of two folders: PSNR, SSIM, MS-SSIM, FLIP, LPIPS
    Compare(CompareArgs),
    /// Score a model on the held-out views of a data set, beside the paper's figures
    Eval(EvalArgs),
    /// Write a model in another format, whole, at a time, or as a sequence over time; say what that cost
    Convert(ConvertArgs),
    /// Say what is in a model file or a data set
    Inspect(InspectArgs),
    /// List the Vulkan devices and what they lack
    Devices(DevicesArgs),
}

/// `spgs demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for the pictures
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    pub out: PathBuf,
    /// Number of pictures over t = 0 to 1
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub frames: u32,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `spgs train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// Data set: a folder with transforms_train.json, dataset.json, poses_bounds.npy, precomputed.json or a COLMAP model
    #[arg(required_unless_present = "print_config")]
    pub data: Option<PathBuf>,
    /// Folder for everything the run writes: model.safetensors, config.toml, run.jsonl, report.html, images/, checkpoints/
    #[arg(long, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// Length of the run; the schedule scales with it [default: the configuration's, 40000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    pub iterations: Option<u64>,
    /// Values of the paper for a kind of data [default: by the data set's format]
    #[arg(long, value_enum)]
    pub preset: Option<PresetArg>,
    /// Hyper-parameters that differ from the preset (see --print-config)
    #[arg(long, value_name = "F.toml")]
    pub config: Option<PathBuf>,
    /// Print the whole configuration as TOML and stop
    #[arg(long)]
    pub print_config: bool,
    /// Go on from the newest checkpoint in DIR, with its configuration
    #[arg(long, conflicts_with_all = ["config", "preset", "init"])]
    pub resume: bool,
    /// Images are averaged down by this factor [default: the data set's rule, mostly 1]
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// The same bits on every run: no float atomics, fixed orders of sums
    #[arg(long)]
    pub deterministic: bool,
    /// Train the non-rigid network G on top of the trained model in DIR
    #[arg(long)]
    pub nonrigid: bool,
    /// First Gaussians: a model (.safetensors or 3DGS .ply) [default: the data set's points, or random ones]
    #[arg(long, value_name = "FILE")]
    pub init: Option<PathBuf>,
    /// Train as a static scene, without superpoints
    #[arg(long)]
    pub no_motion: bool,
    /// Seed of every random choice
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Watch: opens `spgs view` on DIR, which shows the scene anew with every checkpoint
    #[arg(long)]
    pub view: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `--preset`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PresetArg {
    /// Synthetic scenes with exact cameras and times.
    Dnerf,
    /// Hand-held captures.
    Hypernerf,
    /// NeRF-DS.
    Nerfds,
    /// NVIDIA Dynamic Scene.
    Nvidia,
}

/// Options of a rendered view.
#[derive(Debug, Clone, Args)]
pub struct ViewArgs {
    /// Colour behind the scene
    #[arg(long, value_name = "R,G,B", default_value = "0,0,0", allow_hyphen_values = true, value_parser = color)]
    pub background: [f32; 3],
    /// Image width [default: the camera's, or in proportion to the height]
    #[arg(long, value_name = "W", value_parser = clap::value_parser!(u32).range(1..=16_384))]
    pub width: Option<u32>,
    /// Image height [default: the camera's, or in proportion to the width]
    #[arg(long, value_name = "H", value_parser = clap::value_parser!(u32).range(1..=16_384))]
    pub height: Option<u32>,
    /// Where the motion comes from [default: the key-time table where the model has one]
    #[arg(long, value_enum)]
    pub motion: Option<MotionArg>,
    /// What may be given up for speed: exact; high: nothing that is visible; fast: a few levels of 255 in places
    #[arg(long, value_name = "exact|high|fast", default_value = "high", value_parser = preset)]
    pub quality: Quality,
    /// Single knobs on top of --quality, knob=value,…: cull, alpha_cut, stop, depth_bits, position, sh_degree, sh, colour,
    /// conic, table_step, interpolation, network, nonrigid, resolution
    #[arg(long, value_name = "KNOB=VALUE,…", value_parser = knobs)]
    pub set: Option<String>,
}

impl ViewArgs {
    /// `--quality` with the knobs of `--set`.
    pub fn quality(&self) -> Quality {
        let mut quality = self.quality;
        // The parser has taken the list, so nothing is left to refuse.
        let _ = quality.set_all(self.set.as_deref().unwrap_or_default());
        quality
    }

    /// The engine's name for `--motion`.
    pub fn motion_source(&self) -> MotionSource {
        motion_source(self.motion)
    }
}

/// The engine's name for `--motion`.
pub fn motion_source(motion: Option<MotionArg>) -> MotionSource {
    match motion {
        None => MotionSource::Auto,
        Some(MotionArg::Table) => MotionSource::Table,
        Some(MotionArg::Network) => MotionSource::Network,
    }
}

/// `spgs bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Model: .safetensors, 3DGS .ply, or anything that `spgs convert` reads [default: a synthetic scene]
    #[arg(conflicts_with_all = ["synthetic", "superpoints"])]
    pub model: Option<PathBuf>,
    /// Level of detail of a SOG that has several (lod-meta.json), 0 the finest [default: the finest whose files are all there]
    #[arg(long, value_name = "N", requires = "model")]
    pub level: Option<u32>,
    /// A synthetic scene of N random Gaussians
    #[arg(long, value_name = "N", default_value_t = 120_000, value_parser = clap::value_parser!(u32).range(0..=200_000_000))]
    pub synthetic: u32,
    /// Superpoints that move the synthetic scene; 0: it stands still
    #[arg(long, value_name = "M", default_value_t = 512, value_parser = clap::value_parser!(u32).range(0..=65_536))]
    pub superpoints: u32,
    /// Camera file (transforms*.json), COLMAP folder or data set [default: a view of the whole scene]
    #[arg(long, value_name = "FILE|DATA")]
    pub cameras: Option<PathBuf>,
    /// Part of a data set
    #[arg(long, value_name = "NAME", requires = "cameras")]
    pub split: Option<String>,
    /// The view, counted from 0 in the camera file's order
    #[arg(long, value_name = "I", default_value_t = 0, requires = "cameras")]
    pub frame: usize,
    /// Time of every frame [default: swept over the motion]
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = finite)]
    pub time: Option<f64>,
    /// How the view is drawn
    #[command(flatten)]
    pub view: ViewArgs,
    /// Measured frames, or training steps [default: 100; --sweep 60 on a GPU, 9 on a CPU; --train 20; --train --sweep 3;
    /// drift of --hard-cases 1000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: Option<u32>,
    /// Frames or steps before the measurement [default: 10; --sweep 3; --train 3; --train --sweep 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    pub warmup: Option<u32>,
    /// Measure training steps instead of frames: on the photos of --cameras, from a disturbed copy of MODEL that stands
    /// still; or on photos made of the synthetic scene, with its superpoints, network F and association
    #[arg(long, conflicts_with_all = ["paper_protocol", "check", "time", "frame", "split", "quality", "set"])]
    pub train: bool,
    /// Speed against error of every knob of --set alone, of the presets of --quality, and of combinations: three views of
    /// --cameras (or an orbit), errors against the f64 reference and, where there are photos, against them. It says what it
    /// reduced. With --train: training steps of synthetic scenes of 10k, 100k and 300k Gaussians at 200x200, 400x400 and
    /// 800x800 pixels
    #[arg(long, conflicts_with_all = ["paper_protocol", "check", "frame", "quality", "set"])]
    pub sweep: bool,
    /// Train on --cameras DATA until held-out views reach X dB; iterations per second, time to it, the curve
    #[arg(long, value_name = "X", group = "trains", requires_all = ["train", "cameras"], conflicts_with_all = ["model", "synthetic", "superpoints", "sweep"], value_parser = finite)]
    pub until_psnr: Option<f64>,
    /// The paper's ablations on a data set, one training run per setting, beside the paper's rows
    #[arg(long, value_name = "DATA", group = "trains", conflicts_with_all = ["model", "train", "cameras", "synthetic", "superpoints", "paper_protocol", "check", "time", "frames", "warmup", "width", "height", "sweep", "quality", "set"])]
    pub ablation: Option<PathBuf>,
    /// Only these ablations, by name: superpoints, neighbors, property-loss, weight-position, … [default: all]
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', requires = "ablation")]
    pub only: Vec<String>,
    /// Iterations of each run of --ablation [default: 4000] or --until-psnr [default: 40000]; the schedule scales with it
    #[arg(long, value_name = "N", requires = "trains", value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    pub iterations: Option<u64>,
    /// Photos of --ablation or --until-psnr are averaged down by this factor [default: the data set's rule]
    #[arg(long, value_name = "K", requires = "trains", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// Also by the paper's protocol: one view, 1000 frames, t from 0 to 1
    #[arg(long)]
    pub paper_protocol: bool,
    /// Also the error of this view against the f64 reference
    #[arg(long)]
    pub check: bool,
    /// Frame rates by the paper's protocol and over the whole path of --cameras, beside the paper's on its devices; the
    /// roofline of this device; how the cost grows with Gaussians, superpoints and pixels
    #[arg(long, conflicts_with_all = ["train", "sweep", "paper_protocol", "check", "hard_cases", "ablation"])]
    pub paper: bool,
    /// Seconds that --paper may take, about; what it leaves out for that it says; 0: no curves [default: 180]
    #[arg(long, value_name = "S", requires = "paper", value_parser = seconds)]
    pub budget: Option<f64>,
    /// Judge numerical stability on small hard scenes against the f64 truth: a table of error, bound, pass or fail, time.
    /// Exit code 1 when a bound does not hold, 6 when a number is not finite
    #[arg(long, conflicts_with_all = ["model", "train", "ablation", "synthetic", "superpoints", "cameras", "time", "paper_protocol", "check", "width", "height", "warmup", "motion", "background", "sweep", "quality", "set"])]
    pub hard_cases: bool,
    /// Runs whose bits --hard-cases compares [default: 20]
    #[arg(long, value_name = "N", requires = "hard_cases", value_parser = clap::value_parser!(u32).range(2..=100_000))]
    pub runs: Option<u32>,
    /// Write everything as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write a self-contained page: a bar chart of the kernels; with --sweep the charts, tables and pictures
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
}

/// `spgs compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// The truth: a picture (PNG, JPEG or EXR), or a folder of them
    pub reference: PathBuf,
    /// What is compared with it: a picture of the same size, or a folder with pictures of the same names
    pub test: PathBuf,
    /// Weights for LPIPS (.safetensors with AlexNet, VGG-16 or both; may be given twice) [default: none, LPIPS is null]
    #[arg(long, value_name = "FILE")]
    pub lpips_weights: Vec<PathBuf>,
    /// Colour behind pictures with alpha
    #[arg(long, value_name = "R,G,B", default_value = "0,0,0", allow_hyphen_values = true, value_parser = color)]
    pub background: [f32; 3],
    /// Error images: FILE.png gets the map of FLIP of one pair; a folder gets NAME_flip.png and NAME_error.png (4 times the
    /// absolute difference) of each
    #[arg(long, value_name = "FILE.png|DIR")]
    pub out: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// `spgs eval`.
#[derive(Debug, Args)]
pub struct EvalArgs {
    /// Model: .safetensors, 3DGS .ply, or anything that `spgs convert` reads
    pub model: PathBuf,
    /// Data set: a folder as for `spgs train`
    #[arg(long, value_name = "DATA")]
    pub data: PathBuf,
    /// Part of the data set
    #[arg(long, value_enum, default_value_t = SplitArg::Test)]
    pub split: SplitArg,
    /// By which rules of the paper [default: by the data set's format]
    #[arg(long, value_enum)]
    pub protocol: Option<Benchmark>,
    /// The paper's scene to compare with [default: by the data folder's name]
    #[arg(long, value_name = "NAME")]
    pub scene: Option<String>,
    /// Images are averaged down by this factor [default: as the model was trained, else the protocol's]
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// Colour behind the scene and behind pictures with alpha [default: as the model was trained, else the protocol's black]
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true, value_parser = color)]
    pub background: Option<[f32; 3]>,
    /// Where the motion comes from [default: the key-time table where the model has one]
    #[arg(long, value_enum)]
    pub motion: Option<MotionArg>,
    /// Weights for LPIPS (.safetensors with AlexNet, VGG-16 or both; may be given twice) [default: none, LPIPS is null]
    #[arg(long, value_name = "FILE")]
    pub lpips_weights: Vec<PathBuf>,
    /// Also the scores under the data set's masks (of what moves)
    #[arg(long)]
    pub masks: bool,
    /// Write everything as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write a page with tables, charts and pictures
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Folder for pictures of every view: NNNNN.png, NNNNN_truth.png, NNNNN_flip.png, NNNNN_error.png
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// `--split` of `spgs eval`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SplitArg {
    /// Held-out views.
    Test,
    /// Views held out beside the test split.
    Val,
    /// Views that were trained on.
    Train,
}

impl SplitArg {
    /// Name in JSON and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Test => "test",
            Self::Val => "val",
            Self::Train => "train",
        }
    }
}

/// `spgs inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Model (any file or folder that `spgs convert` reads, or PyTorch weights) or folder of a data set
    pub file: PathBuf,
    /// Print it as JSON
    #[arg(long)]
    pub json: bool,
}

/// `spgs devices`.
#[derive(Debug, Args)]
pub struct DevicesArgs {
    /// Print it as JSON
    #[arg(long)]
    pub json: bool,
}

/// Picture format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// 8 bit, clamped.
    Png,
    /// Float, with alpha and depth.
    Exr,
}

impl Format {
    /// File name extension.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Exr => "exr",
        }
    }
}

/// `--motion`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MotionArg {
    /// The key-time table.
    Table,
    /// Network F, or the networks of a deformation field, evaluated for each frame.
    Network,
}

/// Parses `r,g,b`.
fn color(text: &str) -> Result<[f32; 3], String> {
    let parts: Vec<f32> =
        text.split(',').map(|p| p.trim().parse::<f32>()).collect::<Result<_, _>>().unwrap_or_default();
    match <[f32; 3]>::try_from(parts) {
        Ok(c) if c.iter().all(|v| v.is_finite()) => Ok(c),
        _ => Err("expected three numbers, for example 1,1,1".into()),
    }
}

/// Parses a length of time, seconds.
fn seconds(text: &str) -> Result<f64, String> {
    let fits = |v: &f64| (0.0..=1.0e6).contains(v);
    text.parse().ok().filter(fits).ok_or_else(|| "expected seconds, 0 to 1000000".into())
}

/// Parses a distance of the near plane.
fn near(text: &str) -> Result<f32, String> {
    let fits = |v: &f32| (0.0..=1.0e6).contains(v);
    text.parse().ok().filter(fits).ok_or_else(|| "expected a distance, 0 to 1000000".into())
}

/// Parses the name of a preset.
fn preset(text: &str) -> Result<Quality, String> {
    Quality::named(text).map_err(|e| e.to_string())
}

/// Checks a list of knobs.
fn knobs(text: &str) -> Result<String, String> {
    let mut quality = Quality::EXACT;
    quality.set_all(text).map(|()| text.to_owned()).map_err(|e| e.to_string())
}

/// Parses a number that is neither NaN nor infinite.
pub(crate) fn finite(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| "expected a finite number".into())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_definition_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn colors_are_three_finite_numbers() {
        assert_eq!(color("1, 0.5,-2"), Ok([1.0, 0.5, -2.0]));
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,nan", "inf,0,0"] {
            assert!(color(bad).is_err(), "{bad}");
        }
    }
}
