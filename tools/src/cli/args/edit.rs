//! Arguments of `spgs edit`.

use std::path::PathBuf;

use clap::Args;

/// `spgs edit`.
#[derive(Debug, Args)]
pub struct EditArgs {
    /// Model, as `spgs convert` reads it
    #[arg(value_name = "IN")]
    pub input: PathBuf,
    /// What to write, by its ending, as `spgs convert` does; the list of edits goes beside it as STEM.edits.toml
    #[arg(value_name = "OUT", required_unless_present = "dry_run")]
    pub output: Option<PathBuf>,
    /// Commands (`spgs help editing`), one per line, or a list of edits (.toml) to be applied again
    #[arg(long, value_name = "FILE", required_unless_present = "commands")]
    pub script: Option<PathBuf>,
    /// Commands with `;` between them; may be given several times, and follows --script
    #[arg(short = 'e', long = "execute", value_name = "COMMANDS")]
    pub commands: Vec<String>,
    /// Cameras: `view N` in a script is camera N of these, and pixels are measured through them
    #[arg(long, value_name = "FILE|DATA")]
    pub data: Option<PathBuf>,
    /// Split of the data set
    #[arg(long, value_name = "NAME", requires = "data")]
    pub split: Option<String>,
    /// Largest displacement that re-made poses may cause between key times, pixels [default: 0.1, or that of the list]
    #[arg(long, value_name = "PX", value_parser = bound)]
    pub bound: Option<f64>,
    /// Say what each command would touch, and write nothing
    #[arg(long)]
    pub dry_run: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Parses a number above 0.
fn bound(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0).ok_or_else(|| "expected a number above 0".into())
}
