//! A scene at a time, as Gaussians that stand still: on the device where a deformation field moves it, else on the CPU.

use engine::error::{Error, Result};
use engine::gpu::Gpu;
use engine::reference::{self, Offset, freeze, freeze_with};
use engine::render::FieldEvaluator;
use engine::scene::{Gaussians, MotionSource, Scene};

/// What places a scene's Gaussians at any time.
pub(crate) struct Moments<'a> {
    scene: &'a Scene,
    source: MotionSource,
    /// A field costs hundreds of thousands of products per Gaussian: the f64 reference on the CPU takes minutes.
    field: Option<FieldEvaluator>,
}

impl<'a> Moments<'a> {
    /// Without a device a field is evaluated on the CPU.
    pub(crate) fn new(scene: &'a Scene, source: MotionSource, gpu: Option<&Gpu>) -> Result<Self> {
        let field = match (scene.deformation.field(), gpu) {
            (Some(_), Some(gpu)) => Some(FieldEvaluator::new(gpu, scene)?),
            _ => None,
        };
        Ok(Self { scene, source, field })
    }

    /// The scene that is placed.
    pub(crate) fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// Where its motion comes from.
    pub(crate) fn source(&self) -> MotionSource {
        self.source
    }

    /// `[N]` offsets of a scene with a field.
    pub(crate) fn offsets(&self, time: f64) -> Result<Vec<Offset>> {
        match (&self.field, self.scene.deformation.field()) {
            (Some(evaluator), _) => evaluator.offsets(time),
            (None, Some(field)) => Ok(reference::field_offsets(field, &self.scene.gaussians, time)),
            (None, None) => Err(Error::usage("deformation field", "a scene without one", "a scene with one")),
        }
    }

    /// The Gaussians at a time.
    pub(crate) fn at(&self, time: f64) -> Result<Gaussians> {
        match self.scene.deformation.field() {
            Some(_) => freeze_with(&self.scene.gaussians, &self.offsets(time)?, time),
            None => freeze(self.scene, time, self.source),
        }
    }
}
