//! What was done, for people and as JSON.

use std::path::PathBuf;

use serde::Serialize;

use super::bake::Baked;
use super::loss::Loss;
use super::targets::Written;

/// What was done.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// The file read.
    pub input: PathBuf,
    /// Its size, before anything was written; of a folder, or of a description in it, that of all files there.
    pub input_bytes: u64,
    /// Gaussians in it.
    pub gaussians: usize,
    /// Those that cannot be drawn.
    pub rejected: usize,
    /// The files written.
    pub outputs: Vec<Written>,
    /// What they do not hold, in words.
    pub dropped: Vec<String>,
    /// The motion table that was made.
    pub bake: Option<Baked>,
    /// How far renders of the files are from renders of the model.
    pub loss: Option<Loss>,
}

impl Summary {
    /// For people.
    pub fn lines(&self) -> Vec<String> {
        let bytes: u64 = self.outputs.iter().map(|o| o.bytes).sum();
        let name = |o: Option<&Written>| o.map(|o| o.file.display().to_string()).unwrap_or_default();
        let mut to = name(self.outputs.first());
        if self.outputs.len() > 1 {
            to += &format!(" to {} ({} files)", name(self.outputs.last()), self.outputs.len());
        }
        let input = self.input.display();
        let undrawn = if self.rejected > 0 { format!(", {} cannot be drawn", self.rejected) } else { String::new() };
        let (input_bytes, gaussians) = (self.input_bytes, self.gaussians);
        let mut lines =
            vec![format!("{input} ({input_bytes} bytes, {gaussians} Gaussians{undrawn}) → {to} ({bytes} bytes)")];
        if let Some(bake) = &self.bake {
            lines.push(bake.line());
        }
        lines.push(match &self.dropped[..] {
            [] => "left out: nothing".into(),
            dropped => format!("left out: {}", dropped.join("; ")),
        });
        lines.push(match &self.loss {
            Some(loss) => loss.line(),
            None => "loss: not measured".into(),
        });
        lines
    }
}
