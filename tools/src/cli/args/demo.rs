//! Arguments of `spgs demo`.

use std::path::PathBuf;

use clap::Args;

/// `spgs demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for the images
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    pub out: PathBuf,
    /// Number of images from t = 0 to 1
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub frames: u32,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}
