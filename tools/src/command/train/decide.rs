//! What a run is made of: configuration and first Gaussians, from arguments, files and the data set's format.

use engine::data::dataset::Dataset;
use engine::error::Result;
use engine::scene::Gaussians;
use engine::train::config::{Base, Config};
use engine::train::start;

use crate::cli::args::TrainArgs;
use crate::cli::model;

/// The configuration of a new run.
///
/// # Errors
/// Those of reading and checking it.
pub(super) fn config(args: &TrainArgs, data: Option<&Dataset>) -> Result<Config> {
    let is_static = args.no_motion || data.is_some_and(|d| d.is_static);
    let base = Base { is_static, ..args.preset.base(data.map(|d| d.kind)) };
    let config = match &args.config {
        Some(path) => Config::read(path, base)?,
        None => base.config(),
    };
    resumed(args, &config)
}

/// A configuration with what the arguments change.
///
/// # Errors
/// Those of checking it.
pub(super) fn resumed(args: &TrainArgs, config: &Config) -> Result<Config> {
    let mut c = config.clone();
    let length = if args.nonrigid { &mut c.nonrigid.iterations } else { &mut c.iterations };
    *length = args.iterations.unwrap_or(*length);
    changed(args, c)
}

/// The configuration of the stage of network G that follows a run with `config`.
///
/// # Errors
/// Those of checking it.
pub(super) fn nonrigid(args: &TrainArgs, config: &Config) -> Result<Config> {
    changed(args, config.for_nonrigid(args.iterations))
}

fn changed(args: &TrainArgs, mut c: Config) -> Result<Config> {
    // A second beginning would need the model that the first had.
    c.schedule.window_trial *= u64::from(args.init.is_none());
    c.seed = args.seed.unwrap_or(c.seed);
    c.deterministic |= args.deterministic;
    c.motion.enabled &= !args.no_motion;
    c.data.downscale = args.downscale.or(c.data.downscale);
    c.check()?;
    Ok(c)
}

/// The Gaussians that a run starts from, and where they come from in words.
///
/// # Errors
/// Those of loading a model.
pub(super) fn first_gaussians(args: &TrainArgs, config: &Config, data: &Dataset) -> Result<(Gaussians, String)> {
    if let Some(path) = &args.init {
        let gaussians = model::load(path)?.scene.gaussians;
        let line = format!("{} Gaussians of {}", gaussians.len(), path.display());
        return Ok((gaussians, line));
    }
    Ok(start::first(config, data.points.as_ref()))
}
