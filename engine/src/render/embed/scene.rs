//! Scenes on a host's device.

use std::sync::Arc;
use std::thread::JoinHandle;

use super::super::quality::Quality;
use super::super::scene_buffers::SceneBuffers;
use crate::error::{Error, Result};
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

/// A scene on the device, shared by any number of views. Cheap to clone; freed with the last clone and view.
#[derive(Debug, Clone)]
pub struct SceneHandle {
    pub(super) buffers: Arc<SceneBuffers>,
    pub(super) quality: Quality,
}

impl SceneHandle {
    /// Uploads a scene; blocks until it is on the device. Invalid Gaussians are counted and never shown.
    ///
    /// # Errors
    /// `Usage` for an inconsistent scene or a motion source that it lacks, `Limit` and `OutOfMemory` when it does not fit.
    pub fn upload(gpu: &Gpu, scene: &Scene, options: &SceneOptions) -> Result<Self> {
        let quality = options.quality.for_scene(scene);
        if quality.resolution < 1.0 {
            let expected = "1: give the view a smaller camera and enlarge the image";
            return Err(Error::usage("quality, resolution", quality.resolution.to_string(), expected));
        }
        Ok(Self { buffers: Arc::new(SceneBuffers::new(gpu, scene, options.motion, &quality)?), quality })
    }

    /// Starts a thread that gets a scene from `source` (a file, say) and uploads it. Submissions of the upload take the
    /// queue's lock one by one, so frames go on meanwhile.
    pub fn load(gpu: &Gpu, source: impl FnOnce() -> Result<Scene> + Send + 'static, options: &SceneOptions) -> Loading {
        let (gpu, options) = (gpu.clone(), *options);
        Loading(std::thread::spawn(move || Self::upload(&gpu, &source()?, &options)))
    }

    /// Gaussians refused on upload, by reason.
    pub fn rejected(&self) -> Rejected {
        self.buffers.rejected
    }

    /// Number of Gaussians, the refused ones included.
    pub fn gaussians(&self) -> u32 {
        self.buffers.gaussians
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
