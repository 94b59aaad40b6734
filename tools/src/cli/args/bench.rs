//! Arguments of `spgs bench`, one struct for each of its modes.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::options::{LookArgs, QualityArgs, ResultArgs, SizeArgs, finite, seconds};

/// `spgs bench`.
#[derive(Debug, Args)]
#[command(
    subcommand_help_heading = "Modes",
    disable_help_subcommand = true,
    override_usage = "spgs bench [MODE] [OPTIONS] [MODEL]"
)]
pub struct BenchArgs {
    /// What is measured; frames without a word.
    #[command(subcommand)]
    pub mode: Option<BenchMode>,
    /// Those of `spgs bench frame`.
    #[command(flatten)]
    pub frame: FrameArgs,
}

/// The modes of `spgs bench`.
#[derive(Debug, Subcommand)]
pub enum BenchMode {
    /// Measure frames and their kernels; the same without a mode
    Frame(FrameArgs),
    /// Measure training steps, or the time to a quality
    ///
    /// Trains on the images of --cameras, from a disturbed copy of MODEL that stands still; or on images made of the synthetic
    /// scene, with its superpoints, network F and association.
    Train(TrainBenchArgs),
    /// Measure speed against error of every knob of the renderer
    ///
    /// Tries every knob of --set, the presets of --quality, and combinations on three views of --cameras (or an orbit),
    /// against the f64 reference and, if there is one, the ground truth.
    Sweep(SweepArgs),
    /// Measure frame rates beside the paper's, and the roofline of this device
    ///
    /// Frame rates by the paper's protocol and over all views of --cameras, beside the paper's numbers; how the cost grows with
    /// Gaussians, superpoints and pixels.
    Paper(PaperArgs),
    /// Measure the radix sort by itself, beside the rate of copies
    Sort(SortArgs),
    /// Test and measure everything on a GPU in at most eight minutes, beside what was predicted
    ///
    /// Kernels against their CPU twins, frames and steps of 120k moving Gaussians and of bench_s50k, sorts, a training run on
    /// dnerf_lego, the paper's protocol. Each has a part of the time; what fails or has no data does not stop the others.
    GpuDay(GpuDayArgs),
    /// Run the paper's ablations on a data set, beside the paper's rows
    ///
    /// One training run per setting.
    Ablation(AblationArgs),
    /// Test numerical stability on small hard scenes against the f64 reference
    ///
    /// Prints error, bound, pass or fail, and time of each. Exit code 1 if a bound does not hold, 6 if a number is not finite.
    HardCases(HardCasesArgs),
}

/// The scene that is measured.
#[derive(Debug, Clone, Args)]
pub struct SceneArgs {
    /// Model: .safetensors, 3DGS .ply, or anything that `spgs convert` reads [default: a synthetic scene]
    #[arg(conflicts_with_all = ["synthetic", "superpoints"])]
    pub model: Option<PathBuf>,
    /// Level of detail of a SOG with lod-meta.json; 0 is the finest [default: the finest whose files are all there]
    #[arg(long, value_name = "N", requires = "model")]
    pub level: Option<u32>,
    /// Use a synthetic scene of N random Gaussians
    #[arg(long, value_name = "N", default_value_t = 120_000, value_parser = clap::value_parser!(u32).range(0..=200_000_000))]
    pub synthetic: u32,
    /// Superpoints of the synthetic scene; 0: it stands still
    #[arg(long, value_name = "M", default_value_t = 512, value_parser = clap::value_parser!(u32).range(0..=65_536))]
    pub superpoints: u32,
}

/// The views from which it is measured.
#[derive(Debug, Clone, Args)]
pub struct PathArgs {
    /// Camera file (transforms*.json), COLMAP folder or data set [default: views of the whole scene]
    #[arg(long, value_name = "FILE|DATA")]
    pub cameras: Option<PathBuf>,
    /// Part of a data set
    #[arg(long, value_name = "NAME", requires = "cameras")]
    pub split: Option<String>,
    /// Time of every frame [default: that of the views, or swept over the motion]
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = finite)]
    pub time: Option<f64>,
}

/// `spgs bench frame`.
#[derive(Debug, Args)]
pub struct FrameArgs {
    /// The scene
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Its cameras
    #[command(flatten)]
    pub path: PathArgs,
    /// View to measure, counted from 0 in the camera file's order
    #[arg(long, value_name = "I", default_value_t = 0, requires = "cameras")]
    pub frame: usize,
    /// Size of the images
    #[command(flatten)]
    pub size: SizeArgs,
    /// How the view is drawn
    #[command(flatten)]
    pub look: LookArgs,
    /// What may be given up for speed
    #[command(flatten)]
    pub quality: QualityArgs,
    /// Frames to measure
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: u32,
    /// Frames before measuring
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    pub warmup: u32,
    /// Also measure by the paper's protocol: one view, 1000 frames, t from 0 to 1
    #[arg(long)]
    pub paper_protocol: bool,
    /// Also measure the error of this view against the f64 reference
    #[arg(long)]
    pub check: bool,
    /// Print what the predicted times follow from (JSON and report always have it)
    #[arg(long)]
    pub predict: bool,
    /// Where the results go
    #[command(flatten)]
    pub results: ResultArgs,
}

