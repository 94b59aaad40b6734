//! A dispatch of the kernel on a scene: its parameters and what moves it come from there.

use super::{
    DEFORM_PROJECT_BACKWARD, DEFORM_PROJECT_BACKWARD_THREADS, DeformProjectBackwardBuffers,
    DeformProjectBackwardConstants, OUTPUT_ADAM, OUTPUT_GRADIENT,
};
use crate::error::Result;
use crate::gpu::{Buffer, Groups, Recorder, Slice};
use crate::render::deform_project::{MOTION_STATIC, MOTION_TABLE};
use crate::render::scene_buffers::SceneBuffers;
use crate::render::work_buffers::WorkBuffers;
use crate::scene::parameter::{LOG_SCALE, MEAN, OPACITY_LOGIT, ROTATION, SH_0};
use crate::train::deformation::ProjectInputs;
use crate::train::parameters::Parameters;

/// What becomes of the parameters' gradients.
pub(crate) enum Output<'a> {
    /// They are written, `float[P][N]`.
    Gradient(&'a Buffer),
    /// They are applied, and statistics kept.
    Adam(&'a Parameters),
}

/// What the kernel works on.
pub(crate) struct ProjectBackward<'a> {
    pub(crate) scene: &'a SceneBuffers,
    /// The frame, and what its forward pass left.
    pub(crate) frame: &'a Buffer,
    pub(crate) work: &'a WorkBuffers,
    pub(crate) step: &'a Buffer,
    pub(crate) status: &'a Buffer,
    /// `float[12·N]`.
    pub(crate) splat_gradient: &'a Buffer,
    /// `float[6][N]`, or `float[K][7][N]` with soft superpoints; written where the scene moves.
    pub(crate) pose_gradient: &'a Buffer,
    pub(crate) model: ProjectInputs<'a>,
    pub(crate) output: Output<'a>,
}

impl ProjectBackward<'_> {
    /// Records the kernel.
    ///
    /// # Errors
    /// Those of the recorder.
    pub(crate) fn record(&self, r: &mut Recorder) -> Result<()> {
        let scene = self.scene;
        let constants = DeformProjectBackwardConstants {
            sh_degree: scene.sh_degree,
            motion: if scene.deformation.moves() { MOTION_TABLE } else { MOTION_STATIC },
            nonrigid: u32::from(self.model.offset.is_some()),
            output: if matches!(self.output, Output::Adam(_)) { OUTPUT_ADAM } else { OUTPUT_GRADIENT },
            mean_gradient: u32::from(self.model.mean_gradient.is_some()),
            optional: scene.present.0,
            blend: scene.deformation.blend_slots(),
            antialiased: scene.antialiased.into(),
        };
        let groups = u64::from(scene.gaussians.div_ceil(DEFORM_PROJECT_BACKWARD_THREADS).max(1));
        r.dispatch(&DEFORM_PROJECT_BACKWARD, constants, (), self.buffers(), Groups::Direct(groups))
    }

    fn buffers(&self) -> DeformProjectBackwardBuffers<Slice> {
        let (scene, moved) = (self.scene, &self.scene.deformation);
        let moves = moved.moves();
        let (parameters, gradient) = match self.output {
            Output::Gradient(gradient) => (None, Some(gradient)),
            Output::Adam(parameters) => (Some(parameters), None),
        };
        DeformProjectBackwardBuffers {
            frame: self.frame.whole(),
            step: self.step.whole(),
            counters: self.work.counters.clone(),
            status: self.status.whole(),
            splats: self.work.splats.whole(),
            tile_count: self.work.tile_count.whole(),
            splat_gradient: self.splat_gradient.whole(),
            mean: scene.parameter[MEAN].whole(),
            log_scale: scene.parameter[LOG_SCALE].whole(),
            rotation: scene.parameter[ROTATION].whole(),
            opacity_logit: scene.parameter[OPACITY_LOGIT].whole(),
            superpoint_of_gaussian: moved.hard_superpoints(),
            pose: moves.then(|| moved.pose.whole()),
            sh_0: scene.parameter[SH_0].whole(),
            sh_1: scene.band(1),
            sh_2: scene.band(2),
            sh_3: scene.band(3),
            moment_1: parameters.map(|p| p.moment_1.whole()),
            moment_2: parameters.map(|p| p.moment_2.whole()),
            gradient: gradient.map(Buffer::whole),
            pose_gradient: moves.then(|| self.pose_gradient.whole()),
            nonrigid_offset: self.model.offset.map(|(value, _)| value.whole()),
            nonrigid_gradient: self.model.offset.map(|(_, gradient)| gradient.whole()),
            density: parameters.map(|p| p.density.whole()),
            max_radius: parameters.map(|p| p.max_radius.whole()),
            mean_gradient: self.model.mean_gradient.map(Buffer::whole),
            optional: scene.optional.as_ref().map(Buffer::whole),
            blend_index: moved.blend_index(),
            blend_weight: moved.blend_weight(),
        }
    }
}
