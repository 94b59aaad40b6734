//! Arguments of `spgs`.

use clap::{Parser, Subcommand};

mod bench;
mod compare;
mod convert;
mod demo;
mod devices;
mod eval;
mod inspect;
mod options;
mod render;
mod train;
mod view;

pub use bench::{
    AblationArgs, BenchArgs, BenchMode, FrameArgs, HardCasesArgs, PaperArgs, SceneArgs, SweepArgs, TrainBenchArgs,
};
pub use compare::CompareArgs;
pub use convert::ConvertArgs;
pub use demo::DemoArgs;
pub use devices::DevicesArgs;
pub use eval::{EvalArgs, SplitArg};
pub use inspect::InspectArgs;
pub use options::{Format, Global, LookArgs, MotionArg, QualityArgs, ResultArgs, SizeArgs, motion_source};
pub use render::{PathArg, RenderArgs};
pub use train::TrainArgs;
pub use view::ViewerArgs;

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
