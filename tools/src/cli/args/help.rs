//! Arguments of `spgs help`.

use clap::Args;

use crate::manual;

/// `spgs help`.
#[derive(Debug, Args)]
pub struct HelpArgs {
    /// Command (and its mode), or topic [default: list all]
    #[arg(value_name = "COMMAND|TOPIC")]
    pub about: Vec<String>,
}

/// The topics of the manual, one per line.
pub fn topics() -> String {
    let width = manual::pages().map(|p| p.topic.len()).max().unwrap_or_default();
    let line = |p: &engine::manual::Page| format!("\n  {:width$}  {}", p.topic, p.title());
    format!("Topics (spgs help TOPIC):{}", manual::pages().map(line).collect::<String>())
}
