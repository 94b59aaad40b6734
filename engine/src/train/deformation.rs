//! What a run learns of motion. The trainer asks a [`TrainedDeformation`] and knows no model: each has a module here, with its
//! part of a step, of density control, of checkpoints and of the watch over numbers.

mod nonrigid;
mod superpoints;
mod table;

use super::association::AssociationOptions;
use super::config::Config;
use super::density::RowArray;
use super::keys::KeyOptions;
use super::lost::path::Path;
use super::saved::{Saved, Stored};
use super::step::Step;
use super::usage::TrainingMemory;
use crate::error::Result;
use crate::gpu::{Buffer, Gpu, Recorder, Slice};
use crate::render::deformation::DeformationBuffers;
use crate::render::scene_buffers::SceneBuffers;
use crate::scene::{Deformation, Motion, NonrigidNetwork, SuperpointDeformation};

use nonrigid::NonrigidTraining;
use superpoints::SuperpointTraining;
use table::TableTraining;

/// A model of motion under training.
pub(super) type Trained = Box<dyn TrainedDeformation>;

/// Buffers of the training step that belong to others.
#[derive(Debug)]
pub(super) struct StepInputs<'a> {
    /// The Gaussians; poses and offsets are in their `deformation`.
    pub(super) scene: &'a SceneBuffers,
    /// The frame: its time, counts and keys.
    pub(super) frame: &'a Buffer,
    /// The step's data.
    pub(super) step: &'a Buffer,
    /// The frame's counters: nothing changes when the frame failed.
    pub(super) counters: &'a Slice,
    /// What the counters begin with: whether a step before this one failed.
    pub(super) failed: &'a Buffer,
    /// Reports of numbers that are not finite.
    pub(super) status: &'a Buffer,
    /// Those of what runs beside the frame and its loss, which waits for no other report.
    pub(super) status_beside: &'a Buffer,
    /// `float[6][N]` of the pose of each Gaussian's superpoint.
    pub(super) pose_gradient: &'a Buffer,
}

/// What `deform_project_backward` reads and writes for a model.
#[derive(Debug, Default)]
pub(super) struct ProjectInputs<'a> {
    /// `float[10][N]` offsets of the forward pass, and where their gradient goes.
    pub(super) offset: Option<(&'a Buffer, &'a Buffer)>,
    /// `float[3][N]` gradient that the model's own loss adds to the centres'.
    pub(super) mean_gradient: Option<&'a Buffer>,
}

/// Where the rows of density control go on from: the buffers in the order of [`TrainedDeformation::density_rows`].
pub(super) type Rows<'a> = dyn Iterator<Item = Buffer> + 'a;

