//! Options that several subcommands have, and how their values are written.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use engine::error::Result;
use engine::file::picture::{self, Alpha};
use engine::image::Image;
use engine::render::Quality;
use engine::scene::MotionSource;
use serde_json::Value;

use crate::report::files::{to_json, write_text};

/// Options of every subcommand.
#[derive(Debug, Clone, Args)]
pub struct Global {
    /// Vulkan device: index in `spgs devices`, or part of its name [default: SPGS_DEVICE, else the fastest kind]
    #[arg(long, global = true, value_name = "N|NAME")]
    pub device: Option<String>,
    /// Test the device again before using it (SPGS_SELF_TEST=0: never test it)
    #[arg(long, global = true)]
    pub self_test: bool,
    /// Print warnings and errors only
    #[arg(long, short, global = true)]
    pub quiet: bool,
}

/// How a scene is drawn.
#[derive(Debug, Clone, Args)]
pub struct LookArgs {
    /// Colour behind the scene
    #[arg(long, value_name = "R,G,B", default_value = "0,0,0", allow_hyphen_values = true, value_parser = color)]
    pub background: [f32; 3],
    /// Where the motion comes from [default: the key-time table where the model has one]
    #[arg(long, value_enum)]
    pub motion: Option<MotionArg>,
}

impl LookArgs {
    /// The engine's name for `--motion`.
    pub fn motion_source(&self) -> MotionSource {
        motion_source(self.motion)
    }
}

/// Size of a rendered view.
#[derive(Debug, Clone, Copy, Args)]
pub struct SizeArgs {
    /// Image width [default: the camera's, or in proportion to the height]
    #[arg(long, value_name = "W", value_parser = clap::value_parser!(u32).range(1..=16_384))]
    pub width: Option<u32>,
    /// Image height [default: the camera's, or in proportion to the width]
    #[arg(long, value_name = "H", value_parser = clap::value_parser!(u32).range(1..=16_384))]
    pub height: Option<u32>,
}

impl SizeArgs {
    /// What was asked for.
    pub fn asked(self) -> [Option<u32>; 2] {
        [self.width, self.height]
    }

    /// Image size where no cameras say one: a square of the side that was asked for, or of `side`.
    pub fn or_square(self, side: u32) -> [u32; 2] {
        let Self { width, height } = self;
        [width.or(height).unwrap_or(side), height.or(width).unwrap_or(side)]
    }
}

/// What may be given up for speed.
#[derive(Debug, Clone, Args)]
pub struct QualityArgs {
    /// Error allowed for speed: exact: none; high: none that is visible
    #[arg(long, value_name = "exact|high", default_value = "high", value_parser = preset)]
    pub quality: Quality,
    /// Override single knobs of --quality (see `spgs help quality`): cull, alpha_cut, stop, position, sh_degree, sh, colour,
    /// table_step, interpolation, network, nonrigid, resolution
    #[arg(long, value_name = "KNOB=VALUE,…", value_parser = knobs)]
    pub set: Option<String>,
}

impl QualityArgs {
    /// `--quality` with the knobs of `--set`.
    pub fn chosen(&self) -> Quality {
        let mut quality = self.quality;
        // The parser has accepted the list already.
        let _ = quality.set_all(self.set.as_deref().unwrap_or_default());
        quality
    }
}

/// Where results go.
#[derive(Debug, Clone, Args)]
pub struct ResultArgs {
    /// Write everything as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write a self-contained page with tables, charts and images
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
}

impl ResultArgs {
    /// Writes what is asked for; the page is made only then, and before the first file is written.
    ///
    /// # Errors
    /// Those of `page`; a file that cannot be written.
    pub fn write(&self, record: &Value, page: impl FnOnce() -> Result<String>) -> Result<()> {
        let page = self.report.as_deref().map(|path| page().map(|text| (path, text))).transpose()?;
        if let Some(path) = &self.json {
            write_text(path, &(to_json(record)? + "\n"))?;
        }
        page.map_or(Ok(()), |(path, text)| write_text(path, &text))
    }
}

/// The engine's name for `--motion`.
pub fn motion_source(motion: Option<MotionArg>) -> MotionSource {
    match motion {
        None => MotionSource::Auto,
        Some(MotionArg::Table) => MotionSource::Table,
        Some(MotionArg::Network) => MotionSource::Network,
    }
}

/// Image format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// 8 bit, clamped.
    Png,
    /// Float, with alpha and depth.
    Exr,
}

impl Format {
    /// File name extension.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Exr => "exr",
        }
    }

    /// Writes an image; the file is there whole or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(self, path: &Path, image: &Image) -> Result<()> {
        match self {
            Self::Png => picture::write_png(path, image, Alpha::Drop),
            Self::Exr => picture::write_exr(path, image),
        }
    }
}

/// `--motion`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MotionArg {
    /// The key-time table.
    Table,
    /// Network F, or the networks of a deformation field, evaluated for each frame.
    Network,
}

/// Parses `r,g,b`.
pub(super) fn color(text: &str) -> std::result::Result<[f32; 3], String> {
    let parts: Vec<f32> =
        text.split(',').map(|p| p.trim().parse::<f32>()).collect::<std::result::Result<_, _>>().unwrap_or_default();
    match <[f32; 3]>::try_from(parts) {
        Ok(c) if c.iter().all(|v| v.is_finite()) => Ok(c),
        _ => Err("expected three numbers, for example 1,1,1".into()),
    }
}

/// Parses seconds up to eight minutes.
pub(super) fn eight_minutes(text: &str) -> std::result::Result<f64, String> {
    let fits = |v: &f64| (1.0..=480.0).contains(v);
    text.parse().ok().filter(fits).ok_or_else(|| "expected seconds, 1 to 480".into())
}

/// Parses a length of time, seconds.
pub(super) fn seconds(text: &str) -> std::result::Result<f64, String> {
    let fits = |v: &f64| (0.0..=1.0e6).contains(v);
    text.parse().ok().filter(fits).ok_or_else(|| "expected seconds, 0 to 1000000".into())
}

/// Parses a distance of the near plane.
pub(super) fn near(text: &str) -> std::result::Result<f32, String> {
    let fits = |v: &f32| (0.0..=1.0e6).contains(v);
    text.parse().ok().filter(fits).ok_or_else(|| "expected a distance, 0 to 1000000".into())
}

/// Parses the name of a preset.
pub(super) fn preset(text: &str) -> std::result::Result<Quality, String> {
    Quality::named(text).map_err(|e| e.to_string())
}

/// Checks a list of knobs.
pub(super) fn knobs(text: &str) -> std::result::Result<String, String> {
    let mut quality = Quality::EXACT;
    quality.set_all(text).map(|()| text.to_owned()).map_err(|e| e.to_string())
}

/// Parses a number that is neither NaN nor infinite.
pub(super) fn finite(text: &str) -> std::result::Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| "expected a finite number".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_are_three_finite_numbers() {
        assert_eq!(color("1, 0.5,-2"), Ok([1.0, 0.5, -2.0]));
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,nan", "inf,0,0"] {
            assert!(color(bad).is_err(), "{bad}");
        }
    }
}
