//! Arguments of `spgs devices`.

use clap::Args;

/// `spgs devices`.
#[derive(Debug, Args)]
pub struct DevicesArgs {
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}
