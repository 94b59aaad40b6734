//! Arguments of `spgs compare`.

use std::path::PathBuf;

use clap::Args;

use super::options::color;

/// `spgs compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// The truth: a picture (PNG, JPEG or EXR), or a folder of them
    pub reference: PathBuf,
    /// What is compared with it: a picture of the same size, or a folder with pictures of the same names
    pub test: PathBuf,
    /// Weights for LPIPS (.safetensors with AlexNet, VGG-16 or both; may be given twice) [default: none, LPIPS is null]
    #[arg(long, value_name = "FILE")]
    pub lpips_weights: Vec<PathBuf>,
    /// Colour behind pictures with alpha
    #[arg(long, value_name = "R,G,B", default_value = "0,0,0", allow_hyphen_values = true, value_parser = color)]
    pub background: [f32; 3],
    /// Error images: FILE.png gets the map of FLIP of one pair; a folder gets NAME_flip.png and NAME_error.png (4 times the
    /// absolute difference) of each
    #[arg(long, value_name = "FILE.png|DIR")]
    pub out: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}
