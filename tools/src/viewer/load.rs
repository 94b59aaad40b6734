//! Opening models beside the window: files, and folders of a training run, which are looked at again and again.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime};

use engine::confidence::Evidence;
use engine::error::{Error, Result};
use engine::scene::Scene;
use engine::train::checkpoint::Checkpoint;
use winit::event_loop::EventLoopProxy;

use super::known::KnownPoses;
use super::model::Expected;
use crate::cli::model;
use crate::report::error_image::GAIN;

/// How often a folder is looked at.
const WATCH_EVERY: Duration = Duration::from_secs(1);

/// A model that was read.
#[derive(Debug)]
pub(super) struct Opened {
    /// What was asked for.
    pub(super) path: PathBuf,
    /// A device that takes the place of a lost one gets the same.
    pub(super) scene: Arc<Scene>,
    /// How far off its images may be, if that is known.
    pub(super) expected: Option<Arc<Expected>>,
    /// How well the poses of its superpoints are known, if that is.
    pub(super) poses: Option<Arc<KnownPoses>>,
    /// What the user should know.
    pub(super) messages: Vec<String>,
    /// Colour that the run was trained on.
    pub(super) background: Option<[f32; 3]>,
    /// Read again because the folder changed.
    pub(super) again: bool,
}

/// What the command line says about its model.
#[derive(Debug, Clone, Default)]
pub(super) struct Extras {
    /// Level of detail.
    pub(super) level: Option<u32>,
    /// File of `spgs eval --save-confidence`.
    pub(super) confidence: Option<PathBuf>,
    /// File of `spgs pose`.
    pub(super) poses: Option<PathBuf>,
}

/// What comes from another thread.
#[derive(Debug)]
pub(super) enum News {
    Opened(Box<Opened>),
    Failed(PathBuf, Error),
}

/// Reads `path` in a thread of its own; a folder of a training run is read again whenever it changes, until
/// the flag is set.
pub(super) fn start(path: PathBuf, mut extras: Extras, proxy: EventLoopProxy<News>) -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    std::thread::spawn(move || {
        let mut seen = None;
        let mut again = false;
        while !stopped.load(Ordering::Relaxed) {
            let now = newest(&path);
            if now != seen || !again {
                let news = match open(&path, now.as_ref().map(|(p, _)| p.as_path()), &extras) {
                    Ok(opened) => News::Opened(Box::new(Opened { again, ..opened })),
                    // A checkpoint may be replaced while it is read; the next look finds another.
                    Err(_) if again => {
                        std::thread::sleep(WATCH_EVERY);
                        continue;
                    }
                    Err(error) => News::Failed(path.clone(), error),
                };
                let failed = matches!(news, News::Failed(..));
                if proxy.send_event(news).is_err() || failed || now.is_none() {
                    return;
                }
                (seen, again) = (now, true);
                // They are about the model that was there first.
                (extras.confidence, extras.poses) = (None, None);
            }
            std::thread::sleep(WATCH_EVERY);
        }
    });
    stop
}

/// The newest model or checkpoint of a training folder; `None` for a file.
fn newest(path: &Path) -> Option<(PathBuf, SystemTime)> {
    if !path.is_dir() {
        return None;
    }
    let checkpoints = std::fs::read_dir(path.join("checkpoints")).into_iter().flatten().flatten().map(|e| e.path());
    let is_model = |p: &PathBuf| p.extension().is_some_and(|e| e == "safetensors");
    let changed = |p: PathBuf| {
        let time = std::fs::metadata(&p).and_then(|m| m.modified()).ok()?;
        Some((p, time))
    };
    let all = checkpoints.chain([path.join("model.safetensors")]).filter(is_model).filter_map(changed);
    all.max_by_key(|(_, time)| *time)
}

fn open(path: &Path, of_folder: Option<&Path>, extras: &Extras) -> Result<Opened> {
    let opened = open_scene(path, of_folder, extras.level)?;
    let read = |file| Evidence::read(file, &opened.scene).map(|evidence| Arc::new(expected(&evidence)));
    let expected = extras.confidence.as_deref().map(read).transpose()?;
    let superpoints = opened.scene.deformation.superpoint_count();
    let poses = extras.poses.as_deref().map(|file| KnownPoses::read(file, superpoints).map(Arc::new)).transpose()?;
    Ok(Opened { expected, poses, ..opened })
}

/// Errors as bright as other images of errors show them.
fn expected(evidence: &Evidence) -> Expected {
    let grey = |error: f64| [(GAIN * error) as f32; 3];
    let (each, background) = evidence.expected();
    Expected { each: each.into_iter().map(grey).collect(), background: grey(background) }
}

fn open_scene(path: &Path, of_folder: Option<&Path>, level: Option<u32>) -> Result<Opened> {
    let file = match of_folder {
        Some(file) if level.is_none() && file.starts_with(path.join("checkpoints")) => {
            return open_checkpoint(path, file);
        }
        Some(file) => file,
        // SOG and the runs of other programs are folders too.
        None if path.is_dir() && engine::file::Format::of_folder(path).is_none() => {
            let expected =
                "a folder of `spgs train` with model.safetensors or checkpoints/, of SOG, or of another training run";
            return Err(Error::usage(path.display().to_string(), "a folder without a model", expected));
        }
        None => path,
    };
    let loaded = model::read_level(file, level)?;
    Ok(Opened {
        path: path.to_owned(),
        scene: Arc::new(loaded.scene),
        expected: None,
        poses: None,
        messages: loaded.warnings,
        background: None,
        again: false,
    })
}

/// The scene as a training run has it at this moment.
fn open_checkpoint(folder: &Path, file: &Path) -> Result<Opened> {
    let checkpoint = Checkpoint::load(file)?;
    let (iteration, background) = (checkpoint.iteration, checkpoint.config.background);
    let scene = checkpoint.into_scene()?;
    let count = scene.gaussians.len();
    Ok(Opened {
        path: folder.to_owned(),
        scene: Arc::new(scene),
        expected: None,
        poses: None,
        messages: vec![format!("iteration {iteration}: {count} Gaussians")],
        background: Some(background),
        again: false,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn folders_without_a_model_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(newest(folder.path()), None);
        let error = open(folder.path(), None, &Extras::default()).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        assert_eq!(open(&folder.path().join("none.ply"), None, &Extras::default()).unwrap_err().exit_code(), 3);
        let scene = engine::scene::synthetic::random_scene(5, 1, 0);
        let cloud = folder.path().join("point_cloud/iteration_7");
        std::fs::create_dir_all(&cloud).unwrap();
        engine::file::ply::write(&cloud.join("point_cloud.ply"), &scene.gaussians).unwrap();
        assert_eq!(open(folder.path(), None, &Extras::default()).unwrap().scene.gaussians.len(), 5);
        let model = folder.path().join("model.safetensors");
        std::fs::write(&model, b"x").unwrap();
        assert_eq!(newest(folder.path()).unwrap().0, model);
    }
}
