//! What is measured where the command line names no model: synthetic scenes, the same ones every time.

use engine::error::Result;
use engine::scene::Scene;
use engine::scene::synthetic::{moving_scene, random_scene};

use crate::cli::args::SceneArgs;
use crate::cli::model;

/// Image size where neither arguments nor cameras say one: that of the paper's synthetic scenes.
pub(super) const DEFAULT_SIZE: u32 = 800;
pub(super) const SYNTHETIC_SEED: u64 = 1;
/// Key times of the synthetic motion.
pub(super) const SYNTHETIC_KEYS: usize = 100;
const SYNTHETIC_SH_DEGREE: u32 = 3;

/// The synthetic scene of so many Gaussians and superpoints; without superpoints it stands still.
pub(super) fn synthetic(gaussians: u32, superpoints: u32, network: bool) -> Scene {
    let (n, m) = (gaussians as usize, superpoints as usize);
    match m {
        0 => random_scene(n, SYNTHETIC_SEED, SYNTHETIC_SH_DEGREE),
        _ => moving_scene(n, m, SYNTHETIC_KEYS, SYNTHETIC_SEED, network),
    }
}

/// Its name.
pub(super) fn synthetic_name() -> String {
    format!("synthetic, seed {SYNTHETIC_SEED}")
}

/// The model of the arguments, or the synthetic scene, and its name.
pub(super) fn load(args: &SceneArgs, network: bool) -> Result<(Scene, String)> {
    if let Some(path) = &args.model {
        return Ok((model::load_level(path, args.level)?.scene, path.display().to_string()));
    }
    Ok((synthetic(args.synthetic, args.superpoints, network), synthetic_name()))
}
