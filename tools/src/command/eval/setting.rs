//! What is evaluated, and how: the command line's word first, then the model's training, then the protocol's.

use std::path::{Path, PathBuf};

use engine::data::{DatasetKind, DatasetOptions, View, dataset};
use engine::error::{Error, Result};
use engine::render::RenderOptions;
use engine::scene::Scene;
use engine::train::config::Config;

use super::protocol::{self, Protocol};
use crate::cli::args::{EvalArgs, SplitArg, motion_source};
use crate::report::benchmark::Benchmark;
use crate::report::paper;

/// Everything that is decided before the first picture.
#[derive(Debug)]
pub(super) struct Setting {
    pub(super) path: PathBuf,
    pub(super) kind: DatasetKind,
    pub(super) views: Vec<View>,
    /// Those that say how sure images are; empty if nobody asks.
    pub(super) training: Vec<View>,
    pub(super) split: SplitArg,
    pub(super) downscale: u32,
    pub(super) background: [f32; 3],
    pub(super) options: RenderOptions,
    pub(super) masks: bool,
    pub(super) fit_exposure: bool,
    pub(super) protocol: Option<Protocol>,
    /// The paper's scene.
    pub(super) scene: Option<String>,
    /// What is not as in the paper.
    pub(super) deviations: Vec<String>,
}

impl Setting {
    pub(super) fn decide(args: &EvalArgs, scene: &Scene) -> Result<Self> {
        let trained = training_config(scene);
        let trained = trained.as_ref();
        let as_trained = trained.map(|c| c.data).unwrap_or_default();
        let options = DatasetOptions { downscale: args.downscale.or(as_trained.downscale), ..as_trained };
        let data = dataset::load(&args.data, &options)?;
        let protocol = args.protocol.or_else(|| Benchmark::of_format(data.kind)).map(protocol::of);
        let background = args.background.or(trained.map(|c| c.background)).unwrap_or([0.0; 3]);
        let near = trained.map_or(RenderOptions::default().near, |c| c.near);
        let render = RenderOptions { background, near, motion: motion_source(args.motion), ..RenderOptions::default() };
        let training = if args.confidence { data.train.clone() } else { Vec::new() };
        let views = match args.split {
            SplitArg::Test => data.test,
            SplitArg::Val => data.val,
            SplitArg::Train => data.train,
        };
        let Some(view) = views.first() else {
            let at = format!("split `{}`", args.split.name());
            return Err(Error::corrupt(&args.data, at, "no view", "at least one"));
        };
        if args.confidence && training.is_empty() {
            return Err(Error::corrupt(&args.data, "split `train` (--confidence)", "no view", "at least one"));
        }
        if args.masks && views.iter().all(|v| v.image.mask.is_none()) {
            return Err(Error::corrupt(&args.data, "masks (--masks)", "none", "a mask of at least one view"));
        }
        let size = [view.camera.width, view.camera.height];
        let mut deviations = protocol.as_ref().map(|p| p.deviations(args.split, size, background)).unwrap_or_default();
        if args.fit_exposure {
            deviations.push("each rendering is exposed as its photo was (--fit-exposure)".into());
        }
        let scene = match &protocol {
            Some(p) => paper_scene(args, p)?,
            None => None,
        };
        Ok(Self {
            path: args.data.clone(),
            kind: data.kind,
            downscale: data.downscale,
            split: args.split,
            masks: args.masks,
            fit_exposure: args.fit_exposure,
            options: render,
            views,
            training,
            background,
            protocol,
            scene,
            deviations,
        })
    }
}

/// The configuration that the model was trained with, if it says so in a way that this version reads.
fn training_config(scene: &Scene) -> Option<Config> {
    let said = scene.metadata.get("training")?;
    let not_read = |e: &serde_json::Error| {
        log::warn!(
            "how the model was trained is not read ({e}): give --downscale and --background if they were not 1 and black"
        );
    };
    serde_json::from_str(said).inspect_err(not_read).ok()
}

fn paper_scene(args: &EvalArgs, protocol: &Protocol) -> Result<Option<String>> {
    let tables = paper::tables()?;
    let Some(asked) = &args.scene else {
        let folder = |path: &Path| path.file_name().map(|n| n.to_string_lossy().into_owned());
        let whole = std::fs::canonicalize(&args.data).ok();
        let name = whole.as_deref().and_then(folder).unwrap_or_default();
        return Ok(tables.find_scene(protocol.benchmark, &name).map(str::to_owned));
    };
    if let Some(found) = tables.find_scene(protocol.benchmark, asked) {
        return Ok(Some(found.to_owned()));
    }
    let mut names: Vec<&str> = Vec::new();
    for row in tables.scenes.iter().filter(|r| r.dataset == protocol.benchmark && r.scene != "mean") {
        if !names.contains(&row.scene.as_str()) {
            names.push(&row.scene);
        }
    }
    Err(Error::usage("--scene", asked.clone(), names.join(", ")))
}