/// A float array that the next step depends on: name, place, length.
pub(super) type Numbers = (&'static str, Slice, u32);

/// One model's part of training.
pub(super) trait TrainedDeformation: std::fmt::Debug + Send + Sync {
    /// Makes the renderer read this model's poses and offsets.
    fn attach(&self, buffers: &mut DeformationBuffers);

    /// What this model has a step say, before it is submitted: of its image, the exact time and the number of pixels.
    fn prepare(&self, _step: &mut Step, _time: f64, _pixels: f64) {}

    /// Records poses and offsets at the step's time.
    fn record_forward(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()>;

    /// Records what runs between the image and its loss.
    fn record_before_loss(&self, _: &mut Recorder, _: &StepInputs<'_>) -> Result<()> {
        Ok(())
    }

    /// Records what turns gradients of poses and offsets into those of this model, and its Adam.
    fn record_backward(&self, r: &mut Recorder, inputs: &StepInputs<'_>) -> Result<()>;

    /// What `deform_project_backward` has to do with it.
    fn project_inputs(&self) -> ProjectInputs<'_> {
        ProjectInputs::default()
    }

    /// `float[4]` losses of this model, where it has some: position, rotation, translation, weighted total.
    fn property_loss(&self) -> Option<&Buffer> {
        None
    }

    /// Shape of the association of Gaussians with superpoints, where there is one.
    fn association(&self) -> Option<&AssociationOptions> {
        None
    }

    /// All floats that the next step depends on.
    fn numbers(&self) -> Vec<Numbers>;

    /// Arrays with a row per Gaussian that density control gathers.
    fn density_rows(&self) -> Vec<RowArray> {
        Vec::new()
    }

    /// Bytes per Gaussian of those rows.
    fn row_bytes(&self) -> u64 {
        self.density_rows().iter().map(|row| 4 * u64::from(row.planes) * u64::from(row.width)).sum()
    }

    /// Bytes per Gaussian beyond those rows.
    fn bytes_per_gaussian(&self) -> u64;

    /// Goes on with `gaussians` Gaussians and the gathered rows; `None` when nothing is left to move.
    ///
    /// # Errors
    /// `Usage` without enough rows; `OutOfMemory`.
    fn resized(self: Box<Self>, gpu: &Gpu, gaussians: u32, rows: &mut Rows<'_>) -> Result<Option<Trained>>;

    /// Adds its device memory by purpose.
    fn add_memory(&self, used: &mut TrainingMemory);

    /// The model as the scene has it.
    fn download(&self, gpu: &Gpu, scene: &SceneBuffers) -> Result<Deformation>;

    /// Writes its state into a checkpoint.
    fn save(&self, gpu: &Gpu, scene: &SceneBuffers, saved: &mut Saved) -> Result<()>;

    /// Poses of superpoints at `times`, through the buffer `step`; `None` where the model has none.
    fn table_at(&self, _: &Gpu, _: &Buffer, _: &[f32]) -> Result<Option<Motion>> {
        Ok(None)
    }
}

/// A new model, from the Gaussians as they are; the superpoints of an object that was found follow its path.
///
/// # Errors
/// `OutOfMemory`, `Limit`.
pub(super) fn begin(gpu: &Gpu, config: &Config, scene: &SceneBuffers, path: Option<Path>) -> Result<Trained> {
    Ok(Box::new(SuperpointTraining::begin(gpu, config, scene, path)?))
}

/// A key-time table, whose poses are trained themselves.
///
/// # Errors
/// `Usage` without a table, or for options of other lengths; `OutOfMemory`.
pub(super) fn of_table(
    gpu: &Gpu,
    scene: &SuperpointDeformation,
    gaussians: u32,
    options: KeyOptions,
) -> Result<Trained> {
    Ok(Box::new(TableTraining::new(gpu, scene, gaussians, options)?))
}

/// The model that a checkpoint holds; `None` where motion has not begun.
///
/// # Errors
/// `Usage` when lengths do not fit; `OutOfMemory`.
pub(super) fn restore(gpu: &Gpu, config: &Config, stored: &Stored<'_>) -> Result<Option<Trained>> {
    if let Some(model) = NonrigidTraining::restore(gpu, config, stored)? {
        return Ok(Some(Box::new(model)));
    }
    Ok(SuperpointTraining::restore(gpu, config, stored)?.map(|model| Box::new(model) as Trained))
}

/// The model that a checkpoint holds, as a scene has it.
///
/// # Errors
/// `Usage` naming an array that is not there, or of another length than the configuration says.
pub(super) fn of_checkpoint(stored: &Stored<'_>) -> Result<Deformation> {
    nonrigid::of_checkpoint(stored, superpoints::of_checkpoint(stored)?)
}

/// The non-rigid stage on a trained model: network G after what moved it before, which does not learn any more.
///
/// # Errors
/// As [`restore`].
pub(super) fn nonrigid(gpu: &Gpu, config: &Config, stored: &Stored<'_>) -> Result<Trained> {
    let mut network = NonrigidNetwork::init(config.seed);
    if !config.nonrigid.scale {
        network.scaling.weight.fill(0.0);
    }
    Ok(Box::new(NonrigidTraining::begin(gpu, config, stored, &network)?))
}

/// Weights and moments of a network as [`Numbers`].
fn network_numbers(names: [&'static str; 3], state: [Slice; 3]) -> impl Iterator<Item = Numbers> {
    names.into_iter().zip(state).map(|(name, slice)| {
        let words = (slice.bytes / 4) as u32;
        (name, slice, words)
    })
}
