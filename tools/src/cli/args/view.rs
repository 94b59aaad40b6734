//! Arguments of `spgs view`.

use std::path::PathBuf;

use clap::Args;

use super::options::{LookArgs, QualityArgs, finite, near};

/// `spgs view`.
#[derive(Debug, Clone, Args)]
pub struct ViewerArgs {
    /// Model: .safetensors, 3DGS .ply, or anything that `spgs convert` reads; or the output folder of `spgs train`, which is
    /// watched [default: an empty window that takes dropped files]
    pub model: Option<PathBuf>,
    /// Level of detail of a SOG with lod-meta.json; 0 is the finest [default: the finest whose files are all there]
    #[arg(long, value_name = "N", requires = "model")]
    pub level: Option<u32>,
    /// Camera file (transforms*.json), COLMAP folder or data set, for camera presets, frusta and which way is up
    #[arg(long, value_name = "FILE|DATA")]
    pub data: Option<PathBuf>,
    /// Part of the data set
    #[arg(long, value_name = "NAME", requires = "data")]
    pub split: Option<String>,
    /// How far off each pixel may be (key 6): the file of `spgs eval --save-confidence` for this model
    #[arg(long, value_name = "FILE", requires = "model")]
    pub confidence: Option<PathBuf>,
    /// How well the poses of superpoints are known (key C): NEW.pose.json of `spgs pose` for this model
    #[arg(long, value_name = "FILE", requires = "model")]
    pub poses: Option<PathBuf>,
    /// Size of the window, pixels
    #[arg(long, value_name = "WxH", default_value = "1280x800", value_parser = size)]
    pub size: [u32; 2],
    /// Time to start at [default: the start of the motion]
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = finite)]
    pub time: Option<f64>,
    /// Draw nothing nearer to the camera than this, world units [default: 0.2, at most a tenth of the scene's radius]
    #[arg(long, value_name = "Z", value_parser = near)]
    pub near: Option<f32>,
    /// Start paused
    #[arg(long)]
    pub pause: bool,
    /// How the scene is drawn
    #[command(flatten)]
    pub look: LookArgs,
    /// What may be given up for speed
    #[command(flatten)]
    pub quality: QualityArgs,
    /// Folder for saved images and recorded camera paths
    #[arg(long, value_name = "DIR", default_value = "out/view")]
    pub out: PathBuf,
    /// Draw as fast as possible instead of once per refresh of the display
    #[arg(long)]
    pub no_vsync: bool,
    /// Render all pixels while something moves, even if that is slow
    #[arg(long)]
    pub full_resolution: bool,
    /// Close the window after N frames
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: Option<u64>,
    /// Print the measurements as JSON when the window closes
    #[arg(long)]
    pub json: bool,
    /// Test seam: the device is reported lost at the N-th submission; given again, the one after it too
    #[arg(long, value_name = "N", hide = true)]
    pub lose_device_at: Vec<u64>,
}

/// Parses `WxH`.
fn size(text: &str) -> Result<[u32; 2], String> {
    let parts: Vec<u32> = text.split(['x', 'X', '×']).filter_map(|p| p.trim().parse().ok()).collect();
    match parts[..] {
        [w, h] if (64..=16_384).contains(&w) && (64..=16_384).contains(&h) => Ok([w, h]),
        _ => Err("expected WIDTHxHEIGHT from 64x64 to 16384x16384, for example 1280x800".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_two_numbers() {
        assert_eq!(size("640x480"), Ok([640, 480]));
        for bad in ["", "640", "640x", "0x480", "99999x480", "640x480x3", "axb"] {
            assert!(size(bad).is_err(), "{bad}");
        }
    }
}
