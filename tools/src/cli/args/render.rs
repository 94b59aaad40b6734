//! Arguments of `spgs render`.

use std::path::PathBuf;

use clap::Args;

use super::options::{Format, LookArgs, QualityArgs, SizeArgs, finite, near, seconds};

/// `spgs render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Model: .safetensors, 3DGS .ply, or anything that `spgs convert` reads
    pub model: PathBuf,
    /// Level of detail of a SOG with lod-meta.json; 0 is the finest [default: the finest whose files are all there]
    #[arg(long, value_name = "N")]
    pub level: Option<u32>,
    /// Camera file (transforms*.json), COLMAP folder or data set [with --path turntable and time: a view of the whole scene]
    #[arg(long, value_name = "FILE|DATA")]
    pub cameras: Option<PathBuf>,
    /// Part of a data set
    #[arg(long, value_name = "NAME", requires = "cameras")]
    pub split: Option<String>,
    /// Move the camera: turntable: once around the scene; time: not at all, the motion plays; cameras: smoothly through the
    /// views of --cameras; FILE: through the views of a recorded path (a camera file)
    #[arg(long, value_name = "turntable|time|cameras|FILE", value_parser = path)]
    pub path: Option<PathArg>,
    /// Number of frames along the path [default: --seconds times --fps]
    #[arg(long = "frames", value_name = "N", requires = "path", conflicts_with = "seconds", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub count: Option<u32>,
    /// Length of the path [default: 4]
    #[arg(long, value_name = "S", requires = "path", allow_hyphen_values = true, value_parser = seconds)]
    pub seconds: Option<f64>,
    /// Frames per second of the video
    #[arg(long, value_name = "F", default_value_t = 30.0, allow_hyphen_values = true, value_parser = rate)]
    pub fps: f64,
    /// Times at the start and the end of the path [default: the motion's; the cameras' own with --path cameras and FILE]
    #[arg(long, value_name = "A,B", requires = "path", conflicts_with = "time", allow_hyphen_values = true, value_parser = pair)]
    pub times: Option<[f64; 2]>,
    /// Axis of the turntable [default: what is up in the cameras, else 0,-1,0]
    #[arg(long, value_name = "X,Y,Z", requires = "path", allow_hyphen_values = true, value_parser = axis)]
    pub up: Option<[f64; 3]>,
    /// Average N sub-frames while the shutter is open
    #[arg(long, value_name = "N", requires = "path", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub motion_blur: u32,
    /// Share of the time between frames that the shutter is open
    #[arg(long, value_name = "X", default_value_t = 0.5, allow_hyphen_values = true, value_parser = shutter)]
    pub shutter: f64,
    /// Average K x K samples per pixel
    #[arg(long, value_name = "K", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub supersample: u32,
    /// Time of every frame [default: the camera's own]
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = finite)]
    pub time: Option<f64>,
    /// Render only this frame, counted from 0 in the camera file's order; repeatable. With --path turntable and time: the
    /// view to start from
    #[arg(long = "frame", value_name = "I")]
    pub frames: Vec<usize>,
    /// Folder for the images: DIR/00000.png, 00001.png, …
    #[arg(long, value_name = "DIR", required_unless_present = "video")]
    pub out: Option<PathBuf>,
    /// Video of all frames, encoded by ffmpeg if it is installed (the extension chooses the format: .mp4, .mkv, .webm);
    /// otherwise numbered images, in a folder with its name unless --out names one
    #[arg(long, value_name = "FILE")]
    pub video: Option<PathBuf>,
    /// png: 8 bit; exr: float R, G, B, A and depth Z
    #[arg(long, value_enum, default_value_t = Format::Png)]
    pub format: Format,
    /// Instead of colours, draw how far off each pixel may be, from what `spgs eval --save-confidence` kept: grey, png: 4 times
    /// as bright, exr: as it is
    #[arg(long, value_name = "FILE")]
    pub confidence: Option<PathBuf>,
    /// Draw nothing nearer to the camera than this, world units [default: 0.2; without cameras at most a tenth of the scene's radius]
    #[arg(long, value_name = "Z", value_parser = near)]
    pub near: Option<f32>,
    /// Size of the images
    #[command(flatten)]
    pub size: SizeArgs,
    /// How the views are drawn
    #[command(flatten)]
    pub look: LookArgs,
    /// What may be given up for speed
    #[command(flatten)]
    pub quality: QualityArgs,
    /// Print a summary as JSON
    #[arg(long)]
    pub json: bool,
}

/// `--path`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PathArg {
    /// Once around the scene.
    Turntable,
    /// The camera stays, time passes.
    Time,
    /// Through the views of `--cameras`.
    Cameras,
    /// Through the views of a camera file.
    File(PathBuf),
}

/// Parses `--path`.
fn path(text: &str) -> Result<PathArg, String> {
    Ok(match text {
        "turntable" => PathArg::Turntable,
        "time" => PathArg::Time,
        "cameras" => PathArg::Cameras,
        "" => return Err("expected turntable, time, cameras or a camera file".into()),
        file => PathArg::File(file.into()),
    })
}

/// Parses `N` finite numbers between commas.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let parts: Vec<f64> = text.split(',').map(|p| p.trim().parse().ok()).collect::<Option<_>>()?;
    <[f64; N]>::try_from(parts).ok().filter(|v| v.iter().all(|x| x.is_finite()))
}

/// Parses `a,b`.
fn pair(text: &str) -> Result<[f64; 2], String> {
    numbers(text).ok_or_else(|| "expected two numbers, for example 0,1".into())
}

/// Parses a direction.
fn axis(text: &str) -> Result<[f64; 3], String> {
    numbers(text)
        .filter(|v| v.iter().any(|x| *x != 0.0))
        .ok_or_else(|| "expected a direction, for example 0,0,1".into())
}

/// Parses frames per second.
fn rate(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.01..=1000.0).contains(v)).ok_or_else(|| "expected 0.01 to 1000".into())
}

/// Parses a share of a frame's length.
fn shutter(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.0..=1.0).contains(v)).ok_or_else(|| "expected 0 to 1".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_and_lists_of_numbers() {
        assert_eq!(path("turntable"), Ok(PathArg::Turntable));
        assert_eq!(path("cameras"), Ok(PathArg::Cameras));
        assert_eq!(path("a/path.json"), Ok(PathArg::File("a/path.json".into())));
        assert!(path("").is_err());
        assert_eq!(pair("0, -1.5"), Ok([0.0, -1.5]));
        assert_eq!(axis("0,0,1"), Ok([0.0, 0.0, 1.0]));
        for bad in ["", "1", "1,2,3", "1,x", "1,nan"] {
            assert!(pair(bad).is_err(), "{bad}");
        }
        assert!(axis("0,0,0").is_err() && axis("1,2").is_err());
        assert!(rate("0").is_err() && rate("inf").is_err() && rate("23.976").is_ok());
        assert!(shutter("1.5").is_err() && shutter("-0.1").is_err() && shutter("0.5").is_ok());
    }
}
