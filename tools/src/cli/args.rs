//! Arguments of `spgs`.

use clap::{Parser, Subcommand};

mod bench;
mod compare;
mod convert;
mod demo;
mod devices;
mod distill;
mod edit;
mod eval;
mod help;
mod inspect;
mod options;
mod pose;
mod render;
mod train;
mod view;

pub use bench::{
    AblationArgs, BenchArgs, BenchMode, FrameArgs, GpuDayArgs, HardCasesArgs, PaperArgs, SceneArgs, SortArgs,
    SweepArgs, TrainBenchArgs,
};
pub use compare::CompareArgs;
pub use convert::ConvertArgs;
pub use demo::DemoArgs;
pub use devices::DevicesArgs;
pub use distill::{DistillArgs, TuneOn};
pub use edit::EditArgs;
pub use eval::{EvalArgs, SplitArg};
pub use help::{HelpArgs, topics};
pub use inspect::InspectArgs;
pub use options::{Format, Global, LookArgs, MotionArg, QualityArgs, ResultArgs, SizeArgs, motion_source};
pub use pose::{PoseArgs, SolveArg};
pub use render::{PathArg, RenderArgs};
pub use train::TrainArgs;
pub use view::ViewerArgs;

/// Train, render and measure moving 3D Gaussian scenes on Vulkan
#[derive(Debug, Parser)]
#[command(name = "spgs", version, arg_required_else_help = false, disable_help_subcommand = true, after_help = topics())]
pub struct Cli {
    /// Options of every subcommand.
    #[command(flatten)]
    pub global: Global,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Render a built-in moving scene; print FPS and kernel times
    Demo(DemoArgs),
    /// Train a moving scene from posed images
    Train(TrainArgs),
    /// Render a model from the views of a camera file, or along a path
    Render(RenderArgs),
    /// Fly through a scene in a window, scrub its time and edit it (Ctrl+E; `spgs help editing`)
    View(ViewerArgs),
    /// Measure frames, kernels, training steps and errors
    Bench(BenchArgs),
    /// Compare two images, or the images of two folders: PSNR, SSIM, MS-SSIM, FLIP, LPIPS
    Compare(CompareArgs),
    /// Score a model on the held-out views of a data set, beside the paper's numbers
    Eval(EvalArgs),
    /// Convert a model to another format: whole, at one time, or as a sequence
    Convert(ConvertArgs),
    /// Select what moves together; move, turn, scale, delete, copy, recolour, retime or merge it
    Edit(EditArgs),
    /// Turn any moving model into superpoints, with a stated error
    Distill(DistillArgs),
    /// Find how superpoints and cameras stand in new photos
    Pose(PoseArgs),
    /// Describe a model file or a data set
    Inspect(InspectArgs),
    /// List the Vulkan devices, and what unusable ones lack
    Devices(DevicesArgs),
    /// Explain a command or a topic
    Help(HelpArgs),
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
}
