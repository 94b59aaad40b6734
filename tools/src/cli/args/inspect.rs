//! Arguments of `spgs inspect`.

use std::path::PathBuf;

use clap::Args;

/// `spgs inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Model (anything that `spgs convert` reads, or PyTorch weights) or data set
    pub file: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}
