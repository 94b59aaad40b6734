//! Arguments of `spgs inspect`.

use std::path::PathBuf;

use clap::Args;

/// `spgs inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Model (any file or folder that `spgs convert` reads, or PyTorch weights) or folder of a data set
    pub file: PathBuf,
    /// Print it as JSON
    #[arg(long)]
    pub json: bool,
}