/// `spgs bench train`.
#[derive(Debug, Args)]
pub struct TrainBenchArgs {
    /// The scene
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Data set whose images MODEL is trained on
    #[arg(long, value_name = "DATA")]
    pub cameras: Option<PathBuf>,
    /// Size of the images of a synthetic scene
    #[command(flatten)]
    pub size: SizeArgs,
    /// Colour behind the scene
    #[arg(long, value_name = "R,G,B", default_value = "0,0,0", allow_hyphen_values = true, value_parser = super::options::color)]
    pub background: [f32; 3],
    /// Steps to measure [default: 20; --sweep 3]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: Option<u32>,
    /// Steps before measuring [default: 3; --sweep 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    pub warmup: Option<u32>,
    /// Print what the predicted times follow from (JSON and report always have it)
    #[arg(long, conflicts_with = "until_psnr")]
    pub predict: bool,
    /// Synthetic scenes of 10k, 100k and 300k Gaussians at 200x200, 400x400 and 800x800 pixels
    #[arg(long)]
    pub sweep: bool,
    /// Train on --cameras DATA until held-out views reach X dB; report iterations per second, the time and the curve
    #[arg(long, value_name = "X", requires = "cameras", conflicts_with_all = ["model", "synthetic", "superpoints", "sweep"], value_parser = finite)]
    pub until_psnr: Option<f64>,
    /// Iterations of --until-psnr; the schedule scales with it [default: 40000]
    #[arg(long, value_name = "N", requires = "until_psnr", value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    pub iterations: Option<u64>,
    /// Average the images of --until-psnr down by this factor [default: the data set's rule]
    #[arg(long, value_name = "K", requires = "until_psnr", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// Where the results go
    #[command(flatten)]
    pub results: ResultArgs,
}

/// `spgs bench sweep`.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// The scene
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Its cameras
    #[command(flatten)]
    pub path: PathArgs,
    /// Size of the images
    #[command(flatten)]
    pub size: SizeArgs,
    /// How the views are drawn
    #[command(flatten)]
    pub look: LookArgs,
    /// Frames to measure [default: 60 on a GPU, 9 on a CPU]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: Option<u32>,
    /// Frames before measuring [default: 3]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    pub warmup: Option<u32>,
    /// Where the results go
    #[command(flatten)]
    pub results: ResultArgs,
}

/// `spgs bench paper`.
#[derive(Debug, Args)]
pub struct PaperArgs {
    /// The scene
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Its cameras
    #[command(flatten)]
    pub path: PathArgs,
    /// The view of the paper's protocol, counted from 0 in the camera file's order
    #[arg(long, value_name = "I", default_value_t = 0, requires = "cameras")]
    pub frame: usize,
    /// Size of the images
    #[command(flatten)]
    pub size: SizeArgs,
    /// How the views are drawn
    #[command(flatten)]
    pub look: LookArgs,
    /// What may be given up for speed
    #[command(flatten)]
    pub quality: QualityArgs,
    /// Frames of the kernel profile, at most
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: u32,
    /// Frames before the kernel profile
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    pub warmup: u32,
    /// Seconds that it may take, roughly; it says what it leaves out; 0: no curves
    #[arg(long, value_name = "S", default_value_t = 180.0, value_parser = seconds)]
    pub budget: f64,
    /// Where the results go
    #[command(flatten)]
    pub results: ResultArgs,
}

/// `spgs bench sort`.
#[derive(Debug, Args)]
pub struct SortArgs {
    /// Keys to sort, each with a value of 32 bits
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_value = "131072,1048576,33554432", value_parser = clap::value_parser!(u32).range(1..=1 << 30))]
    pub keys: Vec<u32>,
    /// Runs of each, after a first one
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub runs: u32,
    /// Where the results go
    #[command(flatten)]
    pub results: ResultArgs,
}

/// `spgs bench gpu-day`.
#[derive(Debug, Args)]
pub struct GpuDayArgs {
    /// Folder for index.html, gpu_day.json and a JSON file of each step; existing ones are replaced
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Folder that holds `bench_s50k` and `dnerf_lego`; steps whose data is not there are skipped
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Run only these steps: self_test, synthetic_frame, synthetic_train, bench_s50k_frame, … [default: all]
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Seconds for all steps together; it says what it leaves out for them
    #[arg(long, value_name = "S", default_value_t = 440.0, value_parser = super::options::eight_minutes)]
    pub budget: f64,
}

/// `spgs bench ablation`.
#[derive(Debug, Args)]
pub struct AblationArgs {
    /// Data set: a folder as for `spgs train`
    pub data: PathBuf,
    /// Run only these ablations: superpoints, neighbors, property-loss, weight-position, … [default: all]
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Iterations of each run, a tenth of the paper's; the schedule scales with it
    #[arg(long, value_name = "N", default_value_t = 4000, value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    pub iterations: u64,
    /// Average the images down by this factor [default: the data set's rule]
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
    /// Where the results go
    #[command(flatten)]
    pub results: ResultArgs,
}

/// `spgs bench hard-cases`.
#[derive(Debug, Args)]
pub struct HardCasesArgs {
    /// Frames of the drift test
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: u32,
    /// Number of runs whose bits are compared
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    pub runs: u32,
    /// Where the results go
    #[command(flatten)]
    pub results: ResultArgs,
}
