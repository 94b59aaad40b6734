//! Arguments of `spgs compare`.

use std::path::PathBuf;

use clap::Args;

use super::options::color;

/// `spgs compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Reference: an image (PNG, JPEG or EXR), or a folder of images
    pub reference: PathBuf,
    /// Test: an image of the same size, or a folder with images of the same names
    pub test: PathBuf,
    /// Weights for LPIPS: .safetensors with AlexNet, VGG-16 or both; repeatable [default: none, LPIPS is null]
    #[arg(long, value_name = "FILE")]
    pub lpips_weights: Vec<PathBuf>,
    /// Colour behind images with alpha
    #[arg(long, value_name = "R,G,B", default_value = "0,0,0", allow_hyphen_values = true, value_parser = color)]
    pub background: [f32; 3],
    /// Write error images: FILE.png gets the FLIP map of one pair; a folder gets NAME_flip.png and NAME_error.png (4 times
    /// the absolute difference) of each
    #[arg(long, value_name = "FILE.png|DIR")]
    pub out: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}
