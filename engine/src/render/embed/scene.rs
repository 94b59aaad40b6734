//! Scenes on a host's device.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;

use super::super::quality::Quality;
use super::super::scene_buffers::SceneBuffers;
use super::extent::Extent;
use crate::error::{Error, Result};
use crate::file::{self, Loaded};
use crate::gpu::Gpu;
use crate::scene::{MotionSource, Rejected, Scene};

/// How a scene is stored on the device.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SceneOptions {
    /// Where the poses of a moving scene come from.
    pub motion: MotionSource,
    /// What may be given up for speed. `resolution` must be 1: a view renders the camera's size.
    pub quality: Quality,
}

/// A scene on the device, shared by any number of views of the same [`Gpu`]. Cheap to clone; freed with the last clone and view.
#[derive(Debug, Clone)]
pub struct SceneHandle {
    pub(super) gpu: Gpu,
    pub(super) buffers: Arc<SceneBuffers>,
    pub(super) quality: Quality,
    facts: Arc<Facts>,
}

/// What is known of a scene beside its buffers.
#[derive(Debug)]
struct Facts {
    /// Dropped when the file was read, refused on upload.
    rejected: Rejected,
    /// Those in the file.
    gaussians: u32,
    warnings: Vec<String>,
    extent: Extent,
}

impl SceneHandle {
    /// Uploads a scene; blocks until it is on the device. Invalid Gaussians are counted and never shown.
    ///
    /// # Errors
    /// `Usage` for an inconsistent scene or a motion source that it lacks, `Limit` and `OutOfMemory` when it does not fit.
    pub fn upload(gpu: &Gpu, scene: &Scene, options: &SceneOptions) -> Result<Self> {
        Self::make(gpu, scene, options, Rejected::default(), Vec::new())
    }

    /// Uploads what [`file::load`] has read, and keeps what that counted and warned of.
    ///
    /// # Errors
    /// As [`SceneHandle::upload`].
    pub fn upload_loaded(gpu: &Gpu, loaded: Loaded, options: &SceneOptions) -> Result<Self> {
        let Loaded { scene, rejected, warnings } = loaded;
        Self::make(gpu, &scene, options, rejected, warnings)
    }

    fn make(
        gpu: &Gpu,
        scene: &Scene,
        options: &SceneOptions,
        dropped: Rejected,
        warnings: Vec<String>,
    ) -> Result<Self> {
        let quality = options.quality.for_scene(scene);
        if quality.resolution < 1.0 {
            let expected = "1: give the view a smaller camera and enlarge the image";
            return Err(Error::usage("quality, resolution", quality.resolution.to_string(), expected));
        }
        let buffers = SceneBuffers::new(gpu, scene, options.motion, &quality)?;
        let facts = Facts {
            rejected: dropped + buffers.rejected,
            gaussians: buffers.gaussians.saturating_add(dropped.total() as u32),
            warnings,
            extent: Extent::of(scene, &buffers),
        };
        Ok(Self { gpu: gpu.clone(), buffers: Arc::new(buffers), quality, facts: Arc::new(facts) })
    }

    /// Starts a thread that gets a scene from `source` and uploads it. Submissions of the upload take the queue's lock one by
    /// one, so frames go on meanwhile.
    pub fn load(gpu: &Gpu, source: impl FnOnce() -> Result<Scene> + Send + 'static, options: &SceneOptions) -> Loading {
        let (gpu, options) = (gpu.clone(), *options);
        Loading(std::thread::spawn(move || Self::upload(&gpu, &source()?, &options)))
    }

    /// The same with a file or folder that [`file::load`] reads.
    pub fn load_file(gpu: &Gpu, path: impl Into<PathBuf>, options: &SceneOptions) -> Loading {
        let (gpu, path, options) = (gpu.clone(), path.into(), *options);
        Loading(std::thread::spawn(move || Self::upload_loaded(&gpu, file::load(&path)?, &options)))
    }

    /// Gaussians that are never shown, by reason: dropped when the file was read, or refused on upload.
    pub fn rejected(&self) -> Rejected {
        self.facts.rejected
    }

    /// Number of Gaussians, the refused ones included.
    pub fn gaussians(&self) -> u32 {
        self.facts.gaussians
    }

    /// What reading the file warned of, one line each; none for a scene that came from no file.
    pub fn warnings(&self) -> &[String] {
        &self.facts.warnings
    }

    /// Where and when the scene is; found when it was uploaded.
    pub fn extent(&self) -> Extent {
        self.facts.extent
    }

    /// What moves the scene: a key-time table, or a network or deformation field; `None` when it stands still.
    pub fn motion(&self) -> Option<MotionSource> {
        self.buffers.deformation.source()
    }

    /// Whether command buffers of different views of this scene must execute one after another: a network F or G or a
    /// deformation field writes its results into buffers of the scene, which all its views share.
    pub fn one_after_another(&self) -> bool {
        self.buffers.deformation.is_written_by_frames()
    }

    /// Device memory of the scene, bytes.
    pub fn bytes(&self) -> u64 {
        self.buffers.bytes()
    }
}

/// A scene that is being loaded by another thread; see [`SceneHandle::load`]. Dropping it lets the thread end by itself.
#[derive(Debug)]
pub struct Loading(JoinHandle<Result<SceneHandle>>);

impl Loading {
    /// Whether [`Loading::finish`] returns at once.
    pub fn is_finished(&self) -> bool {
        self.0.is_finished()
    }

    /// The scene; blocks until it is there.
    ///
    /// # Errors
    /// What the source or [`SceneHandle::upload`] says.
    pub fn finish(self) -> Result<SceneHandle> {
        self.0.join().unwrap_or_else(|_| Err(Error::usage("loading a scene", "a panic in its source", "a scene")))
    }
}
